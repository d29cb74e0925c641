"""Fits and proven errors against dense sampling, closed formulas and the paper's numbers."""

import warnings
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

pytest.importorskip("flint")

import mireach as mr
from mireach.approximation import fit as approximation
from mireach.approximation.fit import SMALL, error_directions, fit_pwa, prove_error

X6, U2 = mr.Polytope.box([-6, -6], [6, 6]), mr.Polytope.box([-2], [2])
NINE = [mr.Polytope.box([k - 2, j - 2, -2], [k + 2, j + 2, 2]) for k in (-4, 0, 4) for j in (-4, 0, 4)]
ROUNDING = 1e-13  # of f - f_PWA in floating point, against a bound that has none


def double_integrator(x, u):
    """Eq. NL_DI."""
    square = 0.025 * (x[0] ** 2 + x[1] ** 2)
    return [x[0] + x[1] + 0.5 * u[0] + square, x[1] + u[0] + square]


DI = mr.NonlinearSystem(double_integrator, X6, U2)


def errors_at(f, mode, points):
    """f - A x - B u - p at points (N, n+m), array (N, n)."""
    n = len(mode.A)
    x, u = points[:, :n], points[:, n:]
    return np.stack(np.broadcast_arrays(*f(x.T, u.T)), axis=-1) - mode.successor(x, u)


def largest_by_climbing(f, mode, part, directions, rng):
    """Largest v e found by random points, vertices, and SLSQP from the best of them, (k,)."""
    points = np.vstack([part.sample(rng, 3000), part.vertices()])
    errors = errors_at(f, mode, points) @ directions.T
    rows = {"type": "ineq", "fun": lambda z: part.h - part.H @ z, "jac": lambda z: -part.H}
    best = errors[part.contains(points)].max(axis=0)
    for k, v in enumerate(directions):
        for start in points[np.argsort(errors[:, k])[[-1, -20, -200]]]:
            answer = minimize(
                lambda z, v=v: -errors_at(f, mode, z[None])[0] @ v,
                start,
                method="SLSQP",
                constraints=[rows],
                options={"ftol": 1e-13, "maxiter": 100},
            )
            inside = answer.x + 1e-8 * (part.chebyshev()[0] - answer.x)
            if part.contains(inside):
                best[k] = max(best[k], errors_at(f, mode, inside[None])[0] @ v)
    return best


def slabs(normal, offset):
    """The two halves of space on either side of normal z = offset."""
    return [mr.Polytope([normal], [offset]), mr.Polytope([-np.asarray(normal)], [-offset])]


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


# -- proofs against sampling ----------------------------------------------------------------------


SMOOTH = {
    "sine and exponential": lambda x, u: [np.sin(x[0]) + 0.3 * np.exp(0.5 * x[1]) + u[0], np.tanh(x[0]) + 0.5 * u[0]],
    "pendulum": lambda x, u: [x[0] + 0.1 * x[1], x[1] + 0.1 * np.sin(x[0]) + 0.1 * u[0]],
    "products": lambda x, u: [x[0] * u[0] + np.cos(x[1]), x[1] * x[0] ** 3],
    "fractions": lambda x, u: [x[0] / (3 + x[1]), np.sqrt(4 + x[1]) * u[0] + np.log(3 + x[0])],
}


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("normal", [(1.0, 0.0, 0.0), (1.0, 0.7, 0.3)])
def test_sampling_never_exceeds_the_bound_and_comes_close(name, normal):
    f, rng = SMOOTH[name], np.random.default_rng(3)
    X, U = mr.Polytope.box([-2, -1], [2, 1.5]), mr.Polytope.box([-1], [1])
    fit = fit_pwa(f, slabs(normal, 0.1), X, U, grid=6)
    directions = fit.proof.directions
    assert fit.proof.complete.all()
    for i, mode in enumerate(fit.modes):
        found = largest_by_climbing(f, mode, X.product(U) & mode.region, directions, rng)
        assert (found <= fit.proof.bound[i] + ROUNDING).all()
        assert found == pytest.approx(fit.proof.bound[i], abs=1e-6)
    assert fit.max_error <= fit.proven_error + ROUNDING


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_random_functions_on_random_polytopes(seed):
    rng = np.random.default_rng(seed)
    W, a = rng.normal(size=(2, 3)), rng.normal(size=4)

    def f(x, u):
        y = [w[0] * x[0] + w[1] * x[1] + w[2] * u[0] for w in W]
        return [a[0] * np.tanh(y[0]) + a[1] * x[0] * x[1], a[2] * np.exp(0.3 * y[1]) + a[3] * np.sin(x[0])]

    normals = rng.normal(size=(3, 3))
    region = mr.Polytope(normals, np.linalg.norm(normals, axis=1) * rng.uniform(0.2, 1, 3))
    X, U = mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([-1], [1])
    fit = fit_pwa(f, [region], X, U, grid=7, tol=1e-3, max_boxes=150, method=("least_squares", "minimax")[seed % 2])
    part = X.product(U) & region
    points = np.vstack([part.sample(rng, 5000), part.vertices()])
    errors = errors_at(f, fit.modes[0], points) @ fit.proof.directions.T
    assert (errors.max(axis=0) <= fit.proof.bound[0] + 1e-8).all()  # vertices lie inside to within 1e-9
    assert fit.error_sets[0].contains(errors_at(f, fit.modes[0], points), tol=1e-8).all()


