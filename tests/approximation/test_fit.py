"""Fits and their error sets against closed formulas and the paper's numbers."""

import warnings

import numpy as np
import pytest

pytest.importorskip("flint")

from fits import DI, NINE, ROUNDING, SMOOTH, U2, X6, double_integrator, errors_at, slabs

import mireach as mr
from mireach.approximation.error_bound import error_directions, prove_error
from mireach.approximation.fit import fit_pwa

# -- the paper's second case study ----------------------------------------------------------------


@pytest.mark.parametrize(("grid", "printed"), [(9, 0.1167), (10, 0.118519), (11, 0.1200)])
def test_least_squares_has_the_papers_error(grid, printed):
    fit = fit_pwa(DI, NINE, grid=grid)
    assert fit.max_error == pytest.approx(printed, abs=1e-4 if grid != 10 else 1e-6)
    assert fit.proven_error == pytest.approx(fit.max_error, abs=1e-12)
    assert fit.proof.complete.all()


def test_the_error_follows_the_formula_for_a_grid_of_any_size():
    # on each axis the fit of q = 0.025 x^2 is its mean over the grid points; both axes add up
    for grid in (2, 5, 17):
        middle = np.mean(0.025 * np.linspace(-2, 2, grid) ** 2)
        fit = fit_pwa(DI, NINE[4:5], state_set=mr.Polytope.box([-2, -2], [2, 2]), grid=grid)
        upper, lower = 2 * (0.1 - middle), -2 * middle
        assert fit.proven_error == pytest.approx(max(upper, -lower), abs=1e-12)
        assert np.ravel(fit.error_range) == pytest.approx([lower, lower, upper, upper], abs=1e-12)


def test_fine_grids_approach_the_continuous_least_squares_fit():
    # the mean of 0.025 x^2 over [-2, 2] is 1/30, so the corner is off by 2 (1/10 - 1/30)
    square, axis = mr.Polytope.box([-2, -2], [2, 2]), mr.Polytope.box([0], [0])
    fits = [fit_pwa(lambda x, u: double_integrator(x, u), NINE[4:5], square, axis, grid=g) for g in (20, 40, 80)]
    gaps = [2 * (0.1 - 1 / 30) - fit.proven_error for fit in fits]
    assert 0 < gaps[2] < 0.6 * gaps[1] < 0.4 * gaps[0] and gaps[2] < 2e-3


def test_error_range_and_segment_of_the_ten_point_fit():
    fit = fit_pwa(DI, NINE, error="polytope")
    lower, upper = fit.error_range
    assert lower == pytest.approx(np.full((9, 2), -0.0815), abs=1e-4)
    assert upper == pytest.approx(np.full((9, 2), 0.1185), abs=1e-4)
    across = fit.proof.bound[:, [5, 6]]  # along (1, -1) and (-1, 1)
    assert (np.abs(across) < 1e-13).all() and (across.sum(axis=1) >= 0).all()
    for mode in fit.modes:
        ends = mode.disturbance.vertices()
        assert ends.shape == (2, 2)
        assert np.sort(ends[:, 0]) == pytest.approx([-0.081481, 0.118519], abs=1e-6)
        assert ends[:, 0] == pytest.approx(ends[:, 1], abs=1e-12)


def test_minimax_halves_the_range_and_is_symmetric():
    fit = fit_pwa(DI, NINE, method="minimax")
    assert fit.proven_error == pytest.approx(0.1, abs=1e-9)
    lower, upper = fit.error_range
    assert lower == pytest.approx(-upper, abs=1e-14)
    for mode in fit.modes:
        points = mode.region.sample(np.random.default_rng(1), 2000)
        assert np.abs(errors_at(double_integrator, mode, points)).max() <= fit.proven_error + ROUNDING


