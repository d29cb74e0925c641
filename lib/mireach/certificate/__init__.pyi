from . import checker
from .checker import Report, verify
from .writer import Certificate, make, write

__all__ = [
    "Certificate",
    "Report",
    "checker",
    "make",
    "verify",
    "write",
]