def test_the_bound_is_sound_whatever_ends_the_search():
    f, rng = SMOOTH["sine and exponential"], np.random.default_rng(0)
    X, U = mr.Polytope.box([-2, -1], [2, 1.5]), mr.Polytope.box([-1], [1])
    modes = fit_pwa(f, [X.product(U)], X, U).modes
    found = largest_by_climbing(f, modes[0], X.product(U), error_directions(2), rng)
    proofs = [prove_error(f, modes, X, U, max_boxes=boxes) for boxes in (1, 5, 20, 100, 4000)]
    for proof in proofs:
        assert (found <= proof.bound[0] + ROUNDING).all()
    assert [proof.complete[0] for proof in proofs] == [False, False, False, False, True]
    assert all((after.bound <= before.bound).all() for before, after in pairwise(proofs))
    coarse = prove_error(f, modes, X, U, tol=0.1)
    assert coarse.complete[0] and coarse.boxes[0] < 0.2 * proofs[-1].boxes[0]
    assert (coarse.gap <= 0.1 * np.maximum(SMALL * coarse.unit, np.abs(coarse.attained))).all()
    assert coarse.unit.tolist() == [2, 1, 2, 1, 2, 2, 2, 2]  # half-widths of X, rounded down to powers of two


def test_a_maximum_inside_and_a_maximum_on_a_slanted_edge():
    X, U = mr.Polytope.box([-1, -1], [1, 1]), mr.Polytope.box([0], [0])
    region = mr.Polytope([[1.0, 1.0, 0.0]], [0.5])
    zero = mr.Mode(np.zeros((2, 2)), np.zeros((2, 1)), np.zeros(2), region)

    def f(x, u):
        return [np.exp(x[0] + x[1] - (x[0] - x[1]) ** 2), 1 - x[0] ** 2 - (x[1] + 0.3) ** 2]

    proof = prove_error(f, [zero], X, U, [[1, 0], [0, 1]])
    assert proof.bound[0] == pytest.approx([np.exp(0.5), 1], abs=1e-8)
    assert (proof.bound[0] >= [np.exp(0.5), 1]).all() and proof.complete[0]


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


# -- rounding and units ---------------------------------------------------------------------------


def test_a_moved_bound_is_rounded_upward():
    rng = np.random.default_rng(0)
    for n in (1, 2, 3):
        directions = np.vstack([error_directions(n), rng.normal(size=(20, n))])
        for _ in range(50):
            bound, before, after = rng.normal(size=len(directions)), rng.normal(size=n), rng.normal(size=n)
            moved = approximation._shift(bound, before, after, directions)
            for v, old, new in zip(directions, bound, moved):
                step = sum(Fraction(c) * (Fraction(b) - Fraction(a)) for c, a, b in zip(v, before, after))
                assert Fraction(old) - step <= Fraction(new) <= np.nextafter(float(Fraction(old) - step), np.inf)
    assert approximation._shift([-np.inf], [0.1], [0.2], [[1.0]]) == [-np.inf]