def test_error_sets_as_box_ball_and_polytope():
    fit = fit_pwa(DI, NINE)
    box = fit.modes[0].disturbance
    assert np.ravel(box.bounding_box()) == pytest.approx([-0.081481, -0.081481, 0.118519, 0.118519], abs=1e-6)
    ball = fit.with_error("ball").modes[0].disturbance
    assert np.ravel(ball.bounding_box()) == pytest.approx(fit.proven_error * np.array([-1, -1, 1, 1]))
    assert fit.with_error("polytope").modes[0].disturbance.is_subset(box, tol=1e-12)
    assert box.is_subset(ball, tol=1e-12)
    system = fit.with_error("polytope").system()
    assert isinstance(system, mr.PWASystem) and len(system.modes) == 9


def test_a_fit_is_shown_in_one_line_and_its_system_reads_back():
    fit = fit_pwa(DI, NINE)
    assert str(fit) == (
        "PWAFit(9 modes, least_squares on 10 points per axis, largest error 0.118519 at them, 0.118519 proven)"
    )
    assert str(fit.proof).startswith("ErrorProof(9 modes, 8 directions, largest bound 0.237037, largest gap ")
    system = fit.system()
    assert mr.PWASystem.from_dict(system.to_dict()).to_dict() == system.to_dict()


def test_each_mode_may_have_its_own_error():
    def f(x, u):
        return [np.exp(x[0]) + u[0]]

    X, U = mr.Polytope.box([-1], [1]), mr.Polytope.box([-1], [1])
    shared = fit_pwa(f, slabs([1.0, 0.0], 0.0), X, U)
    own = shared.with_error("box", per_mode=True)
    assert shared.modes[0].disturbance.h.tolist() == shared.modes[1].disturbance.h.tolist()
    assert shared.modes[0].disturbance.h[0] == max(mode.disturbance.h[0] for mode in own.modes)
    assert own.modes[0].disturbance.h[0] < 0.5 * own.modes[1].disturbance.h[0]
    assert own.errors.max() == shared.proven_error
    assert own.with_error("ball").per_mode


def test_an_affine_function_has_no_error():
    fit = fit_pwa(lambda x, u: [0.3 * x[0] - 2 * u[0] + 0.7], slabs([1.0, 0.0], 0.0), *[mr.Polytope.box([-1], [1])] * 2)
    assert fit.proven_error < 1e-14 and fit.max_error < 1e-14
    assert fit.modes[0].B == pytest.approx(np.array([[-2.0]]))


def test_one_and_three_states():
    X, U = mr.Polytope.box([-1] * 3, [1] * 3), mr.Polytope.box([-1], [1])
    fit = fit_pwa(lambda x, u: [x[0], x[1] * x[2] / 4, np.sin(x[2]) + u[0]], [X.product(U)], X, U, grid=4)
    assert error_directions(3).shape == (18, 3) and error_directions(1).tolist() == [[1], [-1]]
    assert fit.proof.bound[0, [1, 4]] == pytest.approx([0.25, 0.25], abs=1e-8)
    assert fit.system().state_size == 3


# -- units ----------------------------------------------------------------------------------------


UNITS = {
    "double integrator": (double_integrator, lambda X, U: [X.product(U)]),
    "slanted regions": (SMOOTH["sine and exponential"], lambda X, U: slabs((1.0, 0.7, 0.3), 0.1)),
    "products": (SMOOTH["products"], lambda X, U: slabs((0.0, 1.0, 0.0), 0.25)),
}


