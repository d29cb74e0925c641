"""Cell complexes: vertices against exact polytopes, pieces against evaluation, bounds against exact maxima."""

from fractions import Fraction

import numpy as np
import pytest
from loops import evaluate, random_network

from mireach import CellLimitError, Polytope, box_directions
from mireach.arithmetic.rational import binary, dot
from mireach.sets.cell_complex import MOST_STATES, CellComplex
from mireach.sets.exact_polytopes import ExactPolytope

CUBE = Polytope.box([-1, -1, -1], [1, 1, 1])
CUT_THROUGH_CORNERS = Polytope(np.vstack([CUBE.H, [[1.0, 1, 1], [1.0, -1, 0]]]), np.append(CUBE.h, [1.0, 0.0]))
CROSS = Polytope(np.array(np.meshgrid(*[[-1.0, 1]] * 3)).reshape(3, -1).T, np.ones(8))
PYRAMID = Polytope([[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1], [0, 0, -1]], [1.0, 1, 1, 1, 0])
TWICE = Polytope(np.vstack([CUBE.H, CUBE.H]), np.tile(CUBE.h, 2))
FACE = CUBE & Polytope([[1.0, 2, 3], [-1.0, -2, -3]], [1.0, -1.0])
SEGMENT = FACE & Polytope([[1.0, -1, 0], [-1.0, 1, 0]], [0.0, 0.0])
POINT = Polytope.box([0.25, 0.125, -0.25], [0.25, 0.125, -0.25])
SHAPES = [CUBE, CUT_THROUGH_CORNERS, CROSS, PYRAMID, TWICE, FACE, SEGMENT, POINT]


def layers(net):
    """The arguments of `affine_pieces` that describe a network."""
    every = [(layer.weight, layer.bias, layer.pool) for layer in net.hidden] + [(net.weight, net.bias, 1)]
    return (
        np.concatenate([weight.ravel() for weight, _, _ in every]),
        np.concatenate([bias for _, bias, _ in every]),
        np.array([net.input_size] + [len(bias) // pool for _, bias, pool in every]),
        np.array([pool for _, _, pool in every]),
    )


def distinct(points):
    """The number of points that are farther than 1e-9 from each other."""
    return len({tuple(np.round(x, 9) + 0.0) for x in points})


@pytest.mark.parametrize("P", SHAPES)
def test_vertices_are_those_of_exact_polytopes(P):
    exact = np.array(ExactPolytope.of(P).vertices, float)
    found = CellComplex.of([P]).vertices(0)
    near = np.abs(found[:, None] - exact).max(axis=2)
    assert near.min(axis=1).max() < 1e-12 and near.min(axis=0).max() < 1e-12 and distinct(found) == len(exact)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_random_polytopes_have_the_vertices_of_exact_ones(n):
    rng = np.random.default_rng(n)
    for _ in range(5):
        P = Polytope.box(-np.ones(n), np.ones(n)) & Polytope(rng.normal(size=(4, n)), rng.uniform(0.1, 1, 4))
        exact, found = np.array(ExactPolytope.of(P).vertices, float), CellComplex.of([P]).vertices(0)
        near = np.abs(found[:, None] - exact).max(axis=2)
        assert near.min(axis=1).max() < 1e-11 and near.min(axis=0).max() < 1e-11


@pytest.mark.parametrize("P", SHAPES)
def test_parts_on_both_sides_of_a_row_share_what_lies_on_it(P):
    row = np.array([[1.0, 1, 1, 0.2]])
    below, _ = CellComplex.of([P]).clip(row)
    above, _ = CellComplex.of([P]).clip(-row)
    both = P & Polytope(np.vstack([row[:, :3], -row[:, :3]]), [0.2, -0.2])
    on_row = [part.points[np.abs(part.points @ row[0, :3] - 0.2) < 1e-12] for part in (below, above)]
    expected = 0 if both.is_empty else len(ExactPolytope.of(both).vertices)
    assert [distinct(points) for points in on_row] == [expected, expected]
    assert len(below) + len(above) >= 1


@pytest.mark.parametrize("n", [1, 3, 4])
def test_heights_are_proven_and_close(n):
    rng = np.random.default_rng(n)
    P = Polytope.box(-np.ones(n), np.ones(n)) & Polytope(rng.normal(size=(3, n)), rng.uniform(0.1, 1, 3))
    V = np.vstack([box_directions(n), rng.normal(size=(5, n))])
    nothing = np.zeros((0, len(V)))
    maps = (np.eye(n)[None], np.zeros((1, n)), np.zeros((1, n)), np.zeros(1, int), np.zeros((1, len(V))))
    heights, tops = CellComplex.of([P]).heights((*maps, nothing, nothing, V))
    for k, v in enumerate(V):
        exact = P.exact_maximum(v).value
        assert exact <= binary(tops[0, k]) and float(tops[0, k] - heights[0, k]) < 1e-12 * np.abs(v).sum()


@pytest.mark.parametrize(("n", "pool", "depth"), [(1, 2, 2), (2, 3, 2), (3, 2, 2), (3, 3, 1), (4, 2, 1)])
def test_pieces_cover_the_domain_and_follow_the_network(n, pool, depth):
    rng = np.random.default_rng([n, pool])
    net = random_network(rng, n, 2, layers=depth, width=4, pool=pool)
    X = Polytope.box(-np.ones(n), np.ones(n))
    found, owner, K, g, error = CellComplex.of([X]).affine_pieces(layers(net), 10_000)
    assert (owner == 0).all() and error.max() < 1e-11
    for x in X.sample(rng, 40):
        inside = [i for i in range(len(found)) if found.polytope(i).contains(x, 1e-12)]
        u = evaluate(net, x)
        assert inside and all((np.abs(K[i] @ x + g[i] - u) <= error[i] + 1e-14).all() for i in inside)


def test_number_of_pieces_is_that_of_the_activation_patterns():
    rng = np.random.default_rng(8)
    net = random_network(rng, 3, 1, layers=1, width=6)
    X = Polytope.box([-1, -1, -1], [1, 1, 1])
    z = X.sample(rng, 20_000) @ net.hidden[0].weight.T + net.hidden[0].bias
    patterns = np.unique(z.reshape(len(z), -1, 2).argmax(axis=2), axis=0)
    assert len(CellComplex.of([X]).affine_pieces(layers(net), 10_000)[0]) >= len(patterns) > 10


def test_equal_channels_give_one_piece():
    weight = np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, 1.0, 0]])
    network = (np.concatenate([weight.ravel(), [1.0, 1.0]]), np.zeros(5), np.array([3, 2, 1]), np.array([2, 1]))
    assert len(CellComplex.of([CUBE]).affine_pieces(network, 10)[0]) == 1


