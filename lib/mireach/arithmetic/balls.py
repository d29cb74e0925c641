"""Value, gradient and Hessian of a function over a ball of arguments, each enclosed with certainty.

Second-order forward differentiation in ball arithmetic (Arb, by python-flint): every number is a midpoint
with a radius that covers all rounding, so an upper end is an upper bound.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from numbers import Integral, Rational, Real
from typing import Any, NoReturn, TypeAlias

import numpy as np

Ball: TypeAlias = Any  # an arb of python-flint, which has no types

PRECISION = 128  # bits of the midpoints; rounding is then far below any tolerance in use

ALLOWED = (
    "+, -, *, /, ** and numpy's exp, expm1, log, log1p, log2, log10, sqrt, square, sin, cos, tan, "
    "sinh, cosh, tanh, arctan, arcsin, arccos, arcsinh"
)


def flint() -> Any:
    """The module `flint`, imported when it is first needed.

    Raises
    ------
    ImportError
        If python-flint is not installed; the message says how to install it.
    """
    try:
        import flint as module
    except ImportError as error:
        raise ImportError("proven errors need python-flint; install it with: pip install python-flint") from error
    return module


@contextmanager
def precision(bits: int = PRECISION) -> Iterator[None]:
    """Ball arithmetic with midpoints of `bits` bits, until the block ends."""
    context = flint().ctx
    before = context.prec
    context.prec = bits
    try:
        yield
    finally:
        context.prec = before


def upper_float(ball: Ball) -> float:
    """Smallest float that is certainly not below any point of the ball; inf if the ball is not finite."""
    if not ball.is_finite():
        return np.inf
    end = ball.upper()
    nearest = float(end)
    return nearest if end <= nearest else float(np.nextafter(nearest, np.inf))


def lower_float(ball: Ball) -> float:
    """Largest float that is certainly not above any point of the ball; -inf if the ball is not finite."""
    return -upper_float(-ball)


def ball(number: Any) -> Ball:
    """A number as a ball that contains it.

    Parameters
    ----------
    number : int, float, Fraction, arb, or another real number of Python or numpy
        A float is the binary fraction that it is and a Fraction the quotient that it is, not the nearest float.

    Returns
    -------
    arb
        Of radius 0 for a float or an int; otherwise the radius covers the rounding to the present precision.

    Raises
    ------
    TypeError
        If it is not a real number, or of a type whose exact value cannot be asked for.
    """
    module = flint()
    if isinstance(number, module.arb):
        return number
    if isinstance(number, (module.fmpz, module.fmpq)):
        return module.arb(number)
    if isinstance(number, float):
        return module.arb(float(number))
    if isinstance(number, Integral):
        return module.arb(int(number))
    if isinstance(number, Rational):
        return module.arb(module.fmpq(int(number.numerator), int(number.denominator)))
    if isinstance(number, Real):
        if number == float(number) or number != number:  # infinite ones and NaN too
            return module.arb(float(number))
        if hasattr(number, "as_integer_ratio"):  # numpy's longdouble
            return module.arb(module.fmpq(*map(int, number.as_integer_ratio())))
    raise TypeError(
        f"{number!r:.80} of type {type(number).__name__} is not a real number whose exact value is known; give an int, "
        "a float or a fractions.Fraction"
    )


def interval(lower: float, upper: float) -> Ball:
    """A ball that covers the floats lower and upper and all between."""
    return ball(lower).union(ball(upper))


@lru_cache(maxsize=64)
def pairs(size: int) -> tuple[tuple[int, int], ...]:
    """The entries (i, j), i <= j, of a symmetric matrix, in the order of `Jet.hessian`."""
    return tuple((i, j) for i in range(size) for j in range(i, size))


class Jet:
    """A quantity with its first and second derivatives with respect to the `size` variables.

    Parameters
    ----------
    value : arb
    gradient : list of arb (size,)
    hessian : list of arb
        The entries `pairs(size)`; an empty list leaves second derivatives out.

    Notes
    -----
    numpy's functions call the methods of the same name on arrays of objects, so that a function written
    for numbers runs on jets. Comparisons and conversions to float raise TypeError: a branch would be
    decided for one point of the ball only.

    Examples
    --------
    >>> x, y = variables([ball(2.0), ball(3.0)])
    >>> [float(entry) for entry in (x * x * y).gradient]
    [12.0, 4.0]
    """

    __slots__ = ("gradient", "hessian", "value")
    __hash__ = None  # type: ignore[assignment]  # jets cannot be compared, see `_refuse`

    def __init__(self, value: Ball, gradient: list[Ball], hessian: list[Ball]) -> None:
        self.value = value
        self.gradient = gradient
        self.hessian = hessian

    def __repr__(self) -> str:
        return f"Jet({self.value}, {len(self.gradient)} variables)"

    def chain(self, value: Ball, first: Ball, second: Ball) -> "Jet":
        """g(self) from g, g' and g'' at self.value."""
        gradient = [first * a for a in self.gradient]
        g = self.gradient
        hessian = [
            first * h + second * (_square(g[i]) if i == j else g[i] * g[j])
            for (i, j), h in zip(pairs(len(g)), self.hessian)
        ]
        return Jet(value, gradient, hessian)

    # -- arithmetic -------------------------------------------------------------------------------

    def __neg__(self) -> "Jet":
        return Jet(-self.value, [-a for a in self.gradient], [-h for h in self.hessian])

    def __pos__(self) -> "Jet":
        return self

    def __add__(self, other: Any) -> Any:
        if isinstance(other, Jet):
            return Jet(
                self.value + other.value,
                [a + b for a, b in zip(self.gradient, other.gradient)],
                [a + b for a, b in zip(self.hessian, other.hessian)],
            )
        return Jet(self.value + ball(other), self.gradient, self.hessian) if _is_number(other) else NotImplemented

    def __sub__(self, other: Any) -> Any:
        return self + (-other) if _is_operand(other) else NotImplemented

    def __rsub__(self, other: Any) -> Any:
        return -self + other if _is_operand(other) else NotImplemented

    def __mul__(self, other: Any) -> Any:
        if other is self:  # tighter than the product of any two numbers of the ball
            return self.square()
        if isinstance(other, Jet):
            v, w = self.value, other.value
            g, k = self.gradient, other.gradient
            hessian = [
                v * b + w * a + g[i] * k[j] + g[j] * k[i]
                for (i, j), a, b in zip(pairs(len(g)), self.hessian, other.hessian)
            ]
            return Jet(v * w, [v * b + w * a for a, b in zip(g, k)], hessian)
        if not _is_number(other):
            return NotImplemented
        factor = ball(other)
        return Jet(factor * self.value, [factor * a for a in self.gradient], [factor * h for h in self.hessian])

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, Jet):
            return self * other.reciprocal()
        return self * (1 / ball(other)) if _is_number(other) else NotImplemented

    def __rtruediv__(self, other: Any) -> Any:
        return self.reciprocal() * other if _is_number(other) else NotImplemented

    def __pow__(self, exponent: Any) -> Any:
        if isinstance(exponent, Jet):
            return (self.log() * exponent).exp()
        if not _is_number(exponent):
            return NotImplemented
        p, v = ball(exponent), self.value
        if not p.is_integer():
            return self.chain(v**p, p * v ** (p - 1), p * (p - 1) * v ** (p - 2))
        p = int(p.unique_fmpz())
        if p < 0:
            return self.reciprocal() ** -p
        powers = [_whole_power(v, max(p - k, 0)) for k in range(3)]
        return self.chain(powers[0], p * powers[1], p * (p - 1) * powers[2])

    def __rpow__(self, base: Any) -> Any:
        return (self * ball(base).log()).exp() if _is_number(base) else NotImplemented

    __radd__, __rmul__ = __add__, __mul__

    # -- functions, under numpy's names ------------------------------------------------------------

    def reciprocal(self) -> "Jet":
        r = 1 / self.value
        return self.chain(r, -(r * r), 2 * r * r * r)

    def square(self) -> "Jet":
        return self**2

    def sqrt(self) -> "Jet":
        s = self.value.sqrt()
        slope = 1 / (2 * s)
        return self.chain(s, slope, -slope / (2 * self.value))  # no product of wide balls below a fraction

    def exp(self) -> "Jet":
        e = self.value.exp()
        return self.chain(e, e, e)

    def expm1(self) -> "Jet":
        e = self.value.exp()
        return self.chain(self.value.expm1(), e, e)

    def log(self) -> "Jet":
        r = 1 / self.value
        return self.chain(self.value.log(), r, -(r * r))

    def log1p(self) -> "Jet":
        r = 1 / (1 + self.value)
        return self.chain(self.value.log1p(), r, -(r * r))

    def log2(self) -> "Jet":
        return self.log() / ball(2).log()

    def log10(self) -> "Jet":
        return self.log() / ball(10).log()

    def sin(self) -> "Jet":
        s, c = self.value.sin_cos()
        return self.chain(s, c, -s)

    def cos(self) -> "Jet":
        s, c = self.value.sin_cos()
        return self.chain(c, -s, -c)

    def tan(self) -> "Jet":
        t = self.value.tan()
        slope = 1 + _square(t)
        return self.chain(t, slope, 2 * t * slope)

    def sinh(self) -> "Jet":
        s, c = self.value.sinh(), self.value.cosh()
        return self.chain(s, c, s)

    def cosh(self) -> "Jet":
        s, c = self.value.sinh(), self.value.cosh()
        return self.chain(c, s, c)

    def tanh(self) -> "Jet":
        t = _increasing("tanh", self.value)
        slope = 1 - _square(t)
        return self.chain(t, slope, -2 * t * slope)

    def arctan(self) -> "Jet":
        v = self.value
        r = 1 / (1 + _square(v))
        return self.chain(v.atan(), r, -2 * v * r * r)

    def arcsin(self) -> "Jet":
        v = self.value
        r = 1 / (1 - _square(v)).sqrt()
        return self.chain(v.asin(), r, v * r * r * r)

    def arccos(self) -> "Jet":
        v = self.value
        r = 1 / (1 - _square(v)).sqrt()
        return self.chain(v.acos(), -r, -v * r * r * r)

    def arcsinh(self) -> "Jet":
        v = self.value
        r = 1 / (1 + _square(v)).sqrt()
        return self.chain(_increasing("asinh", v), r, -v * r * r * r)

    # -- what a ball cannot answer -----------------------------------------------------------------

    def _refuse(self, *_: object) -> NoReturn:
        raise TypeError("a ball of arguments has no single truth value or float, so f must not branch on x or u")

    __bool__ = __float__ = __eq__ = __ne__ = __lt__ = __le__ = __gt__ = __ge__ = __abs__ = _refuse


