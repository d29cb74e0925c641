"""Templates: fixed directions along which sets are bounded."""

import numpy as np

from ..checks import whole_number
from ..typing import Array


def directions(count: int) -> Array:
    """The template of the paper's case studies: C_i = (cos 2 pi (i-1)/count, sin 2 pi (i-1)/count).

    Parameters
    ----------
    count : int
        At least 3, so that the sets are bounded.

    Returns
    -------
    array (count, 2)
        Unit rows, counter-clockwise from (1, 0); exact zeros and ones where they belong.

    Raises
    ------
    ValueError
        If count is no whole number of at least 3.

    See Also
    --------
    box_directions : the template of boxes, in any dimension.

    Examples
    --------
    >>> directions(4).tolist()
    [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
    """
    count = whole_number(count, "count", 3)
    angles = 2 * np.pi * np.arange(count) / count
    C = np.column_stack([np.cos(angles), np.sin(angles)])
    return np.where(np.abs(C) < 1e-15, 0.0, C)


def box_directions(n: int) -> Array:
    """The template (I, -I) whose sets are boxes.

    Parameters
    ----------
    n : int
        Dimension, at least 1.

    Returns
    -------
    array (2 n, n)

    Raises
    ------
    ValueError
        If n is no whole number of at least 1.

    See Also
    --------
    directions : evenly spaced directions of the plane.

    Examples
    --------
    >>> box_directions(2).tolist()
    [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
    """
    n = whole_number(n, "n", 1)
    return np.vstack([np.eye(n), -np.eye(n)]) + 0.0
