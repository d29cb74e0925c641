"""PWA systems: the regions must partition X x U, and every bad argument is named."""

import re
import warnings

import numpy as np
import pytest
from loops import cut_regions, random_loop

from mireach import Mode, NonlinearSystem, Polytope, PWASystem
from mireach.errors import MireachError

X, U = Polytope.box([-2, -2], [2, 2]), Polytope.box([-1], [1])


def mode(region, D=None, n=2, m=1):
    return Mode(np.eye(n), np.ones((n, m)), np.zeros(n), region, D)


def halves(normal, left, right):
    """The regions normal (x, u) <= left and normal (x, u) >= right."""
    normal = np.array([normal], float)
    return [mode(Polytope(normal, [left])), mode(Polytope(-normal, [-right]))]


# -- partitions ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("with_input", [False, True])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (2, 1), (2, 2), (3, 1)])
def test_random_partitions_are_accepted_and_a_missing_region_is_not(seed, with_input, n, m):
    rng = np.random.default_rng(seed)
    X, U = Polytope.box(-3 * np.ones(n), 3 * np.ones(n)), Polytope.box(-np.ones(m), np.ones(m))
    regions = cut_regions(rng, n, m, 3, with_input, 3.0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        PWASystem([mode(region, n=n, m=m) for region in regions], X, U)
        fat = [(X.product(U) & region).chebyshev()[1] > 1e-6 for region in regions]
        kept = [mode(region, n=n, m=m) for i, region in enumerate(regions) if i != np.argmax(fat)]
        with pytest.raises(ValueError, match="no region contains x = "):
            PWASystem(kept, X, U)
        with pytest.raises(ValueError, match="overlap around x = "):
            PWASystem([*kept, *2 * [mode(regions[int(np.argmax(fat))], n=n, m=m)]], X, U)


@pytest.mark.parametrize("normal", [[1, 0, 0], [0, 0, 1], [0.3, -1, 0.5]], ids=["x", "u", "x and u"])
def test_gaps_and_overlaps_are_found_and_shown(normal):
    PWASystem(halves(normal, 0.1, 0.1), X, U)
    with pytest.raises(ValueError, match=r"modes 1 and 2 overlap around x = \[.*\], u = \["):
        PWASystem(halves(normal, 0.1, 0.09), X, U)
    with pytest.raises(ValueError, match="must cover all") as error:
        PWASystem(halves(normal, 0.1, 0.11), X, U)
    assert 0.1 < np.dot(normal, shown_numbers(error)[:3]) < 0.11


def test_shown_gap_is_a_gap():
    with pytest.raises(ValueError) as error:
        PWASystem(halves([1, 1, 4], 0.0, 0.2), X, U)
    x1, x2, u = shown_numbers(error)[:3]
    assert 0 < x1 + x2 + 4 * u < 0.2 and X.contains([x1, x2]) and U.contains([u])


def shown_numbers(error):
    """The numbers of x = [...], u = [...] in a message."""
    return [float(number) for number in re.findall(r"-?\d+\.\d+", str(error.value))]


@pytest.mark.parametrize("scale", [2.0**-60, 1.0, 2.0**60])
@pytest.mark.parametrize("width", [2e-7, 1e-12, 2.0**-52])
def test_a_gap_is_found_however_narrow_and_its_rows_are_named(width, scale):
    X, far, edge = Polytope.box([-2 * scale] * 2, [2 * scale] * 2), 9 * scale, scale * (1 + width)
    below, above = Polytope([[1.0, 0, 0], [0, 1, 0]], [far, scale]), Polytope([[-1.0, 0, 0], [0, -1, 0]], [far, -edge])
    with pytest.raises(
        ValueError, match=r"between row 2 of mode 1 and row 2 of mode 2, in a gap of width .*same numbers"
    ):
        PWASystem([mode(below), mode(above)], X, U)


def test_a_boundary_has_to_be_written_with_the_same_numbers():
    """1/3 as a float lies below one third, so that x1 <= 1/3 and 3 x1 >= 1 leave a gap; the other way they overlap."""
    third = mode(Polytope([[1.0, 0, 0]], [1 / 3])), mode(Polytope([[-3.0, 0, 0]], [-1.0]))
    with pytest.raises(ValueError, match="write it with the same numbers"):
        PWASystem(third, X, U)
    PWASystem([mode(Polytope([[3.0, 0, 0]], [1.0])), mode(Polytope([[-1.0, 0, 0]], [-1 / 3]))], X, U)
    short = float(np.float32(0.3))  # lies above 0.3
    PWASystem([mode(Polytope([[1.0, 0, 0]], [short])), mode(Polytope([[-1.0, 0, 0]], [-0.3]))], X, U)
    with pytest.raises(ValueError, match="write it with the same numbers"):
        PWASystem([mode(Polytope([[1.0, 0, 0]], [0.3])), mode(Polytope([[-1.0, 0, 0]], [-short]))], X, U)


def test_a_row_of_zeros_bounds_nothing_or_is_refused():
    PWASystem([mode(Polytope([[0.0, 0, 0], [1, 0, 0]], [0.0, 9]))], X, U)
    with pytest.raises(ValueError, match="row 2 of region says 0 <= -1"):
        mode(Polytope([[1.0, 0, 0], [0, 0, 0]], [1.0, -1.0]))


def test_regions_need_to_cover_only_what_is_in_the_domain():
    PWASystem([mode(Polytope([[1.0, 0, 0]], [2.0]))], X, U)
    with pytest.raises(ValueError, match="must cover all"):
        PWASystem([mode(Polytope([[1.0, 0, 0]], [1.9]))], X, U)


def test_mode_that_misses_the_domain_only_warns():
    far = mode(Polytope([[-1.0, 0, 0]], [-50.0]))
    everywhere = mode(Polytope([[1.0, 0, 0]], [50.0]))
    with pytest.warns(UserWarning, match=r"mode 2 does not meet X x U"):
        system = PWASystem([everywhere, far], X, U)
    assert len(system.modes) == 2


def test_flat_state_set_is_accepted():
    segment = Polytope.box([-1, 0], [1, 0])
    assert PWASystem(halves([1, 0, 0], 0, 0), segment, U).state_size == 2


# -- what a system says -------------------------------------------------------------------------------


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


def test_nonlinear_system_on_points_and_batches():
    plant = NonlinearSystem(lambda x, u: (x[1], x[0] * u[0]), X, U)
    assert plant([1.0, 2.0], [3.0]).tolist() == [2.0, 3.0]
    assert plant([[1.0, 2.0], [0.0, 1.0]], [[3.0], [4.0]]).tolist() == [[2.0, 3.0], [1.0, 0.0]]
    with pytest.raises(ValueError, match="x has shape"):
        plant([1.0], [3.0])


# -- bad input ----------------------------------------------------------------------------------------

everywhere = Polytope([[1.0, 0, 0]], [50.0])
BAD = [
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


def test_maps_and_regions_of_all_modes_at_once():
    rng = np.random.default_rng(0)
    loop = random_loop(5, cuts=3, with_input=True)
    system, x = loop.system, loop.system.state_set.sample(rng, 50)
    u, modes = rng.normal(size=(50, 1)), rng.integers(0, len(system.modes), 50)
    wanted = [system.modes[i].successor(x[t], u[t]) for t, i in enumerate(modes)]
    np.testing.assert_allclose(system.successor(x, u, modes), wanted, atol=1e-12)
    for region, mode in zip(system.state_regions(), system.modes):
        of_x = mode.region.H[:, 2] == 0
        inside = (x @ mode.region.H[of_x, :2].T <= mode.region.h[of_x]).all(axis=1) & system.state_set.contains(x)
        assert region.contains(x).tolist() == inside.tolist()


def test_regions_on_which_the_dual_simplex_stalls_are_checked_all_the_same():
    loop = random_loop(2275, cuts=3, with_input=True, saturated=True, layers=1, width=2, pool=1)  # "Unknown" by HiGHS
    assert len(loop.system.modes) == 4
