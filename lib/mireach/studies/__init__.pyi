from . import case_analysis, case_studies, comparison, report, seed_study
from .case_studies import case_study

__all__ = [
    "case_analysis",
    "case_studies",
    "case_study",
    "comparison",
    "report",
    "seed_study",
]
