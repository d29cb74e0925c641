"""A plugin of pytest that hides numba: `pytest -p without_numba`, with this folder on the path."""

import sys


def pytest_configure():
    """Let `import numba` raise ModuleNotFoundError; a mere import of this file changes nothing."""
    sys.modules["numba"] = None
