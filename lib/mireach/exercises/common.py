"""What all checks share."""

import numpy as np


class Wrong(AssertionError):
    """An answer is not right; the message says what is violated, with numbers."""


def require(condition, hint):
    """Raise `Wrong` with the hint unless the condition holds."""
    if not condition:
        raise Wrong(hint)


def require_filled(answer, name):
    """Raise `Wrong` if an answer is still the placeholder (None or ...)."""
    require(answer is not None and answer is not ..., f"{name} is not filled in yet")


def require_array(answer, shape, name):
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


def require_close(answer, truth, name, tol=1e-6):
    """Raise `Wrong` unless a number is within `tol` of the truth; the hint gives the difference, not the truth."""
    number = float(require_array(answer, (), name))
    require(abs(number - truth) <= tol, f"{name} = {number:g} is off by {abs(number - truth):.2g}, more than {tol:g}")
    return number