def test_a_third_is_no_float():
    X = U = mr.Polytope.box([-1], [1])
    nearest = mr.Mode([[0.0]], [[0.0]], [1 / 3], X.product(U))
    third, off = Fraction(1, 3), Fraction(1, 3) - Fraction(1 / 3)
    for f in (
        lambda x, u: [third],
        lambda x, u: [third + 0 * x[0]],
        lambda x, u: [(x[0] - u[0] + u[0] - x[0]) * 0 + third],
    ):
        above, below = prove_error(f, [nearest], X, U).bound[0]
        assert off <= Fraction(above) < off * (1 + Fraction(1, 2**50)) and -off <= Fraction(below) < 0


def test_fractions_may_stand_wherever_numbers_may():
    X = U = mr.Polytope.box([-1], [1])
    third = Fraction(1, 3)

    def f(x, u):
        return [np.sin(third * x[0]) * third + u[0] ** 2 / third - (x[0] + 2) ** third + third / (2 + x[0]) - third]

    def g(x, u):
        return [np.sin(x[0] / 3) / 3 + u[0] ** 2 * 3 - (x[0] + 2) ** (1 / 3) + 1 / 3 / (2 + x[0]) - 1 / 3]

    fits = [fit_pwa(h, [X.product(U)], X, U) for h in (f, g)]
    assert fits[0].proven_error == pytest.approx(fits[1].proven_error, abs=1e-12)
    points = X.product(U).sample(np.random.default_rng(0), 500)
    errors = [[f([x], [u])[0] - fits[0].modes[0].successor(np.array([x]), np.array([u]))[0]] for x, u in points]
    assert np.abs(errors).max() <= fits[0].proven_error + ROUNDING


WIDE = {
    "arcsinh": lambda x, u: [np.arcsinh(10 * x[0])],
    "arctan": lambda x, u: [np.arctan(10 * x[0])],
    "tanh": lambda x, u: [np.tanh(10 * x[0]) * (1 + u[0] / 9)],
    "square root": lambda x, u: [np.sqrt(1 + 100 * (x[0] * x[0]))],
    "quotient": lambda x, u: [x[0] / (1 + 100 * x[0] ** 2)],
    "fourth power": lambda x, u: [1 / (1 + 100 * x[0] ** 4)],
    "log cosh": lambda x, u: [np.log(np.cosh(10 * x[0]))],
    "log1p": lambda x, u: [np.log1p(10 * x[0] ** 2 + u[0] ** 2)],
}


@pytest.mark.parametrize("name", WIDE)
def test_functions_that_change_much_have_a_finite_bound_from_the_first_box_on(name):
    X = U = mr.Polytope.box([-1], [1])
    fit = fit_pwa(WIDE[name], [X.product(U)], X, U, max_boxes=1)
    assert np.isfinite(fit.proof.bound).all()
    points = np.array(np.meshgrid(np.linspace(-1, 1, 801), np.linspace(-1, 1, 5))).reshape(2, -1).T
    tight = fit_pwa(WIDE[name], [X.product(U)], X, U, max_boxes=1000)
    errors = errors_at(WIDE[name], tight.modes[0], points) @ tight.proof.directions.T
    assert (errors.max(axis=0) <= tight.proof.bound[0] + ROUNDING).all()
    assert errors.max(axis=0) == pytest.approx(tight.proof.bound[0], abs=1e-4)


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


def test_numbers_too_far_apart_are_refused():
    X, U = mr.Polytope.box([-1e-200], [1e-200]), mr.Polytope.box([-1], [1])
    mode = mr.Mode([[0.0]], [[0.0]], [0.0], mr.Polytope([[1e-200, 1e-7]], [1.0]))
    with pytest.raises(ValueError, match="choose other units"):
        prove_error(lambda x, u: [x[0]], [mode], X, U)


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
        ({"grid": 1}, "at least 2 points"),
        ({"grid": 2.5}, "at least 2 points"),
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
    with pytest.raises(ValueError, match="needs state_set"):
        fit_pwa(double_integrator, NINE)


def test_a_derivative_that_is_infinite_leaves_no_proof():
    X, U = mr.Polytope.box([0], [1]), mr.Polytope.box([0], [1])
    with pytest.raises(ValueError, match="no finite error could be proven in region 1"):
        fit_pwa(lambda x, u: [np.sqrt(x[0])], [X.product(U)], X, U, max_boxes=30)


def test_directions_of_the_wrong_size_are_refused():
    modes = fit_pwa(DI, NINE[:1]).modes
    with pytest.raises(ValueError, match="directions has shape"):
        prove_error(DI, modes, directions=[[1.0, 0.0, 0.0]])
