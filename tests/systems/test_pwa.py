"""Modes and PWA systems: evaluation against the definition, files, and every bad argument is named."""

import json

import numpy as np
import pytest
from loops import random_loop
from modes import U, X, halves, mode

from mireach import Mode, Polytope, PWASystem
from mireach.errors import MireachError

# -- evaluation ---------------------------------------------------------------------------------------


def test_violation_is_zero_in_every_closed_region_that_holds_the_point():
    system = PWASystem(halves([1, 0, 1], 0.5, 0.5), X, U)
    found = system.violation(np.array([[0.5, 1.0], [0.0, 0.0], [1.0, 0.0]]), np.array([[0.0], [0.0], [0.0]]))
    np.testing.assert_allclose(found, [[0, 0], [0, 0.5], [0.5, 0]])


def test_successor_and_default_disturbance():
    first = Mode([[1, 2], [0, 1.0]], [[0.0], [1]], [0.5, 0], Polytope([[1.0, 0, 0]], [9.0]))
    assert first.successor(np.array([1.0, 1.0]), np.array([2.0])).tolist() == [3.5, 3.0]
    assert first.disturbance.vertices().tolist() == [[0, 0]]


def test_with_disturbance_replaces_one_or_all():
    system = PWASystem(halves([1, 0, 0], 0, 0), X, U)
    D, E = Polytope.box([-1, 0], [1, 0]), Polytope.box([0, 0], [0, 1])
    assert all(part.disturbance is D for part in system.with_disturbance(D).modes)
    assert [part.disturbance for part in system.with_disturbance([D, E]).modes] == [D, E]
    assert system.modes[0].disturbance is not D
    with pytest.raises(ValueError, match="3 disturbance sets for 2 modes"):
        system.with_disturbance([D, D, D])


def test_maps_and_regions_of_all_modes_at_once():
    rng = np.random.default_rng(0)
    loop = random_loop(5, cuts=3, with_input=True)
    system, x = loop.system, loop.system.state_set.sample(rng, 50)
    u, modes = rng.normal(size=(50, 1)), rng.integers(0, len(system.modes), 50)
    wanted = [system.modes[i].successor(x[t], u[t]) for t, i in enumerate(modes)]
    np.testing.assert_allclose(system.successor(x, u, modes), wanted, atol=1e-12)
    for region, one in zip(system.state_regions(), system.modes):
        of_x = one.region.H[:, 2] == 0
        inside = (x @ one.region.H[of_x, :2].T <= one.region.h[of_x]).all(axis=1) & system.state_set.contains(x)
        assert region.contains(x).tolist() == inside.tolist()


# -- files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_a_system_reads_back_from_json_to_the_same_bits(seed):
    system = random_loop(seed, cuts=2, with_input=True).system
    again = PWASystem.from_dict(json.loads(json.dumps(system.to_dict())))
    for first, second in zip(system.modes, again.modes, strict=True):
        for name in "ABp":
            assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
        for part in ("region", "disturbance"):
            assert getattr(first, part).to_dict() == getattr(second, part).to_dict()
    assert again.to_dict() == system.to_dict() and repr(again) == repr(system)


@pytest.mark.parametrize("key", ["modes", "state_set", "input_set"])
def test_a_system_without_one_of_its_keys_is_refused(key):
    value = PWASystem(halves([1, 0, 0], 0, 0), X, U).to_dict()
    del value[key]
    with pytest.raises(ValueError, match="a system needs the keys modes, state_set, input_set"):
        PWASystem.from_dict(value)
    with pytest.raises(ValueError, match="must be a list"):
        PWASystem.from_dict(value | {key: {}, "modes": {}})
    with pytest.raises(ValueError, match="a mode needs the keys A, B, p, region, disturbance"):
        Mode.from_dict({"A": [[1.0]]})


def test_systems_and_modes_are_shown_by_their_sizes():
    system = PWASystem(halves([1, 0, 0], 0, 0), X, U)
    assert str(system) == "PWASystem(2 modes, 2 states, 1 input)"
    assert str(system.modes[0]) == "Mode(2 states, 1 input, 1 row)"


# -- bad input ----------------------------------------------------------------------------------------

everywhere = Polytope([[1.0, 0, 0]], [50.0])
BAD = [
    (lambda: mode(Polytope([[1.0, 0, 0], [0, 0, 0]], [1.0, -1.0])), ["row 2 of region says 0 <= -1"]),
    (lambda: Mode([[1, 0]], [[1.0]], [0.0], everywhere), ["A has shape (1, 2)", "square"]),
    (lambda: Mode(np.eye(2), [[1.0]], [0.0, 0], everywhere), ["B has 1 rows", "A has 2"]),
    (lambda: Mode(np.eye(2), np.ones((2, 1)), [0.0], everywhere), ["p has shape (1,)", "2"]),
    (lambda: Mode([[np.nan, 0], [0, 1]], np.ones((2, 1)), [0.0, 0], everywhere), ["A must be finite", "(0, 0)"]),
    (lambda: Mode(np.eye(2), [[1.0], [np.inf]], [0.0, 0], everywhere), ["B must be finite", "(1, 0)"]),
    (lambda: mode(Polytope([[1.0, 0]], [1.0])), ["region lies in R^2", "2 + 1"]),
    (lambda: mode(everywhere, Polytope.box([0], [1])), ["disturbance lies in R^1", "2 entries"]),
    (lambda: mode(everywhere, Polytope([[1.0, 0], [-1, 0]], [0, -1])), ["disturbance is an empty set", "None"]),
    (lambda: mode(everywhere, Polytope([[1.0, 0]], [0])), ["disturbance is unbounded"]),
    (lambda: PWASystem([], X, U), ["modes is empty"]),
    (lambda: PWASystem([mode(everywhere)], U, U), ["state_set lies in R^1", "R^2"]),
    (lambda: PWASystem([mode(everywhere)], X, X), ["input_set lies in R^2", "R^1"]),
    (lambda: PWASystem([mode(everywhere)], X & Polytope([[1.0, 0]], [-3]), U), ["state_set is empty"]),
    (lambda: PWASystem([mode(everywhere)], Polytope([[1.0, 0]], [1]), U), ["state_set is unbounded"]),
    (lambda: PWASystem([mode(everywhere)], X, Polytope([[1.0]], [1])), ["input_set is unbounded"]),
    (lambda: PWASystem([mode(everywhere)], X, Polytope([[1.0], [-1.0]], [0, -1])), ["input_set is empty"]),
    (
        lambda: PWASystem([mode(everywhere), mode(Polytope([[1.0, 0, 0, 0]], [1]), m=2)], X, U),
        ["mode 2 has B of shape (2, 2)", "(2, 1)"],
    ),
]


@pytest.mark.parametrize(("make", "words"), BAD)
def test_bad_arguments_are_named(make, words):
    with pytest.raises(ValueError) as error:
        make()
    assert all(word in str(error.value) for word in words), str(error.value)
    assert not isinstance(error.value, MireachError)


@pytest.mark.parametrize(
    "make",
    [
        lambda: mode([[1.0, 0, 0]]),
        lambda: mode(everywhere, [1.0]),
        lambda: PWASystem([everywhere], X, U),
        lambda: PWASystem(mode(everywhere), X, U),
        lambda: PWASystem([mode(everywhere)], [[-2, 2]], U),
        lambda: PWASystem([mode(everywhere)], X, U).with_disturbance(0.1),
    ],
)
def test_wrong_types_raise_type_errors(make):
    with pytest.raises(TypeError, match="must be of the kind"):
        make()
