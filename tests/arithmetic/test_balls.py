"""Jets against sympy's derivatives and mpmath's values, which share no code with them."""

import sys
from decimal import Decimal
from fractions import Fraction

import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

flint = pytest.importorskip("flint")

from mireach.arithmetic.balls import ball, evaluate, interval, lower_float, pairs, precision, upper_float, variables  # noqa: E402

FUNCTIONS = {  # numpy's name: sympy's function, an argument that is in its domain for every real y
    "exp": (sympy.exp, lambda y: y / 8),
    "expm1": (lambda y: sympy.exp(y) - 1, lambda y: y / 8),
    "log": (sympy.log, lambda y: y * y + Fraction(3, 2)),
    "log1p": (lambda y: sympy.log(1 + y), lambda y: y * y + Fraction(1, 4)),
    "log2": (lambda y: sympy.log(y, 2), lambda y: y * y + Fraction(3, 2)),
    "log10": (lambda y: sympy.log(y, 10), lambda y: y * y + Fraction(3, 2)),
    "sqrt": (sympy.sqrt, lambda y: y * y + Fraction(1, 2)),
    "square": (lambda y: y**2, lambda y: y),
    "sin": (sympy.sin, lambda y: y),
    "cos": (sympy.cos, lambda y: y),
    "tan": (sympy.tan, lambda y: y / 64),
    "sinh": (sympy.sinh, lambda y: y / 8),
    "cosh": (sympy.cosh, lambda y: y / 8),
    "tanh": (sympy.tanh, lambda y: y),
    "arctan": (sympy.atan, lambda y: y),
    "arcsinh": (sympy.asinh, lambda y: y),
    "arcsin": (sympy.asin, lambda y: y / 64),
    "arccos": (sympy.acos, lambda y: y / 64),
}
X, U = sympy.symbols("x u", real=True)


def apply(name, y):
    """A function by its name, on whatever y is."""
    symbolic, shrink = FUNCTIONS[name]
    y = shrink(y)
    return symbolic(y) if isinstance(y, sympy.Basic) else getattr(np, name)(y)


leaves = st.sampled_from(["x", "u"]) | st.sampled_from([-1.5, 0.25, 2, 3.0])
trees = st.recursive(
    leaves,
    lambda below: (
        st.tuples(st.sampled_from("+-*/"), below, below)
        | st.tuples(st.just("**"), below, st.sampled_from([-2, -1, 0, 1, 2, 3, 5, Fraction(5, 2)]))
        | st.tuples(st.sampled_from(["sin", "exp", "tanh", "sqrt", "log", "arctan"]), below)
    ),
    max_leaves=5,
)


def build(tree, x, u):
    """The expression of a tree on symbols or jets; divisors and roots are kept positive."""
    if not isinstance(tree, tuple):
        return {"x": x, "u": u}.get(tree, tree) if isinstance(tree, str) else Fraction(tree) + 0 * x
    operation, first, *rest = tree
    a = build(first, x, u)
    if not rest:
        return apply(operation, a)
    if operation == "**":
        return (a * a + Fraction(1, 2)) ** rest[0] if rest[0] in (-2, -1, Fraction(5, 2)) else a ** rest[0]
    b = build(rest[0], x, u)
    return {"+": lambda: a + b, "-": lambda: a - b, "*": lambda: a * b, "/": lambda: a / (b * b + Fraction(1, 2))}[
        operation
    ]()


def derivatives(expression, point):
    """Value, gradient and Hessian entries of a sympy expression, to 50 digits by mpmath."""
    exact = sympy.nsimplify(sympy.sympify(expression), rational=True)
    wanted = [exact, exact.diff(X), exact.diff(U), exact.diff(X, 2), exact.diff(X, U), exact.diff(U, 2)]
    with mpmath.workdps(50):
        arguments = [mpmath.mpf(z) for z in point]
        return [mpmath.mpf(sympy.lambdify((X, U), entry, "mpmath")(*arguments)) for entry in wanted]


def flat(jet):
    return [jet.value, *jet.gradient, *jet.hessian]


