"""Checks for the course's exercises, one module per notebook.

A check recomputes the property that an answer must have, on random data where it can, so that reading the check
does not give the answer away. It raises `Wrong` with a hint that names what is violated, with numbers.
"""

from .common import Wrong

__all__ = ["Wrong"]
