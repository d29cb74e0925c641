"""Scaling by powers of two, which floats do without rounding."""

import numpy as np

from .polytope import Polytope

LARGEST = np.finfo(float).max  # stands for an offset beyond the range of floats


def power_of_two(values):
    """The smallest powers of two that are not below |values|; 1 for 0."""
    mantissa, exponent = np.frexp(values)
    exponent = np.where(values == 0, 0, exponent - (np.abs(mantissa) == 0.5))
    return np.ldexp(1.0, np.clip(exponent, -1022, 1023))


def times(values, factor):
    """Values times powers of two.

    Raises
    ------
    ValueError
        If that is not exact.
    """
    scaled = values * factor
    if not (scaled / factor == values).all():
        raise ValueError("the numbers lie too far apart: no units hold all of them as floats")
    return scaled


def reach_of(P):
    """For each axis the smallest power of two that a bounded Polytope nowhere exceeds, up to rounding: array (n,)."""
    return power_of_two(np.abs(P.bounding_box()).max(axis=0))


def in_units(P, scale):
    """{x' : scale x' in P}, rows scaled to a largest entry above 1/2 and up to 1.

    Parameters
    ----------
    P : Polytope
        In R^n.
    scale : array (n,)
        Powers of two.

    Returns
    -------
    Polytope

    Raises
    ------
    ValueError
        As `times`.
    """
    H = times(P.H, scale)
    factor = 1 / power_of_two(np.abs(H).max(axis=1))
    return Polytope(H * factor[:, None], np.clip(P.h * factor, -LARGEST, LARGEST))
