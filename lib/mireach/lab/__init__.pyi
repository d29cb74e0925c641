from .model import largest_amount, look, next_amount, safe_set_at, scene, script, subject
from .widget import DisturbanceLab, step_viewer

__all__ = [
    "DisturbanceLab",
    "largest_amount",
    "look",
    "next_amount",
    "safe_set_at",
    "scene",
    "script",
    "step_viewer",
    "subject",
]
