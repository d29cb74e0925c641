"""Arguments that several analyses share: templates, centres, tolerances."""

import numpy as np

from ..arithmetic.scaling import normal_rows
from ..checks import real_array, require_kind
from ..sets.templates import box_directions, directions
from ..systems.loop import ClosedLoop
from ..typing import Array, ArrayLike

Centre = str | ArrayLike  # "origin", "equilibrium" or an array (n,)


def template(loop: ClosedLoop, C: ArrayLike | None) -> Array:
    """C as an array (l, n), or the default template."""
    require_kind(loop, ClosedLoop, "loop")
    n = loop.system.state_size
    if C is None:
        return directions(8) if n == 2 else box_directions(n)
    C = real_array(C, "C", 2) + 0.0
    if C.shape[1] != n:
        raise ValueError(f"C has {C.shape[1]} columns, but the state has {n} entries")
    if not (np.linalg.norm(C, axis=1) > 0).all():
        raise ValueError("C has a row of zeros, which is no direction")
    return C


def with_rows(C: Array, H: Array) -> Array:
    """C with those rows of H appended that it does not contain, up to factors that are powers of two."""
    known = {row.tobytes() for row in normal_rows(C)[0]}
    return np.vstack([C, *(row[None] for row, own in zip(H, normal_rows(H)[0]) if own.tobytes() not in known)])


def centre_point(loop: ClosedLoop, centre: Centre) -> Array:
    """The centre as a point (n,)."""
    if isinstance(centre, str):
        if centre == "origin":
            return np.zeros(loop.system.state_size)
        if centre == "equilibrium":
            return loop.equilibrium()
        raise ValueError(f'centre must be "origin", "equilibrium" or a point; got {centre!r}')
    c = real_array(centre, "centre", 1)
    if len(c) != loop.system.state_size:
        raise ValueError(f"centre has {len(c)} entries, but the state has {loop.system.state_size}")
    return c


def tolerance(tol: float | None) -> float | None:
    """An argument `tol`: None or a number that is not negative.

    Raises
    ------
    ValueError
        If it is neither.
    """
    if tol is None:
        return None
    checked = float(real_array(tol, "tol", 0))
    if checked < 0:
        raise ValueError(f"tol must not be negative; got {checked}")
    return checked
