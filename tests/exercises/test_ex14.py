"""Exercise 14: plausible wrong answers are caught, with a hint that names what is violated."""

from itertools import product

import numpy as np
from helpers import expect

import mireach as mr
from mireach.exercises import ex14

BOX = mr.box_directions(3)


def test_forgotten_rows_and_turned_inequalities_are_caught(solved):
    def without_vertical_rows(P, y):
        a, rest = P.H[:, 2], P.h - P.H[:, :2] @ y
        low, high = (rest[a < 0] / a[a < 0]).max(), (rest[a > 0] / a[a > 0]).min()
        return (low, high) if low <= high else None

    def turned(P, y):
        ends = solved["heights"](P, y)
        return ends and ends[::-1]

    expect(ex14.check_t1, without_vertical_rows, "outside of the projection", "the rows without x3")
    expect(ex14.check_t1, turned, "low", "off by")
    expect(ex14.check_t1, lambda P, y: tuple(np.ravel(P.project([2]).bounding_box())), "polytope", "y = (")
    expect(ex14.check_t1, lambda P, y: None, "is in P, but you return None")
    expect(ex14.check_t1, lambda P, y: solved["heights"](P, y) and 3.0, "the pair (low, high) or None")


def test_states_in_the_set_and_outside_of_a_projection_are_caught():
    lower, upper = ex14.terminal_set().bounding_box()
    expect(ex14.check_t2, [0, 0, 0], "in all three projections, and in the set")
    expect(ex14.check_t2, 2 * upper, "is not inside the projection onto (x1, x2)")
    expect(ex14.check_t2, [0, 0, upper[2] + 0.1], "is not inside the projection onto (x1, x3)")
    expect(ex14.check_t2, lower[:2], "must have shape (3,)")


def test_counts_of_patterns_of_flat_parts_and_of_points_are_caught(solved):
    def with_flat_parts(W, b, P):
        parts = (mr.Polytope(-np.array(s)[:, None] * W, s * b) & P for s in product((1, -1), repeat=len(b)))
        return sum(not part.is_empty for part in parts)

    def by_points(W, b, P):
        return len(np.unique(P.sample(0, 10) @ W.T + b > 0, axis=0))

    expect(ex14.check_t3, lambda W, b, P: 2 ** len(b), "one part per sign pattern")
    expect(ex14.check_t3, with_flat_parts, "too many", "only on a face")
    expect(ex14.check_t3, by_points, "too few", "sampled points may miss them")
    expect(ex14.check_t3, lambda W, b, P: len(b) + 0.5, "whole number")


def test_a_missing_disturbance_and_vertices_of_the_wrong_sets_are_caught(solved):
    right = solved["step_support"]
    nothing, everything = mr.Polytope.box([0] * 3, [0] * 3), mr.Polytope.box([-1] * 3, [1] * 3)

    def at_vertices_of_the_set(pieces, F, D, V):
        images = [M @ x + c for C, M, c in pieces for x in F.vertices() if C.contains(x, tol=1e-9)]
        return (np.array(images) @ V.T).max(axis=0) + D.support(V)

    def every_map_everywhere(pieces, F, D, V):
        images = [M @ x + c for _, M, c in pieces for x in F.vertices()]
        return (np.array(images) @ V.T).max(axis=0) + D.support(V)

    expect(ex14.check_t4, lambda pieces, F, D, V: right(pieces, F, nothing, V), "D is missing")
    expect(ex14.check_t4, lambda pieces, F, D, V: right(pieces, everything, D, V), "lies in F")
    expect(ex14.check_t4, at_vertices_of_the_set, "is in F and leads to", "but not of F")
    expect(ex14.check_t4, every_map_everywhere, "no state of F leads that far")
    expect(ex14.check_t4, lambda *given: right(*given)[:2], "must have shape (5,)")


def test_boxes_too_many_rows_and_unbounded_templates_are_caught():
    expect(ex14.check_t5, BOX, "no safe set with this C", "leaves X")
    expect(ex14.check_t5, np.vstack([BOX, [[-1, -1, -2]]]), "has 7 rows, but may have at most 6")
    expect(ex14.check_t5, np.vstack([BOX[:5], [[1, 1, 2]]]), "unbounded", "along (0, 0, -1)")
    expect(ex14.check_t5, np.vstack([BOX[:5], [[0, 0, 0]]]), "a row of zeros")
    expect(ex14.check_t5, BOX[:, :2], "must have shape (k, 3)")
