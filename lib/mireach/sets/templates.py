"""Templates: fixed directions along which sets are bounded."""

import numpy as np
from scipy.special import ndtri

from ..checks import whole_number
from ..typing import Array

CANDIDATES = 4000  # directions among which the farthest is sought; at least, and 10 for every row of a template
ROUNDS = 20  # of moving each direction to the middle of those that it is nearest to


def directions(count: int, n: int = 2) -> Array:
    """A template of `count` directions that are spread evenly over the unit sphere of R^n.

    In the plane it is that of the paper's case studies: C_i = (cos 2 pi (i-1)/count, sin 2 pi (i-1)/count).

    Parameters
    ----------
    count : int
        At least n + 1, so that the sets are bounded.
    n : int
        Dimension, at least 2.

    Returns
    -------
    array (count, n)
        Unit rows. n = 2: counter-clockwise from (1, 0); exact zeros and ones where they belong. n > 2: the box
        directions (I, -I) first if there are at least 2 n rows; then pairs v, -v.

    Raises
    ------
    ValueError
        If n is no whole number of at least 2, or count none of at least n + 1.

    See Also
    --------
    box_directions : the template of boxes, in any dimension; octahedral_directions : the box, and all diagonals.

    Examples
    --------
    >>> directions(4).tolist()
    [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
    >>> directions(14, 3).shape
    (14, 3)

    Notes
    -----
    {x : C x <= 1} is bounded exactly if 0 lies in the interior of the convex hull of the rows. For n > 2 the box
    directions see to that; with fewer than 2 n rows, the n + 1 corners of a regular simplex do.

    The further pairs are those farthest from the rows before, among several thousand directions of a fixed
    low-discrepancy sequence. Then each of them moves to the middle of the directions that are nearest to it, several
    times (Lloyd's algorithm); the box directions stay. The same arguments always give the same rows.

    The largest angle between any direction and the nearest row, and in brackets the median of this angle for random
    rows, in degrees: R^3: 36.5 for 14 rows (67), 28.6 for 26 (52); R^4: 45 for 24 (66), 34 for 64 (50); R^6: 49 for 72
    (61). The least possible angle for 14 rows in R^3 is 35. For 12 it is 37, but 55 here, as the box directions stay.
    """
    n = whole_number(n, "n", 2)
    count = whole_number(count, "count", n + 1)
    if n > 2:
        return _around_simplex(count, n) if count < 2 * n else _around_box(count, n)
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
    directions : evenly spread directions; octahedral_directions : the box, and all diagonals.

    Examples
    --------
    >>> box_directions(2).tolist()
    [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
    """
    n = whole_number(n, "n", 1)
    return np.vstack([np.eye(n), -np.eye(n)]) + 0.0


def octahedral_directions(n: int) -> Array:
    """The template of the rows +-e_i and (+-e_i +-e_j) / sqrt(2), i < j, whose sets are octagons in the plane.

    Parameters
    ----------
    n : int
        Dimension, at least 1.

    Returns
    -------
    array (2 n^2, n)
        Unit rows, the box directions first.

    Raises
    ------
    ValueError
        If n is no whole number of at least 1.

    See Also
    --------
    box_directions : the first 2 n of them; directions : any number of them.

    Examples
    --------
    >>> octahedral_directions(2).round(2).tolist()[4:]
    [[0.71, 0.71], [0.71, -0.71], [-0.71, 0.71], [-0.71, -0.71]]
    """
    box, axes = box_directions(n), np.eye(n)
    pairs = [a * axes[i] + b * axes[j] for i in range(n) for j in range(i + 1, n) for a in (1, -1) for b in (1, -1)]
    return np.vstack([box, np.reshape(pairs, (-1, n)) * np.sqrt(0.5) + 0.0])


def _around_simplex(count: int, n: int) -> Array:
    """The corners of a regular simplex, and then the directions farthest from the rows before: array (count, n)."""
    ones = np.ones(n) / np.sqrt(n)
    corners = np.sqrt(1 + 1 / n) * np.eye(n) - (np.sqrt(n + 1) + 1) / n * ones
    C, candidates = np.vstack([ones, corners]), _candidates(count, n)
    while len(C) < count:
        C = np.vstack([C, _farthest(candidates, C)])
    return C


def _around_box(count: int, n: int) -> Array:
    """The box directions, pairs of further ones, and a single one if the count is odd: array (count, n)."""
    candidates = _candidates(count, n)
    axes = np.eye(n)  # one row for each pair v, -v
    while len(axes) < count // 2:
        axes = np.vstack([axes, _farthest(candidates, np.vstack([axes, -axes]))])
    axes = _spread(axes, n, candidates)
    C = np.vstack([box_directions(n), axes[n:], -axes[n:]])
    return np.vstack([C, _farthest(candidates, C)]) if count % 2 else C


def _spread(axes: Array, fixed: int, candidates: Array) -> Array:
    """Pairs v, -v, one row each, after Lloyd's algorithm; the first `fixed` rows stay. The best round counts."""
    best, widest = axes, _least_cosine(candidates, axes)
    for _ in range(ROUNDS if len(axes) > fixed else 0):
        cosines = candidates @ axes.T
        own = np.abs(cosines).argmax(axis=1)
        signs = np.sign(cosines[np.arange(len(own)), own])
        sums = np.zeros_like(axes)
        np.add.at(sums, own, signs[:, None] * candidates)
        axes = np.vstack([axes[:fixed], _unit(np.where(sums.any(axis=1, keepdims=True), sums, axes)[fixed:])])
        cosine = _least_cosine(candidates, axes)
        if cosine > widest:
            best, widest = axes, cosine
    return best


def _least_cosine(candidates: Array, axes: Array) -> float:
    """The cosine of the largest angle between a candidate and the nearest of the directions v, -v."""
    return float(np.abs(candidates @ axes.T).max(axis=1).min())


def _farthest(candidates: Array, C: Array) -> Array:
    """The candidate (n,) whose angle to the nearest row of C is largest."""
    return candidates[(candidates @ C.T).max(axis=1).argmin()]


def _candidates(count: int, n: int) -> Array:
    """Directions (N, n) of a fixed sequence that fills the sphere evenly: normal quantiles of an additive recurrence.

    Its steps are the powers of 1/g with g^(n+1) = g + 1, which generalize the golden ratio.
    """
    g = 2.0
    for _ in range(64):  # converges to the root of g^(n+1) = g + 1
        g = (1 + g) ** (1 / (n + 1))
    steps = np.arange(1, max(CANDIDATES, 10 * count) + 1)[:, None] * g ** -np.arange(1.0, n + 1)
    return _unit(ndtri((0.5 + steps) % 1))


def _unit(rows: Array) -> Array:
    """Rows (k, n) divided by their lengths."""
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))
