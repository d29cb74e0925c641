"""Functions that all checks share: conditions on answers with hints, texts, and random networks."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.network import Layer, MaxoutNetwork
from ..typing import Array, ArrayLike


class Wrong(AssertionError):
    """An answer is not right; the message says what is violated, with numbers."""


def require(condition: object, hint: str) -> None:
    """Raise `Wrong` with the hint unless the condition holds."""
    if not condition:
        raise Wrong(hint)


def require_filled(answer: Any, name: str) -> None:
    """Raise `Wrong` if an answer is still the placeholder (None or ...)."""
    require(answer is not None and answer is not ..., f"{name} is not filled in yet")


def require_array(answer: Any, shape: tuple[int | None, ...], name: str) -> Array:
    """The answer as a float array of the given shape (None in `shape` stands for any size)."""
    require_filled(answer, name)
    try:
        array = np.asarray(answer, float)
    except (TypeError, ValueError):
        raise Wrong(f"{name} must be an array of numbers; got {type(answer).__name__}") from None
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape))
    needed = str(shape).replace("None", "k") if shape else "(), one number"
    require(fits, f"{name} must have shape {needed}; got {array.shape}")
    require(np.isfinite(array).all(), f"{name} holds entries that are not finite")
    return array


def require_number(answer: Any, name: str) -> float:
    """The answer as a finite float."""
    return float(require_array(answer, (), name))


def require_whole(answer: Any, name: str, low: int, high: int | None = None) -> int:
    """The answer as a whole number from `low` to `high`, both included; None sets no upper limit."""
    number = require_number(answer, name)
    limits = f"of at least {low}" if high is None else f"from {low} to {high}"
    fits = number == int(number) and number >= low and (high is None or number <= high)
    require(fits, f"{name} must be a whole number {limits}; got {number:g}")
    return int(number)


def require_close(answer: Any, truth: float, name: str, tol: float = 1e-6) -> float:
    """Raise `Wrong` unless a number is within `tol` of the truth; the hint gives the difference, not the truth."""
    number = require_number(answer, name)
    require(abs(number - truth) <= tol, f"{name} = {number:g} is off by {abs(number - truth):.2g}, more than {tol:g}")
    return number


def require_instance(answer: Any, kind: type, name: str) -> None:
    """Raise `Wrong` unless the answer is filled in and of that class."""
    require_filled(answer, name)
    require(isinstance(answer, kind), f"{name} must be a {kind.__name__}; got {type(answer).__name__}")


def require_pair(answer: Any, name: str, content: str) -> tuple[Any, Any]:
    """The two parts of an answer that has to be a pair; `content` says of what."""
    require_filled(answer, name)
    require(
        isinstance(answer, tuple | list) and len(answer) == 2,
        f"{name} must return the pair {content}; got {type(answer).__name__}",
    )
    return answer[0], answer[1]


def text(x: ArrayLike) -> str:
    """A vector for a message, such as (1.5, -2)."""
    return "(" + ", ".join(f"{value + 0.0:.4g}" for value in np.ravel(x)) + ")"


def with_bound(loop: ClosedLoop, bound: float) -> ClosedLoop:
    """The planar loop with D = {d : |d|_inf <= bound}."""
    return loop.with_disturbance(Polytope.box([-bound, -bound], [bound, bound]))


def random_network(rng: np.random.Generator, layers: Iterable[tuple[int, int]], outputs: int = 1) -> MaxoutNetwork:
    """A maxout network of the plane with normal weights; `layers` gives the width and the channels of each."""
    hidden, size = [], 2
    for width, pool in layers:
        hidden.append(Layer(rng.normal(size=(width * pool, size)), rng.normal(size=width * pool), pool))
        size = width
    return MaxoutNetwork(tuple(hidden), rng.normal(size=(outputs, size)), rng.normal(size=outputs))
