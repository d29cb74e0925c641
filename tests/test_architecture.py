"""The structure of the package: imports go one way, and modules use only the public names of each other."""

import ast
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "lib" / "mireach"
MODULES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in PACKAGE.rglob("*.py")}


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
    assert order.index("polytope") < order.index("engines.cells") < order.index("reach") < order.index("invariance")


def test_no_module_imports_a_private_name_of_another():
    found = [(name, module, what) for name in MODULES for module, what in imported(name) if what.startswith("_")]
    assert found == []
