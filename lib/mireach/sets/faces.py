"""Faces and edges of polytopes of R^3, for pictures: in floating point."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from ..tolerances import ROUNDOFF, TOUCH
from ..typing import Array
from .polytope import Polytope

Ring = tuple[int, ...]  # vertices of a face in the order of its boundary


def rings(P: Polytope) -> tuple[Array, list[Ring]]:
    """Vertices of a bounded Polytope of R^3, and its faces as cycles of vertices.

    Parameters
    ----------
    P : Polytope
        A flat polygon is its own and only face; segments, points and the empty set have none.

    Returns
    -------
    vertices : array (v, 3)
    faces : list of tuple of int
        Rows of `vertices` in the order of the boundary, in either sense.

    Raises
    ------
    ValueError
        If P is unbounded, does not lie in R^3, or has too many rows to enumerate its vertices.

    See Also
    --------
    edges : of the faces.

    Examples
    --------
    >>> vertices, faces = rings(Polytope.box([0, 0, 0], [1, 2, 3]))
    >>> len(vertices), len(faces), len(edges(faces))
    (8, 6, 12)

    Notes
    -----
    The vertices of a face are those where a row of H is tight. A row that is tight at fewer vertices than another row,
    all of which are tight there as well, touches P in an edge or a vertex only. Tight is what differs by less than the
    distance at which `Polytope.vertices` takes two points as one.
    """
    if P.dimension != 3:
        raise ValueError(f"faces are found for sets in R^3; this one lies in R^{P.dimension}")
    vertices = P.vertices()
    if len(vertices) < 3:
        return vertices, []
    spread = np.ptp(vertices, axis=0)
    distance = np.maximum(TOUCH * spread, 32 * ROUNDOFF * np.abs(vertices).max(axis=0))
    rows = np.flatnonzero(P.H.any(axis=1))
    gap = np.abs(vertices @ P.H[rows].T - P.h[rows])
    tight = [frozenset(np.flatnonzero(column).tolist()) for column in (gap <= 2 * np.abs(P.H[rows]) @ distance).T]
    found = [face for face in dict.fromkeys(tight) if len(face) > 2 and not any(face < other for other in tight)]
    local = (vertices - vertices.mean(axis=0)) / np.where(spread > 0, spread, 1)
    return vertices, [_around(local, sorted(face)) for face in found]


def edges(faces: list[Ring]) -> list[tuple[int, int]]:
    """The edges of faces, each once: pairs of vertices, the lower number first."""
    found = [tuple(sorted(pair)) for ring in faces for pair in pairwise((*ring, ring[0]))]
    return [(i, j) for i, j in dict.fromkeys(found)]


def _around(points: Array, face: list[int]) -> Ring:
    """The corners of a face in the order of its boundary."""
    corners = points[face] - points[face].mean(axis=0)
    across = np.linalg.svd(corners)[2][:2]
    x, y = (corners @ across.T / np.abs(corners @ across.T).max(axis=0)).T
    return tuple(face[k] for k in np.argsort(np.arctan2(y, x)))
