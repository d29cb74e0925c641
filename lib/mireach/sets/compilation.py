"""Compilation of the kernels by numba where it is installed; else they run as the Python functions that they are.

numba is imported, and a kernel compiled, when the first kernel is called. That takes some seconds, and the result is
kept on disk: in __pycache__ beside the kernels or in the user's cache folder, else in the system's temporary folder.
Where nothing can be written, every process compiles anew.
"""

import os
import stat
import tempfile
import warnings
from collections.abc import Callable
from functools import lru_cache, update_wrapper
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

_ALL: "list[Kernel]" = []  # every kernel: all of them are prepared at once, since they call each other
_PREPARING = Lock()


class Kernel:
    """A function that numba compiles at its first call, for arguments of the types that it is called with.

    Use it as a decorator. Kernels of one module may call each other, but none of another module: numba keeps compiled
    code until the file of its function changes, and would not notice a change elsewhere.

    Parameters
    ----------
    function : callable
        In the part of Python that numba supports. Without numba it is called as it is, which is much slower,
        with floating-point warnings off, since compiled code gives none. There `math.ldexp` raises where it overflows,
        while `np.ldexp` gives inf in both.

    Examples
    --------
    >>> @Kernel
    ... def total(values):
    ...     found = 0.0
    ...     for value in values:
    ...         found += value
    ...     return found
    >>> float(total(np.array([1.0, 2.5])))
    3.5
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        update_wrapper(self, function)
        self.function = function
        self._ready: Any = None
        _ALL.append(self)

    def __call__(self, *arguments: Any) -> Any:
        if self._ready is None:
            _prepare()
        return self._ready(*arguments)

    def prepare(self, numba: Any) -> None:
        """Compile the function, or take it as it is if `numba` is None."""
        if numba is None:
            self._ready = _silent(self.function)
            return
        self._ready = _kept(self.function, numba) or numba.njit(self.function)
        self.function.__globals__[self.function.__name__] = self._ready  # compiled code calls no object of this class


def _prepare() -> None:
    """Prepare all kernels that are not yet ready."""
    with _PREPARING:
        waiting = [kernel for kernel in _ALL if kernel._ready is None]
        numba = _numba() if waiting else None
        for kernel in waiting:
            kernel.prepare(numba)


def _numba() -> Any:
    """The module numba, or None where it is missing, does not work, or is told not to compile."""
    try:
        import numba
    except ModuleNotFoundError:
        return None
    except ImportError as error:  # such as a numba that does not know this numpy
        warnings.warn(f"numba cannot be imported, so that sets of the plane are slow: {error}", stacklevel=4)
        return None
    settings: Any = numba.config
    return None if settings.DISABLE_JIT else numba


def _kept(function: Callable[..., Any], numba: Any) -> Callable[..., Any] | None:
    """The function compiled and kept on disk, or None where no folder can be written.

    numba itself raises if it finds no folder that it can write, if the disk is full, or if what it kept cannot be read.
    """
    try:
        found = numba.njit(cache=True)(function)
    except (RuntimeError, OSError):  # numba finds no folder
        usual = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = _private_folder()
        try:
            found = numba.njit(cache=True)(function)
        except (RuntimeError, OSError):
            return None
        finally:
            numba.config.CACHE_DIR = usual
    for name in ("load_overload", "save_overload"):
        if hasattr(found._cache, name):
            setattr(found._cache, name, _or_none(getattr(found._cache, name)))
    return found


@lru_cache(maxsize=1)
def _private_folder() -> str:
    """A temporary folder that nobody else can write, since what is kept there will be run; "" if there is none."""
    user = os.getuid() if hasattr(os, "getuid") else None
    try:
        folder = Path(tempfile.gettempdir()) / f"mireach-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return ""
    own = user is None or (found.st_uid == user and not found.st_mode & 0o077)  # Windows has one such folder per user
    return str(folder) if own and stat.S_ISDIR(found.st_mode) else ""


def _silent(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, without numpy's floating-point warnings."""

    def silent(*arguments: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*arguments)

    return silent


def _or_none(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, with None in place of any error: code that is not kept is compiled anew."""

    def tried(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except Exception:
            return None

    return tried