def variables(balls: Sequence[Ball], order: int = 2) -> Any:
    """The independent variables as jets.

    Parameters
    ----------
    balls : sequence of arb (size,)
    order : 1 or 2
        1 leaves second derivatives out.

    Returns
    -------
    object array (size,) of Jet
    """
    size = len(balls)
    zero, one = ball(0), ball(1)
    entries = len(pairs(size)) if order == 2 else 0
    jets = np.empty(size, dtype=object)
    for i, value in enumerate(balls):
        jets[i] = Jet(value, [one if j == i else zero for j in range(size)], [zero] * entries)
    return jets


def evaluate(f: Callable[[Any, Any], Any], x: Sequence[Ball], u: Sequence[Ball], order: int = 2) -> list[Jet]:
    """f(x, u) with its derivatives with respect to (x, u).

    Parameters
    ----------
    f : callable
        f(x, u) -> n components, by the operations in `ALLOWED`.
    x, u : sequences of arb
    order : 1 or 2

    Returns
    -------
    list of Jet

    Raises
    ------
    TypeError
        If f uses anything else; the message lists what may be used.
    """
    point = variables([*x, *u], order)
    constant = point[0] * 0
    try:
        components = list(f(point[: len(x)], point[len(x) :]))
        return [part if isinstance(part, Jet) else constant + np.asarray(part).item() for part in _plain(components)]
    except (TypeError, AttributeError) as error:
        raise TypeError(f"f cannot be evaluated on balls ({error}); it may use {ALLOWED}") from error


