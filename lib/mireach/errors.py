"""The exceptions of this package. Wrong arguments raise Python's own TypeError and ValueError."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .engines.base import Support


class MireachError(Exception):
    """Base class of this package's own exceptions."""


class CellLimitError(MireachError):
    """The map falls into more cells than an engine keeps; the message says how many, and what to do instead."""


class CorruptFileError(MireachError, ValueError):
    """A file is not what its name says: truncated, of another format, or with impossible numbers."""


class MissingExtraError(MireachError, ImportError):
    """An optional package is not installed; the message says which, and how to install it.

    Parameters
    ----------
    purpose : str
        What needs the package.
    package : str
        Its name.
    extra : str
        The extra of mireach that installs it.
    """

    def __init__(self, purpose: str, package: str, extra: str) -> None:
        super().__init__(purpose, package, extra)
        self.purpose = purpose
        self.package = package
        self.extra = extra

    def __str__(self) -> str:
        return f'{self.purpose} needs {self.package}: install it with pip install "mireach[{self.extra}]"'


class RegionError(MireachError):
    """A set of the plane has too many corners, or GEOS finds no answer; the message says what to do instead."""


class SolverError(MireachError):
    """A solver ended in a state from which no answer can be read."""


class SolverStopped(MireachError):
    """A solver was stopped by a limit before it had an answer.

    Attributes
    ----------
    support : Support
        What is known so far: ``bound`` is still a proven upper bound (inf where there is none),
        ``value`` the best that was attained (-inf where there is none).
    """

    def __init__(self, message: str, support: "Support | None" = None) -> None:
        super().__init__(message)
        self.support = support
