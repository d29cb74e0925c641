"""What can go wrong, by name."""


class MireachError(Exception):
    """Base class of this package's own exceptions."""


class CorruptFileError(MireachError, ValueError):
    """A file is not what its name says: truncated, of another format, or with impossible numbers."""


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

    def __init__(self, message, support=None):
        super().__init__(message)
        self.support = support
