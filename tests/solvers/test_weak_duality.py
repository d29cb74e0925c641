"""Bounds by weak duality against scipy and against fractions."""

from fractions import Fraction

import numpy as np
import pytest
from loops import largest

from mireach import Polytope
from mireach.solvers.linear_program import LinearProgram, Optimum


def random_program(seed):
    """A program with limits on all variables, its rows A x <= b, its objective, and its optimum by scipy."""
    rng, lp = np.random.default_rng(seed), LinearProgram()
    A, b, c = rng.normal(size=(9, 5)), rng.uniform(-1, 2, 9), rng.normal(size=5)
    x = lp.add_columns(-np.ones(5), [1, 2, 3, 4, 5])
    lp.add_rows(x, A, upper=b)
    best = largest(c, np.vstack([A, np.eye(5), -np.eye(5)]), np.concatenate([b, [1, 2, 3, 4, 5], np.ones(5)]))
    return lp, x, A, b, c, best


@pytest.mark.parametrize("seed", range(30))
def test_bound_is_proven_and_close(seed):
    lp, x, _, _, c, best = random_program(seed)
    bound = lp.bound(x, c)
    assert bound == -np.inf if best == -np.inf else best - 1e-12 <= bound <= best + 1e-9


@pytest.mark.parametrize("seed", range(30))
def test_any_multipliers_give_a_bound_in_exact_arithmetic(seed):
    lp, _, A, b, c, best = random_program(seed)
    rng, low, high = np.random.default_rng(seed), [-1] * 5, [1, 2, 3, 4, 5]
    y = rng.normal(size=9) * 10.0 ** rng.integers(-3, 8, 9)
    c = c * 10.0 ** rng.integers(-3, 8)
    exact = sum(Fraction(float(w)) * Fraction(float(limit)) for w, limit in zip(y, b) if w > 0)
    for j in range(5):
        reduced = Fraction(float(c[j])) - sum(
            Fraction(float(w)) * Fraction(float(a)) for w, a in zip(y, A[:, j]) if w > 0
        )
        exact += max(reduced * low[j], reduced * high[j])
    scale = np.array([row.upper for row in lp._entries]) / b  # rows are kept multiplied by powers of two
    found = lp._rows().bound(c, y / scale, np.array(low, float), np.array(high, float))
    assert 0 <= Fraction(found) - exact <= 1e-12 * (np.abs(y).sum() + np.abs(c).sum())
    assert np.isinf(best) or found >= lp.maximize(np.arange(5), c).value - 1e-8 * (1 + np.abs(c).sum())


@pytest.mark.parametrize("seed", range(10))
def test_bound_holds_whatever_value_the_solver_claims(seed, monkeypatch):
    lp, x, _, _, c, best = random_program(seed)
    solve = LinearProgram._relaxation
    monkeypatch.setattr(LinearProgram, "_relaxation", lambda lp: Optimum(solve(lp).value - 0.5, solve(lp).point))
    assert lp.maximize(x, c).value == pytest.approx(best - 0.5) or best == -np.inf
    assert lp.bound(x, c) == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_without_limits_on_variables_the_rows_prove_them(seed):
    rng, n = np.random.default_rng(seed), 2 + seed % 3
    A, b = np.vstack([np.eye(n), -np.eye(n), rng.normal(size=(4, n))]), rng.uniform(0.1, 2, 2 * n + 4)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0] * 10.0 ** rng.integers(-6, 7)
    lp, A = LinearProgram(), A @ turn
    x = lp.add_columns(np.full(n, -np.inf), np.full(n, np.inf))
    lp.add_rows(x, A, upper=b)
    for v in rng.normal(size=(5, n)):
        best = Fraction(int((top := Polytope(A, b).exact_maximum(v).value).p), int(top.q))
        assert best <= Fraction(lp.bound(x, v)) <= best + Fraction(1, 10**9) * (1 + abs(best))
    low, high = lp.limits()
    assert np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()


def test_nothing_is_proven_of_variables_that_the_rows_do_not_bound():
    lp = LinearProgram()
    x = lp.add_columns([-np.inf, -np.inf], [np.inf, np.inf])
    lp.add_rows(x, [[1, 0.1], [0.3, 1]], upper=[1, 1])
    assert lp.bound(x, [1, -1]) == np.inf and lp.maximize(x, [1, -1]).value == np.inf