def test_too_many_pieces_are_named():
    net = random_network(np.random.default_rng(0), 3, 1, layers=2, width=6)
    with pytest.raises(CellLimitError, match=r"more than 5 cells.*milp"):
        CellComplex.of([CUBE]).affine_pieces(layers(net), 5)


def test_too_many_states_are_named():
    n = MOST_STATES + 1
    with pytest.raises(CellLimitError, match=r"2\^13 vertices"):
        CellComplex.of([Polytope.box(-np.ones(n), np.ones(n))])


def test_cells_with_many_rows_find_room():
    """More rows than one integer of a mask has bits, and more vertices than a kernel starts with room for."""
    rng = np.random.default_rng(0)
    H = rng.normal(size=(400, 3))
    P = Polytope(H / np.linalg.norm(H, axis=1)[:, None], np.ones(400))
    found = CellComplex.of([P])
    assert found.counts[0, 0] > 512 and found.masks.shape[1] > 4
    assert (found.points @ P.H.T).max() < 1 + 1e-12


def test_taken_cells_keep_their_rows():
    rng = np.random.default_rng(3)
    net = random_network(rng, 3, 1, layers=1, width=4)
    found = CellComplex.of([CUBE]).affine_pieces(layers(net), 1000)[0]
    chosen = np.array([2, 0])
    taken = found.take(chosen)
    for i, j in enumerate(chosen):
        assert (taken.vertices(i) == found.vertices(j)).all()
        assert taken.polytope(i).equals(found.polytope(j))


@pytest.mark.parametrize(("beyond", "left"), [(-1e-14, 1), (0.0, 1), (1e-14, 0), (1e-9, 0)])
def test_a_part_is_left_out_only_if_it_is_empty(beyond, left):
    corner = np.array([[-1.0, -1, -1, -3.0 - beyond]])
    assert len(CellComplex.of([CUBE]).clip(corner)[0]) == left


def test_vertices_satisfy_the_rows_up_to_rounding():
    rng = np.random.default_rng(5)
    P = Polytope.box(-np.ones(4), np.ones(4)) & Polytope(rng.normal(size=(10, 4)), rng.uniform(0.1, 1, 10))
    for x in CellComplex.of([P]).points:
        worst = max(dot(a, binary(x)) - b for a, b in zip(*P.exact))
        assert Fraction(int(worst.p), int(worst.q)) < Fraction(1, 10**12)