def encloses(entry, number):
    """Whether a ball contains a number that is known to 50 digits."""
    with precision(200):
        return entry.overlaps(flint.arb(mpmath.nstr(number, 45))) or abs(entry - flint.arb(mpmath.nstr(number, 45))) < (
            1e-40 * (1 + abs(float(number)))
        )


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_function_has_the_derivatives_that_sympy_finds(name):
    point = (0.7, -1.1)
    with precision():
        jet = evaluate(lambda x, u: [apply(name, x[0] * u[0] + x[0])], [ball(point[0])], [ball(point[1])])[0]
    expected = derivatives(apply(name, X * U + X), point)
    assert all(encloses(entry, number) for entry, number in zip(flat(jet), expected))
    assert [float(entry) for entry in flat(jet)] == pytest.approx([float(number) for number in expected], rel=1e-14)


@settings(max_examples=40, deadline=None)
@given(trees, st.sampled_from([0.3, -1.7, 2.0]), st.sampled_from([0.9, -0.4]))
def test_random_expressions_have_the_derivatives_that_sympy_finds(tree, x, u):
    with precision():
        jet = evaluate(lambda a, b: [build(tree, a[0], b[0])], [ball(x)], [ball(u)])[0]
    for entry, number in zip(flat(jet), derivatives(build(tree, X, U), (x, u))):
        assert encloses(entry, number)
        assert float(entry) == pytest.approx(float(number), rel=1e-12, abs=1e-25)


@settings(max_examples=60, deadline=None)
@given(trees, st.integers(0, 2**32 - 1))
def test_a_ball_of_arguments_contains_what_its_points_give(tree, seed):
    rng = np.random.default_rng(seed)
    lower = rng.uniform(-2, 1, 2)
    upper = lower + rng.choice([1e-3, 0.1, 1.0])
    points = [lower, upper, *rng.uniform(lower, upper, (5, 2))]
    with precision():
        f = lambda a, b: [build(tree, a[0], b[0])]  # noqa: E731
        wide = evaluate(f, [interval(lower[0], upper[0])], [interval(lower[1], upper[1])])[0]
        for point in points:
            narrow = evaluate(f, [ball(point[0])], [ball(point[1])])[0]
            for outer, inner in zip(flat(wide), flat(narrow)):
                assert not outer.is_finite() or outer.overlaps(inner)


def test_matrices_and_numpy_scalars_work_on_arrays_of_jets():
    A = np.array([[1.0, 1.0], [0.0, 1.0]])
    with precision():
        x, u = [ball(2.0), ball(-3.0)], [ball(0.5)]
        first, second = evaluate(lambda x, u: A @ x + np.float64(0.5) * u[0] + 0.025 * (x @ x) * np.ones(2), x, u)
        assert [float(entry) for entry in first.gradient] == pytest.approx([1.1, 0.85, 0.5])
        assert [float(entry) for entry in second.hessian] == pytest.approx([0.05, 0, 0, 0.05, 0, 0])
        assert pairs(3) == ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def test_constants_are_components_and_first_order_leaves_the_hessian_out():
    with precision():
        constant, jet = evaluate(lambda x, u: [3.0, 2 ** x[0] / u[0]], [ball(1.0)], [ball(4.0)], order=1)
    assert float(constant.value) == 3.0 and not any(float(entry) for entry in constant.gradient)
    assert jet.hessian == [] and float(jet.gradient[1]) == -0.125


def test_floats_are_the_fractions_that_they_are():
    with precision():
        tenth = ball(0.1)
        assert tenth.is_exact() and not tenth.overlaps(1 / flint.arb(10))
        assert lower_float(tenth) == upper_float(tenth) == 0.1
        third = 1 / flint.arb(3)
        assert lower_float(third) < upper_float(third) and third.overlaps(ball(1 / 3)) is False
        assert np.nextafter(lower_float(third), 1) == upper_float(third)
        assert upper_float(flint.arb("nan")) == np.inf and lower_float(flint.arb("nan")) == -np.inf