@pytest.mark.parametrize("name", UNITS)
@pytest.mark.parametrize("method", ["least_squares", "minimax"])
@pytest.mark.parametrize(("k", "j"), [(-60, -60), (-60, 60), (-20, 7), (13, 0), (60, 60), (60, -60)])
def test_other_units_give_the_same_fit_and_the_same_bounds(name, method, k, j):
    f, make = UNITS[name]
    s, t = 2.0**k, 2.0**j  # units of x and u
    X, U = mr.Polytope.box([-2, -1], [2, 1.5]), mr.Polytope.box([-1], [1])
    regions = make(X, U)
    columns = np.array([s, s, t])
    scaled = [mr.Polytope(region.H / columns, region.h) for region in regions]

    def g(x, u):
        return [s * part for part in f([c / s for c in x], [c / t for c in u])]

    options = {"method": method, "grid": 5, "max_boxes": 300}
    here = fit_pwa(f, regions, X, U, **options)
    there = fit_pwa(
        g, scaled, mr.Polytope.box(*(s * end for end in X.bounding_box())), mr.Polytope.box([-t], [t]), **options
    )
    for mode, other in zip(here.modes, there.modes):
        np.testing.assert_allclose(other.A, mode.A, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(other.B * t / s, mode.B, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(other.p / s, mode.p, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(there.proof.bound / s, here.proof.bound, rtol=1e-8, atol=1e-11)
    assert (there.proof.complete == here.proof.complete).all() and (there.proof.unit == s * here.proof.unit).all()
    if name == "double integrator":
        again = prove_error(
            g, there.modes, mr.Polytope.box(*(s * end for end in X.bounding_box())), mr.Polytope.box([-t], [t])
        )
        np.testing.assert_allclose(again.bound, there.proof.bound, rtol=1e-8, atol=1e-11 * s)


# -- unusual regions ------------------------------------------------------------------------------


def test_a_region_outside_the_domain_needs_no_error_and_no_warning():
    far = mr.Polytope.box([10, 10, -2], [11, 11, 2])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = fit_pwa(DI, [*NINE, far], error="polytope", per_mode=True)
        assert len(fit.modes) == 10 and len(fit.system().modes) == 9
    assert fit.errors[-1] == 0 and fit.proof.boxes[-1] == 0 and (fit.proof.bound[-1] == -np.inf).all()
    assert fit.modes[-1].disturbance.vertices().tolist() == [[0, 0]]
    assert fit.proven_error == pytest.approx(0.118519, abs=1e-6)


def test_flat_and_thin_regions_are_fitted():
    flat = fit_pwa(DI, [mr.Polytope([[1, -1, 0], [-1, 1, 0]], [0, 0])], grid=5)  # the plane x1 = x2
    assert flat.proven_error == pytest.approx(0.9, abs=1e-9)  # half of 0.025 (6^2 + 6^2)
    rng = np.random.default_rng(0)
    t, u = rng.uniform(-6, 6, 1000), rng.uniform(-2, 2, 1000)
    assert np.abs(errors_at(double_integrator, flat.modes[0], np.column_stack([t, t, u]))).max() <= flat.proven_error
    thin = mr.Polytope([[1.0, -1.0, 0.01], [-1, 1, -0.01]], [0.013, -0.012])
    assert fit_pwa(DI, [thin], grid=3, max_boxes=50).proven_error > 0


# -- bad input ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"grid": 1}, "at least 2"),
        ({"grid": 2.5}, "whole number"),
        ({"method": "spline"}, "'least_squares', 'minimax'"),
        ({"error": "ellipsoid"}, "'box', 'polytope', 'ball'"),
        ({"regions": []}, "no regions"),
        ({"regions": [mr.Polytope.box([0], [1])]}, r"lies in R\^1"),
        ({"state_set": mr.Polytope([[1.0, 0.0]], [0.0])}, "state_set must be bounded"),
        ({"f": lambda x, u: [x[0]]}, r"shape \(1,\), but the state has 2"),
        ({"f": lambda x, u: [np.log(x[0]), x[1]]}, "must be finite"),
        ({"f": lambda x, u: [x[0] * np.nan, x[1]]}, "region 1"),
        ({"tol": -1.0}, "tol must not be negative"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning", "ignore:divide by zero:RuntimeWarning")
def test_bad_arguments_are_named(options, message):
    arguments = {"f": double_integrator, "regions": NINE[:1], "state_set": X6, "input_set": U2} | options
    with pytest.raises(ValueError, match=message):
        fit_pwa(**arguments)


def test_a_function_that_balls_do_not_have_is_refused():
    with pytest.raises(TypeError, match="numpy's exp"):
        fit_pwa(lambda x, u: [abs(x[0]), x[1]], NINE, X6, U2)
    with pytest.raises(TypeError, match="NonlinearSystem"):
        fit_pwa("f", NINE, X6, U2)
    with pytest.raises(TypeError, match="region 2 must be of the kind Polytope"):
        fit_pwa(double_integrator, [NINE[0], None], X6, U2)
    with pytest.raises(ValueError, match="needs state_set"):
        fit_pwa(double_integrator, NINE)
