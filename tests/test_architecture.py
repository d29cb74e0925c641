"""The structure of the package: imports go to the same or a lower floor, without circles and without private names."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "lib" / "mireach"
MODULES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in PACKAGE.rglob("*.py")}
FLOORS = (  # from the ground up; docs/architecture.md explains them
    ("typing", "tolerances", "errors", "checks", "results", "files", "workers", "arithmetic"),
    ("solvers", "sets"),
    ("systems",),
    ("approximation",),
    ("engines",),
    ("analysis",),
    ("certificate", "learning"),
    ("plotting",),
    ("studies",),
    ("lab", "exercises"),
    ("__main__",),
)
LATE = {  # imports that go up: at a call or for types alone
    ("errors", "engines.base"): "a type alone",
}


def floor(module):
    """The number of the floor of a module."""
    (found,) = (number for number, rooms in enumerate(FLOORS) if module.split(".")[0] in rooms)
    return found


def imported(name, at_import_only=False):
    """(module, names) of every relative import in a module; modules are named from the package on."""
    tree = ast.parse(MODULES[name].read_text())
    for node in tree.body if at_import_only else ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = name.split(".")[: -node.level]
            module = ".".join([*folder, *(node.module or "").split(".")]).strip(".")
            for alias in node.names:
                whole = f"{module}.{alias.name}".strip(".")
                yield (whole, "") if whole in MODULES else (module, alias.name)


def test_imports_of_the_modules_form_no_circle():
    before = {name: {module for module, _ in imported(name, at_import_only=True)} for name in MODULES}
    order = [*TopologicalSorter(before).static_order()]  # raises CycleError where there is a circle
    assert order.index("sets.polytope") < order.index("engines.cells") < order.index("analysis.reach")


@pytest.mark.parametrize("name", sorted(set(MODULES) - {"__init__"}))
def test_a_module_imports_from_its_own_floor_and_those_below(name):
    found = {module for module, _ in imported(name) if floor(module) > floor(name)}
    assert found <= {above for below, above in LATE if below == name}


def test_no_module_imports_a_private_name_of_another():
    found = [(name, module, what) for name in MODULES for module, what in imported(name) if what.startswith("_")]
    assert found == []
