"""Proven errors against dense sampling, climbing and closed formulas."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("flint")

from fits import DI, NINE, ROUNDING, SMOOTH, errors_at, largest_by_climbing, slabs

import mireach as mr
from mireach.approximation import error_bound
from mireach.approximation.error_bound import error_directions, prove_error
from mireach.approximation.fit import fit_pwa
from mireach.tolerances import LEAST_ERROR

# -- against sampling -----------------------------------------------------------------------------


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
    assert (coarse.gap <= 0.1 * np.maximum(LEAST_ERROR * coarse.unit, np.abs(coarse.attained))).all()
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


# -- rounding and units ---------------------------------------------------------------------------


def test_a_moved_bound_is_rounded_upward():
    rng = np.random.default_rng(0)
    for n in (1, 2, 3):
        directions = np.vstack([error_directions(n), rng.normal(size=(20, n))])
        for _ in range(50):
            bound, before, after = rng.normal(size=len(directions)), rng.normal(size=n), rng.normal(size=n)
            moved = error_bound._shift(bound, before, after, directions)
            for v, old, new in zip(directions, bound, moved):
                step = sum(Fraction(c) * (Fraction(b) - Fraction(a)) for c, a, b in zip(v, before, after))
                assert Fraction(old) - step <= Fraction(new) <= np.nextafter(float(Fraction(old) - step), np.inf)
    assert error_bound._shift([-np.inf], [0.1], [0.2], [[1.0]]) == [-np.inf]


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


def test_numbers_too_far_apart_are_refused():
    X, U = mr.Polytope.box([-1e-200], [1e-200]), mr.Polytope.box([-1], [1])
    mode = mr.Mode([[0.0]], [[0.0]], [0.0], mr.Polytope([[1e-200, 1e-7]], [1.0]))
    with pytest.raises(ValueError, match="choose other units"):
        prove_error(lambda x, u: [x[0]], [mode], X, U)


# -- bad input ------------------------------------------------------------------------------------


def test_a_derivative_that_is_infinite_leaves_no_proof():
    X, U = mr.Polytope.box([0], [1]), mr.Polytope.box([0], [1])
    with pytest.raises(ValueError, match="no finite error could be proven in region 1"):
        fit_pwa(lambda x, u: [np.sqrt(x[0])], [X.product(U)], X, U, max_boxes=30)


def test_wrong_arguments_are_named():
    with pytest.raises(TypeError, match="mode 1 must be of the kind Mode"):
        prove_error(DI, NINE[:1])
    with pytest.raises(ValueError, match="max_boxes must be a whole number of at least 1"):
        prove_error(DI, fit_pwa(DI, NINE[:1]).modes, max_boxes=0)


def test_directions_of_the_wrong_size_are_refused():
    modes = fit_pwa(DI, NINE[:1]).modes
    with pytest.raises(ValueError, match="directions has shape"):
        prove_error(DI, modes, directions=[[1.0, 0.0, 0.0]])
