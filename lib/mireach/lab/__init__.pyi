from .answers import Look, look, maximal_set, safe_set_at
from .controls import Control, Subject
from .scenes import maximal_scene, scene
from .scripts import script
from .search import largest_amount, next_amount
from .subjects import subject
from .widget import DisturbanceLab, step_viewer

__all__ = [
    "Control",
    "DisturbanceLab",
    "Look",
    "Subject",
    "largest_amount",
    "look",
    "maximal_scene",
    "maximal_set",
    "next_amount",
    "safe_set_at",
    "scene",
    "script",
    "step_viewer",
    "subject",
]
