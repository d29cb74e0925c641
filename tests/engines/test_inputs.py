"""Phi has to lie in U on all of X: one check for all engines, and no state without an input is lost before it."""

from fractions import Fraction

import numpy as np
import pytest
from loops import affine_loop, exact_input, in_other_units, narrow_spike, random_network

import mireach as mr
from mireach import Polytope
from mireach.engines.inputs import violating_state
from mireach.engines.registry import ENGINES


def beside(F):
    """A small box inside F, far from its corners."""
    return F.scale(0.1)


def loop_with(net, n=2, repeated=True):
    """x+ = 0.4 x + 0.1 u on |x| <= 1, |u| <= 1; the region repeats these limits, or not."""
    m = net.output_size
    X, U = Polytope.box([-1] * n, [1] * n), Polytope.box([-1] * m, [1] * m)
    region = X.product(U) if repeated else Polytope(np.zeros((1, n + m)), [1.0])
    return mr.ClosedLoop(mr.PWASystem([mr.Mode(0.4 * np.eye(n), np.full((n, m), 0.1), np.zeros(n), region)], X, U), net)


@pytest.mark.parametrize("repeated", [True, False])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_spike_over_u_at_a_corner_is_found_wherever_the_question_is(engine, repeated):
    spike = mr.Layer([[1e3, 1e3], [0, 0]], [-1.98e3, 0], 2)  # max(1000 (x1 + x2 - 1.98), 0) is 20 at (1, 1)
    loop = loop_with(mr.MaxoutNetwork((spike,), [[1.0]], [0.0]), repeated=repeated)
    X = loop.system.state_set
    for ask in (lambda: mr.support(loop, beside(X), np.eye(2), engine=engine), lambda: mr.check_rpi(loop, X, engine)):
        with pytest.raises(ValueError, match=r"leaves the input set by .*x = \[.*saturate"):
            ask()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_spike_between_samples_is_found(engine):
    loop = narrow_spike()
    with pytest.raises(ValueError, match=r"leaves the input set by 1.*x = \[0\.71"):
        mr.support(loop, beside(loop.system.state_set), np.eye(2), engine=engine)


@pytest.mark.parametrize("excess", [2.0**-52, 2.0**-45, 1e-9, 1e-3])
@pytest.mark.parametrize("n", [2, 3, 4])
def test_an_excess_is_one_however_small(n, excess):
    rest = [0.0] * (n - 2)
    for net, violates in (
        (mr.MaxoutNetwork((), [[0.5, 0.5, *rest]], [0.0]), False),
        (mr.MaxoutNetwork((), [[0.5 + excess, 0.5, *rest]], [0.0]), True),
        (mr.MaxoutNetwork((), [[0.5 + excess, 0.5, *rest]], [0.0]).saturate(-1, 1), False),
    ):
        state = violating_state(loop_with(net, n), Polytope.box([-1], [1]))
        assert (state is not None) == violates
        if violates:
            assert exact_input(net, state.tolist())[0] ** 2 > 1


@pytest.mark.parametrize(("excess", "violates"), [(1e-9, False), (1e-3, True)])
def test_with_too_many_pieces_the_milp_decides_to_within_its_tolerance(monkeypatch, excess, violates):
    monkeypatch.setattr("mireach.engines.inputs.FEW_CELLS", 0)
    net = mr.MaxoutNetwork([mr.Layer([[1.0, 0, 0], [0, 1.0, 0]], [0, 0], 2)], [[1 + excess]], [0.0])
    assert (violating_state(loop_with(net, 3), Polytope.box([-1], [1])) is not None) == violates


@pytest.mark.parametrize(("n", "m"), [(2, 1), (2, 3), (3, 1), (3, 2)])
def test_random_networks_leave_u_where_samples_do(n, m):
    """U ends a little beyond what samples reach, or a little before: then one of them lies outside."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        net, X = random_network(rng, n, m, layers=1), Polytope.box([-1] * n, [1] * n)
        corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * n)).reshape(n, -1).T
        u = net(np.vstack([rng.uniform(-1, 1, (4000, n)), corners]))
        low, high = u.min(axis=0), u.max(axis=0)
        room = 0.2 * (high - low)
        loop = mr.ClosedLoop(
            mr.PWASystem(
                [mr.Mode(0.4 * np.eye(n), np.zeros((n, m)), np.zeros(n), Polytope(np.zeros((1, n + m)), [1.0]))],
                X,
                Polytope.box(low - room, high + room),
            ),
            net,
        )
        assert violating_state(loop, Polytope.box(low - room, high + room)) is None
        tight = Polytope.box(low + 0.01 * room, high - 0.01 * room)
        state = violating_state(loop, tight)
        assert state is not None and X.contains(state, tol=1e-9) and not tight.contains(net(state))


def test_the_answer_does_not_depend_on_units():
    loop = loop_with(mr.MaxoutNetwork((), [[0.51, 0.51]], [0.0]), repeated=True)
    other = in_other_units(loop, np.array([2.0**-50, 2.0**20]), np.array([2.0**40]))
    with pytest.raises(ValueError, match="leaves the input set"):
        mr.safe_set(other)


def test_saturated_networks_touch_u_and_are_let_through_by_every_engine():
    net = random_network(np.random.default_rng(3), 2, 1).saturate([-0.1], [0.3])
    loop = affine_loop(0.5 * np.eye(2))
    loop = mr.ClosedLoop(mr.PWASystem(loop.system.modes, loop.system.state_set, Polytope.box([-0.1], [0.3])), net)
    for engine in ENGINES:
        assert (mr.support(loop, loop.system.state_set, np.eye(2), engine=engine).bound < 1).all()


@pytest.mark.parametrize("row", range(4))
def test_an_excess_by_one_rounding_is_found_in_every_row_of_u(row):
    """Phi is the constant w b along one axis, and U ends at the float nearest to it, on one side or the other."""
    side, axis, seen = 1 if row < 2 else -1, row % 2, set()
    for w, b in np.random.default_rng(row).uniform(0.1, 1, (10, 2)):
        weight, limits = np.zeros((2, 1)), np.full(4, 2.0)
        weight[axis], limits[row] = side * w, w * b
        net = mr.MaxoutNetwork((mr.Layer(np.zeros((2, 2)), [b, 0], 2),), weight, np.zeros(2))
        violates = Fraction(w) * Fraction(b) > Fraction(w * b)
        U = Polytope(np.vstack([np.eye(2), -np.eye(2)]), limits)
        assert (violating_state(loop_with(net), U) is not None) == violates
        seen.add(violates)
    assert seen == {True, False}
