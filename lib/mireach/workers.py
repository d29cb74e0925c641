"""Work in several processes, which end when the process that started them does."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from threading import Thread
from time import sleep
from typing import Any

from .errors import MissingExtraError

WATCH = 1.0  # seconds between two looks at whether the parent still runs


def in_parallel(
    function: Callable[..., Any], arguments: Iterable[Sequence[Any]], jobs: int, ordered: bool = True
) -> Iterator[Any]:
    """Yield function(*one) for each `one` of `arguments`.

    Parameters
    ----------
    function : callable
    arguments : sequence of tuple
    jobs : int
        Processes on this machine, -1 for one per core; 1 stays in this process and needs no joblib.
    ordered : bool
        False yields each result as soon as it is there.

    Returns
    -------
    iterator

    Raises
    ------
    MissingExtraError
        If joblib is missing; the message says how to install it.

    Examples
    --------
    >>> list(in_parallel(pow, [(2, 3), (3, 2)], jobs=1))
    [8, 9]

    Notes
    -----
    A killed parent cannot end its workers. Each of them therefore looks every `WATCH` seconds whether its parent is
    still the same, and ends itself otherwise. On Windows a process is not told of its parent's end: there a worker
    ends after its present task.
    """
    if jobs == 1:
        return (function(*one) for one in arguments)
    try:
        from joblib import Parallel, delayed
    except ImportError as error:
        raise MissingExtraError("more than one job (jobs=1 works without)", "joblib", "train") from error
    tasks = [delayed(_run)(os.getpid(), function, one) for one in arguments]
    return Parallel(n_jobs=jobs, return_as="generator" if ordered else "generator_unordered")(tasks)


def _run(parent: int, function: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    if os.getpid() != parent:
        _watch(parent)
    return function(*arguments)


@lru_cache(maxsize=1)
def _watch(parent: int) -> None:
    """Start the thread that ends this process once `parent` is no longer its parent."""

    def look() -> None:
        while os.getppid() == parent:
            sleep(WATCH)
        os._exit(1)

    if os.getppid() == parent:  # else something stands in between, which ends its own processes
        Thread(target=look, daemon=True, name="mireach-parent-watch").start()
