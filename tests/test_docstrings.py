"""Docstrings of the public names: every parameter is documented."""

import inspect
import re
from dataclasses import is_dataclass
from functools import cached_property

import pytest

import mireach as mr
from mireach import approximation, certificate
from mireach.results import Result

PUBLIC = [getattr(module, name) for module in (mr, approximation, certificate) for name in dir(module)]
FUNCTIONS = {f"{one.__module__}.{one.__qualname__}": one for one in PUBLIC if inspect.isfunction(one)}
CLASSES = {
    one.__qualname__: one
    for one in PUBLIC
    if inspect.isclass(one) and one.__module__.startswith("mireach") and not issubclass(one, Exception)
}
METHODS = {
    f"{kind.__qualname__}.{name}": member
    for kind in CLASSES.values()
    for name, member in inspect.getmembers(kind, inspect.isroutine)
    if not name.startswith("_") and name in vars(kind) and not isinstance(vars(kind)[name], cached_property)
}
SIMPLE = {"to_dict", "from_dict", "save", "load"}  # their one parameter is in the first line


def documented(docstring):
    """The names that stand before a colon in the sections of a docstring."""
    lines = re.findall(r"^[ ]*([*\w, ]+?)(?: :.*)?$", docstring or "", flags=re.MULTILINE)
    return {name.strip(" *") for line in lines for name in line.split(",")}


def parameters(function):
    """The names of the parameters of a function, without self and cls."""
    names = inspect.signature(function).parameters
    return {name for name in names if name not in ("self", "cls") and not name.startswith("_")}


@pytest.mark.parametrize("name", sorted(FUNCTIONS | METHODS))
def test_every_parameter_is_documented(name):
    function = (FUNCTIONS | METHODS)[name]
    assert function.__doc__, "no docstring"
    if name.split(".")[-1] not in SIMPLE and "As `Engine.support`" not in function.__doc__:
        assert parameters(function) <= documented(function.__doc__)


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_every_field_is_documented(name):
    kind = CLASSES[name]
    assert kind.__doc__, "no docstring"
    if is_dataclass(kind) and not issubclass(kind, Result) and kind.__module__ != "mireach.certificate.checker":
        assert parameters(kind) <= documented(kind.__doc__)
