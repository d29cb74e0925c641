"""Scaling by powers of two, which floats do without rounding."""

import numpy as np

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
        raise ValueError("the numbers lie too far apart for exact scaling; choose other units")
    return scaled


def normal_rows(H):
    """Rows scaled by powers of two to a largest entry above 1/2 and up to 1: H' (l, n), and the factors (l,)."""
    factor = 1 / power_of_two(np.abs(H).max(axis=1, initial=0))
    return H * factor[:, None] + 0.0, factor
