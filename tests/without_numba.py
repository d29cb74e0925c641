"""A plugin of pytest that hides numba: `pytest -p without_numba`, with this folder on the path."""

import sys

sys.modules["numba"] = None  # importing it raises ModuleNotFoundError from here on