REALS = [
    (Fraction(1, 3), Fraction(1, 3)),
    (Fraction(10**40 + 1, 7**30), Fraction(10**40 + 1, 7**30)),
    (Fraction(6, 3), Fraction(2)),
    (2**200 + 1, Fraction(2**200 + 1)),
    (True, Fraction(1)),
    (np.float32(0.1), Fraction(float(np.float32(0.1)))),
    (np.int64(-7), Fraction(-7)),
    (np.longdouble(1) / 3, Fraction(*map(int, (np.longdouble(1) / 3).as_integer_ratio()))),
    (sympy.Rational(1, 3), Fraction(1, 3)),
    (flint.fmpq(1, 3), Fraction(1, 3)),
]


@pytest.mark.parametrize(("number", "value"), REALS)
@pytest.mark.parametrize("bits", [53, 128])
def test_a_ball_contains_the_number_itself_and_not_the_nearest_float(number, value, bits):
    with precision(bits):
        found = ball(number)
    with precision(2000):
        exact = flint.arb(value.numerator) / value.denominator
        assert found.overlaps(exact) and abs(found - exact) < abs(exact) * flint.arb(2) ** (2 - bits)
        assert bits < 128 or found.is_exact() == (value.denominator & (value.denominator - 1) == 0)
    assert np.isinf(upper_float(ball(np.inf))) and ball(np.nan).is_nan()


@pytest.mark.parametrize("number", [Decimal("0.1"), 1j, "1", None, mpmath.mpf(1) / 3 + mpmath.mpf(2) ** -70])
def test_numbers_without_a_known_exact_value_are_refused_with_what_to_give(number):
    with mpmath.workdps(50):
        number = mpmath.mpf(1) / 3 if isinstance(number, mpmath.mpf) else number
        with pytest.raises(TypeError, match=r"give an int, a float or a fractions\.Fraction"):
            ball(number)


@pytest.mark.parametrize(("lower", "upper"), [(-10, 10), (-1, 3), (1, 10), (-50, -3), (-0.1, 0.1), (0, 2)])
def test_wide_balls_keep_what_squares_and_increasing_functions_cannot_leave(lower, upper):
    with precision():
        x = evaluate(lambda x, u: [x[0]], [interval(lower, upper)], [])[0]
        largest = max(abs(lower), abs(upper))
        smallest = 0 if lower <= 0 <= upper else min(abs(lower), abs(upper))
        for square in (x * x, x**2, x.square(), (x**4).sqrt() if smallest else x**2):
            assert lower_float(square.value) == pytest.approx(smallest**2, abs=1e-6 * largest**2)
            assert upper_float(square.value) == pytest.approx(largest**2, rel=1e-6)
            assert lower_float(square.value) <= smallest**2 and upper_float(square.value) >= largest**2
        for name in ("tanh", "arcsinh", "arctan"):
            found, function = getattr(x, name)(), getattr(np, name)
            assert all(entry.is_finite() for entry in flat(found))
            assert lower_float(found.value) == pytest.approx(function(lower), abs=1e-6)
            assert upper_float(found.value) == pytest.approx(function(upper), abs=1e-6)
            assert lower_float(found.gradient[0]) >= -1e-6 and upper_float(found.gradient[0]) <= 1 + 1e-6


def test_precision_is_restored_also_after_an_error():
    before = flint.ctx.prec
    with pytest.raises(ZeroDivisionError), precision(99):
        assert flint.ctx.prec == 99
        raise ZeroDivisionError
    assert flint.ctx.prec == before


@pytest.mark.parametrize(
    "f",
    [
        lambda x, u: [np.floor(x[0])],
        lambda x, u: [abs(x[0])],
        lambda x, u: [np.maximum(x[0], 0)],
        lambda x, u: [x[0] if x[0] > 0 else 0.0],
        lambda x, u: [u[0] if x[0] == 0 else 0.0],
        lambda x, u: [u[0] if x[0] else 0.0],
        lambda x, u: [float(x[0])],
        lambda x, u: [np.hypot(x[0], u[0])],
        lambda x, u: x[0],
        lambda x, u: ["text"],
        lambda x, u: [1j * x[0]],
    ],
)
def test_what_balls_cannot_do_is_refused_with_what_they_can(f):
    with precision(), pytest.raises(TypeError, match=r"numpy's exp, .* sin, cos"):
        evaluate(f, [ball(1.0)], [ball(2.0)])


def test_missing_flint_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(ImportError, match="pip install python-flint"):
        variables([1.0])
