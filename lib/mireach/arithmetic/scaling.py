"""Scaling by powers of two, which floats do without rounding."""

import numpy as np

from ..typing import Array, ArrayLike

LARGEST = float(np.finfo(float).max)  # stands for an offset beyond the range of floats


def power_of_two(values: ArrayLike) -> Array:
    """The smallest powers of two that are not below |values|; 1 for 0.

    Examples
    --------
    >>> power_of_two([3.0, 4.0, -0.3, 0.0]).tolist()
    [4.0, 4.0, 0.5, 1.0]
    """
    values = np.asarray(values)
    mantissa, exponent = np.frexp(values)
    exponent = np.where(values == 0, 0, exponent - (np.abs(mantissa) == 0.5))
    return np.ldexp(1.0, np.clip(exponent, -1022, 1023))


def times(values: Array, factor: Array | float) -> Array:
    """Values times powers of two.

    Raises
    ------
    ValueError
        If that is not exact.
    """
    scaled = values * factor
    if not (scaled / factor == values).all():
        raise ValueError("the numbers lie too far apart for exact scaling; choose other units")
    return scaled


def normal_rows(H: Array) -> tuple[Array, Array]:
    """Rows scaled by powers of two to a largest entry above 1/2 and up to 1: H' (l, n), and the factors (l,).

    Examples
    --------
    >>> rows, factor = normal_rows(np.array([[6.0, 2.0]]))
    >>> rows.tolist(), factor.tolist()
    ([[0.75, 0.25]], [0.125])
    """
    factor = 1 / power_of_two(np.abs(H).max(axis=1, initial=0))
    return H * factor[:, None] + 0.0, factor
