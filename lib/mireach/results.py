"""What the results of the analyses share: one enumeration of verdicts, and a form that JSON can hold."""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from enum import StrEnum
from fractions import Fraction
from types import NoneType, UnionType
from typing import Any, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from .checks import require_kind

NOT_STORED = {"stored": False}  # metadata of fields that `to_dict` leaves out


class Verdict(StrEnum):
    """An answer to "does this hold?". A verdict equals its word: `verdict == "proven"`.

    Examples
    --------
    >>> Verdict("proven") is Verdict.PROVEN, Verdict.REFUTED == "refuted", Verdict.UNKNOWN
    (True, True, 'unknown')
    """

    PROVEN = "proven"
    REFUTED = "refuted"
    UNKNOWN = "unknown"

    def __repr__(self) -> str:
        return repr(self.value)


class Result:
    """Base class of result dataclasses.

    Examples
    --------
    >>> import json, mireach as mr
    >>> check = mr.check_rpi(mr.case_study("pwa").loop, mr.Polytope.box([-1, -1], [1, 1]))
    >>> again = type(check).from_dict(json.loads(json.dumps(check.to_dict())))
    >>> again.verdict == check.verdict, bool((again.margin == check.margin).all())
    (True, True)
    """

    def to_dict(self) -> dict[str, Any]:
        """The fields as values that JSON holds: arrays as lists, fractions as "p/q", infinite numbers as words."""
        return {name: _written(getattr(self, name)) for name in _stored(type(self))}

    @classmethod
    def from_dict(cls, value: dict[str, Any]) -> Self:
        """The result that `to_dict` gave.

        Raises
        ------
        TypeError
            If `value` is no dict.
        ValueError
            If a field is missing or has another form.
        """
        require_kind(value, dict, "value")
        hints = get_type_hints(cls)
        try:
            return cls(**{name: _read(hints[name], value[name]) for name in _stored(cls)})
        except (KeyError, TypeError) as error:
            raise ValueError(f"not the fields of a {cls.__name__}: {error!r}") from error


def _stored(kind: Any) -> list[str]:
    """The names of the fields that are written."""
    return [one.name for one in fields(kind) if one.metadata.get("stored", True)]


def _written(value: Any) -> Any:
    """A value in a form that JSON holds."""
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, np.ndarray | np.generic):
        return _written(value.tolist())
    if isinstance(value, Fraction):
        return str(value)
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    if isinstance(value, dict):
        return {name: _written(entry) for name, entry in value.items()}
    if isinstance(value, str) or not hasattr(value, "__iter__"):
        return str(value) if isinstance(value, str) else value
    return [_written(entry) for entry in value]


def _read(hint: Any, value: Any) -> Any:
    """The value of type `hint` that `_written` gave."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        if value is None:
            return None
        kinds = [part for part in parts if part is not NoneType]
        if len(kinds) > 1:  # a number or an array of them
            kinds = [float if isinstance(value, str | float | int) else kinds[0]]
        return _read(kinds[0], value)
    if origin is np.ndarray:
        kind = int if "integer" in str(parts) else float
        return np.array(value, dtype=kind)
    if origin in (list, tuple, Sequence):
        return (list if origin is list else tuple)(_read(parts[0], entry) for entry in value)
    if origin is dict:
        return {name: _read(parts[1], entry) for name, entry in value.items()}
    if hasattr(hint, "from_dict"):
        return hint.from_dict(value)
    if hint in (bool, int, float, str, Fraction) or (isinstance(hint, type) and issubclass(hint, StrEnum)):
        return hint(value)
    raise ValueError(f"values of the type {hint} cannot be read" + (" from JSON" if is_dataclass(hint) else ""))
