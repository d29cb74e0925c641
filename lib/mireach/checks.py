"""Checks of arguments; each message names the argument, what was given and what is needed."""

from typing import Any

import numpy as np

from .typing import Array, ArrayLike


def real_array(value: ArrayLike, name: str, ndim: int) -> Array:
    """`value` as a read-only float array with `ndim` axes and finite entries.

    Raises
    ------
    ValueError
        If it is no such array; the message gives the shape or the first entry that is not finite.
    """
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of numbers with {ndim} axes; got {value!r:.80}") from error
    if array.ndim != ndim:
        raise ValueError(f"{name} must have {ndim} axes; got shape {array.shape}")
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f"{name} must be finite; entry {where} is {array[where]}")
    array.setflags(write=False)
    return array


def whole_number(value: Any, name: str, least: int) -> int:
    """`value` as an int of at least `least`; 2.0 is one, True and 1.5 are none.

    Raises
    ------
    ValueError
        If it is none.
    """
    try:
        whole = not isinstance(value, bool) and not isinstance(value, str) and float(value).is_integer()
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}; got {value!r:.80}")
    return int(value)


def positive_number(value: Any, name: str) -> float:
    """`value` as a positive and finite float.

    Raises
    ------
    ValueError
        If it is none.
    """
    number = float(real_array(value, name, 0))
    if not number > 0:
        raise ValueError(f"{name} must be positive; got {value!r}")
    return number


def require_bools(**values: object) -> None:
    """Raise TypeError unless all arguments are True or False; the first other one is named."""
    for name, value in values.items():
        if not isinstance(value, (bool, np.bool_)):
            raise TypeError(f"{name} must be True or False; got {type(value).__name__} {value!r:.60}")


def require_kind(value: object, kind: type | tuple[type, ...], name: str) -> None:
    """Raise TypeError unless `value` is an instance of `kind`, or of one of several; both are named."""
    if not isinstance(value, kind):
        needed = " or ".join(one.__name__ for one in (kind if isinstance(kind, tuple) else (kind,)))
        raise TypeError(f"{name} must be of the kind {needed}; got {type(value).__name__} {value!r:.60}")


def require_columns(array: Array, columns: int, name: str, reason: str) -> None:
    """Raise ValueError unless `array` has `columns` as its last size; both sizes are named."""
    if not array.ndim or array.shape[-1] != columns:
        raise ValueError(f"{name} has shape {array.shape}, but its last size must be {columns}, {reason}")
