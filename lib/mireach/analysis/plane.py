"""Loops with two states: the loop in its own units, its cells, and functions that several computations share.

Everything is computed in the loop's own units (`units.own_units`) and scaled back by powers of two, without rounding.
The answers therefore do not depend on the units of the states, the inputs and the disturbances.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

from ..arithmetic.scaling import times
from ..checks import positive_number, real_array, require_kind
from ..engines.cells import LoopCells, dynamics
from ..engines.inputs import require_inputs
from ..engines.units import Units, own_units
from ..sets.geos import Shapes, hulls
from ..sets.polygons import Polygons
from ..sets.polytope import Polytope
from ..sets.region import Region
from ..systems.loop import ClosedLoop
from ..tolerances import HALF_PLANE, TOUCH
from ..typing import Array, ArrayLike


@dataclass(frozen=True, eq=False)
class PlanarLoop:
    """A closed loop with two states in its own units, and its cells.

    Attributes
    ----------
    units : engines.units.Units
        The units, and the loop in them.
    dynamics : engines.cells.LoopCells
        The cells of that loop, with x+ = M x + c on each of them.

    See Also
    --------
    PlanarLoop.of : constructs it from a loop in the units of the user.
    """

    units: Units
    dynamics: LoopCells

    @staticmethod
    def of(loop: ClosedLoop) -> PlanarLoop:
        """The planar loop of a closed loop, after all requirements of the computations for two states were checked.

        Raises
        ------
        TypeError
            If `loop` is no ClosedLoop.
        ValueError
            If the loop has not two states, or Phi leaves U.
        """
        require_kind(loop, ClosedLoop, "loop")
        require_inputs(loop)
        units = own_units(loop)
        return PlanarLoop(units, dynamics(units.loop))

    @property
    def loop(self) -> ClosedLoop:
        """The loop in its own units."""
        return self.units.loop

    @property
    def state_set(self) -> Polytope:
        """X in the loop's own units."""
        return self.loop.system.state_set

    @property
    def polygons(self) -> Polygons:
        """The cells as polygons."""
        return self.dynamics.cells.polygons

    @cached_property
    def shapes(self) -> Shapes:
        """The cells as shapely geometries: array (N,)."""
        return hulls(self.polygons)

    @cached_property
    def size(self) -> float:
        """The largest coordinate of X, its image and the disturbance sets; slacks are relative to it."""
        points, owner = self.polygons.points, self.polygons.owner
        parts = points, self.dynamics.images(points, owner), *self.dynamics.corners
        return float(max(np.abs(part).max(initial=0.0) for part in parts))

    @cached_property
    def touch(self) -> float:
        """Closed sets within this distance touch: relative to X, above the rounding of its image."""
        return max(TOUCH * float(np.abs(self.polygons.points).max(initial=0.0)), HALF_PLANE * self.size)

    @cached_property
    def disturbances(self) -> list[tuple[Polytope, NDArray[np.bool_]]]:
        """The different disturbance sets D, each with the cells in which it acts: array (N,) of bool."""
        groups: dict[Polytope, list[int]] = {}
        for number, mode in enumerate(self.loop.system.modes):
            groups.setdefault(mode.disturbance, []).append(number)
        return [(D, np.isin(self.dynamics.cells.mode, modes)) for D, modes in groups.items()]

    def start(self, F: Polytope | Region) -> Region:
        """F & X in own units, for a set F in the units of the user."""
        if isinstance(F, Polytope) and F.dimension == 2:
            F = self.units.polytope(F)
        own = rescaled(F, 1 / self.units.state) if isinstance(F, Region) else Region.of(F)
        return own & self.state_set

    def in_user_units(self, R: Region) -> Region:
        """A region in own units, converted to the units of the user."""
        return rescaled(R, self.units.state)


def rescaled(R: Region, factor: Array) -> Region:
    """{factor x : x in R} for powers of two: the same corners, triangles and pieces, without rounding."""
    shape = shapely.transform(R.shape, lambda x: times(x, factor))
    made = Region(shape)
    for name in ("simplices", "pieces"):
        if name in R.__dict__:
            parts = R.__dict__[name]
            made.__dict__[name] = Polygons(times(parts.points, factor), parts.starts)
    return made


def square(half_width: float) -> Polytope:
    """The box |x|_inf <= half_width in the plane."""
    return Polytope.box([-half_width, -half_width], [half_width, half_width])


def normals(triangles: Array) -> Array:
    """Outward normals of length 1 of the sides of triangles (T, 3, 2): array (T, 3, 2)."""
    ahead = np.roll(triangles, -1, axis=1) - triangles
    turn = ahead[:, 0, 0] * ahead[:, 1, 1] - ahead[:, 0, 1] * ahead[:, 1, 0]
    found = np.stack([ahead[..., 1], -ahead[..., 0]], axis=-1) * np.where(turn < 0, -1, 1)[:, None, None]
    return found / np.maximum(np.linalg.norm(found, axis=2, keepdims=True), np.finfo(float).tiny)


def per_axis(value: ArrayLike, n: int, name: str) -> Array:
    """A positive number, or one for each of n axes, as an array (n,).

    Raises
    ------
    ValueError
        If it is neither.
    """
    if np.ndim(value) == 0:
        return np.full(n, positive_number(value, name))
    array = real_array(value, name, 1)
    if len(array) != n or not (array > 0).all():
        raise ValueError(f"{name} must be a positive number or {n} of them; got {value!r:.80}")
    return array
