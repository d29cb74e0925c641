"""Checks of arguments that every room uses; each message names the argument, its size, and what is needed."""

import numpy as np


def real_array(value, name, ndim):
    """`value` as a read-only float array with `ndim` axes and finite entries.

    Raises
    ------
    ValueError
        Naming the argument, what was given and what is needed.
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


def require_columns(array, columns, name, reason):
    """Raise ValueError unless `array` has `columns` as its last size; both sizes are named."""
    if array.shape[-1] != columns:
        raise ValueError(f"{name} has shape {array.shape}, but its last size must be {columns}, {reason}")
