"""Whether closed regions cover a domain, decided without rounding: each number is the float that it is."""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from ..arithmetic.rational import binary, dot, nearest, strict_point
from ..sets.polytope import Polytope
from ..tolerances import OPPOSITE_NORMALS

Point: TypeAlias = tuple[Any, ...]  # of fmpq
Row: TypeAlias = tuple[Point, Any]  # a and b of a z <= b


def uncovered_point(domain: Polytope, regions: Sequence[Polytope]) -> Point | None:
    """A point of the domain that no region contains, or None if the regions cover it.

    Parameters
    ----------
    domain : Polytope
    regions : sequence of Polytope
        Closed, of the domain's dimension.

    Returns
    -------
    tuple of fmpq, or None

    Examples
    --------
    >>> domain, left = Polytope.box([-1], [1]), Polytope([[1.0]], [0.0])
    >>> uncovered_point(domain, [left, Polytope([[-1.0]], [0.0])]) is None
    True
    >>> float(uncovered_point(domain, [left, Polytope([[-1.0]], [-0.5])])[0]) > 0
    True
    """
    inside: _Cell | None = _Cell()
    for a, b in zip(binary(domain.H), binary(domain.h)):
        inside = inside and inside.with_row(a, b)
    return None if inside is None else inside.without([list(zip(binary(P.H), binary(P.h))) for P in regions])


def narrow_gap(point: Point, regions: Sequence[Polytope]) -> str:
    """Which two rows that seem to name the same boundary leave a point between them, as the end of a message."""
    outside = []
    for number, region in enumerate(regions, start=1):
        for row, (a, b) in enumerate(zip(binary(region.H), binary(region.h))):
            excess = dot(a, point) - b
            if excess > 0:
                length = np.linalg.norm(region.H[row])
                outside.append((number, row + 1, region.H[row] / length, nearest(excess) / length))
    pairs = [
        (one[3] + other[3], one, other)
        for i, one in enumerate(outside)
        for other in outside[:i]
        if one[0] != other[0] and np.abs(one[2] + other[2]).max() <= OPPOSITE_NORMALS
    ]
    if not pairs:
        return ""
    width, one, other = min(pairs, key=lambda pair: pair[0])
    return (
        f". It lies between row {other[1]} of mode {other[0]} and row {one[1]} of mode {one[0]}, in a gap of width "
        f"{width:.2g} of the size of X x U; if they are to name the same boundary, write it with the same numbers, as "
        "a x <= b and -a x <= -b"
    )


class _Cell:
    """Half-spaces a z <= b, some of them a z < b, in rational numbers; of each direction the tightest is kept.

    Attributes
    ----------
    limits : dict
        Direction, scaled to a first entry of 1 or -1, to (offset, whether it is closed).
    point : tuple of fmpq or None
        A point of the cell, where one has been computed.
    """

    def __init__(self, limits: dict[Point, tuple[Any, bool]] | None = None, point: Point | None = None) -> None:
        self.limits, self.point = limits or {}, point

    def with_row(self, a: Point, b: Any, strict: bool = False) -> "_Cell | None":
        """This cell and a z <= b, or a z < b; None where another row contradicts it."""
        size = abs(next((entry for entry in a if entry), 1))
        if not any(a):
            return self if b > 0 or (b == 0 and not strict) else None
        key, limit = tuple(entry / size for entry in a), (b / size, not strict)
        limits = {**self.limits, key: min(limit, self.limits.get(key, limit))}
        offset, closed = limits[key]
        opposite = limits.get(tuple(-entry for entry in key))
        if opposite is not None and (offset + opposite[0], closed and opposite[1]) <= (0, False):
            return None
        point = self.point
        if point is not None and not (dot(a, point) < b or (dot(a, point) == b and not strict)):
            point = None
        return _Cell(limits, point)

    def located(self) -> "_Cell | None":
        """This cell with a point, or None if it is empty."""
        if self.point is None:
            closed_rows: tuple[list[Point], list[Any]] = [], []
            strict_rows: tuple[list[Point], list[Any]] = [], []
            for a, (b, closed) in self.limits.items():
                H, h = closed_rows if closed else strict_rows
                H.append(a)
                h.append(b)
            self.point = strict_point(*closed_rows, *strict_rows)
        return None if self.point is None else self

    def without(self, regions: Sequence[Sequence[Row]]) -> Point | None:
        """A point of this cell that lies in no region, or None: beyond a region's first row, or its second, ..."""
        if self.located() is None:
            return None
        for number, region in enumerate(regions):
            inside: _Cell | None = self
            for a, b in region:
                inside = inside and inside.with_row(a, b)
            if inside is None or inside.located() is None:
                continue
            rest = self
            for a, b in region:
                beyond = rest.with_row(tuple(-entry for entry in a), -b, strict=True)
                gap = None if beyond is None else beyond.without(regions[number + 1 :])
                if gap is not None:
                    return gap
                kept = rest.with_row(a, b)
                if kept is None:
                    return None
                rest = kept
            return None
        return self.point
