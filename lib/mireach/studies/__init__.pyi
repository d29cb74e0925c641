from . import case_studies, report, seed_study
from .case_studies import case_study

__all__ = [
    "case_studies",
    "case_study",
    "report",
    "seed_study",
]
