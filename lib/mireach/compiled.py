"""The two inner loops of the iterations in the plane that are worth compiling.

numba compiles them when they are first used, which takes some seconds, and keeps the result on disk.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def polygon(H, h, parallel, tol):
    """The vertices of {x : H x <= h} in the plane, if its rows leave no half-plane free and it holds a point.

    Parameters
    ----------
    H : array (l, 2)
    h : array (l,)
    parallel : float
        Unit rows whose determinant is at most this do not meet.
    tol : float
        A point x is inside if H x <= h + tol (1 + |x|_inf), for unit rows. Vertices closer than tol (1 + the
        largest coordinate) are one.

    Returns
    -------
    array (v, 2)
        Counter-clockwise. No rows where the set is empty, perhaps unbounded, or in doubt.
    """
    none, rows = np.empty((0, 2)), 0
    unit, offset, angle = np.empty(H.shape), np.empty(len(h)), np.empty(len(h))
    for r in range(len(h)):
        length = np.hypot(H[r, 0], H[r, 1])
        if length > 0:
            unit[rows] = H[r] / length
            offset[rows], angle[rows] = h[r] / length, np.arctan2(H[r, 1], H[r, 0])
            rows += 1
        elif h[r] < 0:
            return none
    angle = np.sort(angle[:rows])
    for r in range(rows):
        following = angle[r + 1] if r + 1 < rows else angle[0] + 2 * np.pi
        if following - angle[r] > np.pi - 1e-9:
            return none
    found, count, strict = np.empty((max(rows * (rows - 1) // 2, 1), 2)), 0, 0
    for i in range(rows):
        for j in range(i + 1, rows):
            turn = unit[i, 0] * unit[j, 1] - unit[i, 1] * unit[j, 0]
            if abs(turn) <= parallel:
                continue
            x, y = 0.0, 0.0
            for _ in range(2):  # the second round takes back what the first one rounded off
                p = offset[i] - unit[i, 0] * x - unit[i, 1] * y
                q = offset[j] - unit[j, 0] * x - unit[j, 1] * y
                x, y = x + (p * unit[j, 1] - q * unit[i, 1]) / turn, y + (q * unit[i, 0] - p * unit[j, 0]) / turn
            limit, inside = tol * (1 + max(abs(x), abs(y))), True
            for k in range(rows):
                r = (strict + k) % rows  # the row that the last point failed is likely to refuse this one too
                if unit[r, 0] * x + unit[r, 1] * y - offset[r] > limit:
                    inside, strict = False, r
                    break
            if inside:
                found[count] = x, y
                count += 1
    size, distinct = 1 + np.abs(found[:count]).max() if count else 1.0, 0
    for k in range(count):
        new = True
        for other in range(distinct):
            new = new and max(abs(found[other, 0] - found[k, 0]), abs(found[other, 1] - found[k, 1])) > tol * size
        if new:
            found[distinct] = found[k]
            distinct += 1
    return around(found[:distinct])


@njit(cache=True)
def around(points):
    """Points (k, 2) on the boundary of a convex set, counter-clockwise, without those between two others."""
    count = len(points)
    if count < 3:
        return points
    x, y = points[:, 0].mean(), points[:, 1].mean()
    points = points[np.argsort(np.arctan2(points[:, 1] - y, points[:, 0] - x))]
    kept = np.empty(count, np.bool_)
    for k in range(count):
        a, b, c = points[k - 1], points[k], points[(k + 1) % count]
        turn = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
        kept[k] = turn > 1e-12 * np.hypot(b[0] - a[0], b[1] - a[1]) * np.hypot(c[0] - b[0], c[1] - b[1])
    if kept.sum() > 2:
        return points[kept]
    far = 0  # the points are collinear: keep the two ends
    for k in range(count):
        if (points[k, 0] - points[0, 0]) ** 2 + (points[k, 1] - points[0, 1]) ** 2 > (
            points[far, 0] - points[0, 0]
        ) ** 2 + (points[far, 1] - points[0, 1]) ** 2:
            far = k
    along = (points[:, 0] - points[0, 0]) * (points[far, 0] - points[0, 0]) + (points[:, 1] - points[0, 1]) * (
        points[far, 1] - points[0, 1]
    )
    return points[np.array([np.argmin(along), np.argmax(along)])]


@njit(cache=True)
def highest(points, starts, centres, radii, M, c, mode, heights, spread, H, h, tol, V):
    """max v (M_j x + c_j) + h of D over the parts of N convex polygons in {x : H x <= h}.

    Parameters
    ----------
    points, starts : array (T, 2) and (N + 1,) of int
        The polygons, as in `polygons.Polygons`.
    centres, radii : array (N, 2) and (N,)
        Discs around them.
    M, c, mode : array (N, 2, 2), (N, 2) and (N,) of int
        The map on each polygon, and whose disturbance acts there.
    heights : array (N, k)
        max v (M_j x + c_j) over each whole polygon.
    spread : array (s, k)
        h of D^(i) along the rows of V.
    H, h : array (l, 2) and (l,)
        Rows of any length.
    tol : float
        Closed sets that come this close (a length) touch.
    V : array (k, 2)

    Returns
    -------
    value : array (k,)
        -inf if no polygon meets the set.
    owner : array (k,) of int
        The polygon in which it is attained.
    """
    rows, directions = len(h), len(V)
    value, owner = np.full(directions, -np.inf), np.zeros(directions, np.int64)
    H, h = H.copy(), h.copy()
    for r in range(rows):
        length = np.hypot(H[r, 0], H[r, 1])
        if length > 0:
            H[r] /= length
            h[r] /= length
    room = 2 * (np.diff(starts).max() + 2 * rows)
    polygon, part, excess, cuts = np.empty((room, 2)), np.empty((room, 2)), np.empty(room), np.empty(rows)
    for j in range(len(mode)):
        worst = -np.inf
        for r in range(rows):
            cuts[r] = H[r, 0] * centres[j, 0] + H[r, 1] * centres[j, 1] - h[r]
            worst = max(worst, cuts[r])
            if worst > radii[j] + tol:
                break
        if worst > radii[j] + tol:
            continue
        if worst <= -radii[j]:
            for k in range(directions):
                reached = heights[j, k] + spread[mode[j], k]
                if reached > value[k]:
                    value[k], owner[k] = reached, j
            continue
        size = starts[j + 1] - starts[j]
        polygon[:size] = points[starts[j] : starts[j + 1]]
        for r in range(rows):
            if cuts[r] <= -radii[j]:
                continue
            outside = 0
            for t in range(size):
                excess[t] = H[r, 0] * polygon[t, 0] + H[r, 1] * polygon[t, 1] - h[r]
                outside += excess[t] > tol
            if outside == 0:
                continue
            kept = 0
            if 2 * size > room:
                raise ValueError("a cell has lost its convexity by rounding")
            for t in range(size):
                after = t + 1 if t + 1 < size else 0
                if excess[t] <= tol:
                    part[kept] = polygon[t]
                    kept += 1
                if (excess[t] <= tol) != (excess[after] <= tol):
                    share = min(max(excess[t] / (excess[t] - excess[after]), 0.0), 1.0)
                    part[kept, 0] = polygon[t, 0] + share * (polygon[after, 0] - polygon[t, 0])
                    part[kept, 1] = polygon[t, 1] + share * (polygon[after, 1] - polygon[t, 1])
                    kept += 1
            size = kept
            polygon, part = part, polygon
        for t in range(size):
            x = M[j, 0, 0] * polygon[t, 0] + M[j, 0, 1] * polygon[t, 1] + c[j, 0]
            y = M[j, 1, 0] * polygon[t, 0] + M[j, 1, 1] * polygon[t, 1] + c[j, 1]
            for k in range(directions):
                reached = V[k, 0] * x + V[k, 1] * y + spread[mode[j], k]
                if reached > value[k]:
                    value[k], owner[k] = reached, j
    return value, owner