def _plain(components: list[Any]) -> list[Any]:
    """Components without the arrays of one entry that numpy wraps around objects."""
    return [part.item() if isinstance(part, np.ndarray) and part.size == 1 else part for part in components]


def _whole_power(v: Ball, exponent: int) -> Ball:
    """v^exponent for a whole number >= 0 by products: Arb's own power of a ball around 0 is not a number."""
    if exponent < 2:
        return v if exponent else ball(1)
    half = _square(_whole_power(v, exponent // 2))
    return half * v if exponent % 2 else half


def _square(v: Ball) -> Ball:
    """v^2; Arb's own v * v of a wide ball also has the products of two different numbers, some of them negative."""
    if v.is_exact():
        return v * v
    low, high = v.abs_lower(), v.abs_upper()
    return (low * low).union(high * high)


def _increasing(name: str, v: Ball) -> Ball:
    """An increasing function of Arb by its values at the ends; Arb's own tanh and asinh of wide balls say little."""
    if v.is_exact():
        return getattr(v, name)()
    return getattr(v.lower(), name)().union(getattr(v.upper(), name)())


def _is_number(value: object) -> bool:
    return isinstance(value, (Real, flint().arb, flint().fmpq, flint().fmpz))


def _is_operand(value: object) -> bool:
    return isinstance(value, Jet) or _is_number(value)
