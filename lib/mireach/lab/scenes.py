"""What the page of a disturbance lab shows of a look: points, and facts in words."""

from typing import Any

import numpy as np

from ..analysis.maximal_set import MaximalSafeSet
from ..analysis.terminal_set import TerminalSet
from ..sets.polytope import Polytope
from ..typing import Array
from .answers import MAX_STEPS, Look

Fact = tuple[str, str]  # name, value


def scene(look: Look) -> dict[str, Any]:
    """What a page needs to draw a look, ready for JSON: points, and the facts in words.

    Returns
    -------
    dict
        "state", "regions", "safe", "terminal" and "sequence" by vertices, "nominal", "disturbed", "plant" and
        "witness" as lists of states, "centre" of the stopping rule, "verdict" in one sentence, and "facts" as a list
        of (name, value).

    Examples
    --------
    >>> from mireach.lab import look, subject
    >>> scene(look(subject("pwa"), {"amount": 0.1}))["verdict"]
    'Proven safe: no disturbance leads out of F_max = F_1'
    """
    system = look.loop.system
    safe = look.safe
    terminal = look.terminal
    X, R = system.state_set, terminal and terminal.set
    return {
        "state": _corners(X),
        "regions": [_corners(region) for region in system.state_regions()],
        "sequence": [{"name": name, "k": k, "points": _corners(P)} for name, k, P in look.sequence],
        "safe": safe.set and _corners(safe.set),
        "terminal": R and _corners(R),
        "nominal": _path(look.nominal),
        "disturbed": [_path(path) for path in look.disturbed],
        "plant": None if look.plant is None else _path(look.plant),
        "witness": safe.witness and safe.witness.states.tolist(),
        "centre": terminal.centre.tolist() if terminal else [0.0] * X.dimension,
        "verdict": _verdict(look),
        "facts": _facts(look),
    }


def maximal_scene(maximal: MaximalSafeSet, X: Polytope) -> dict[str, Any]:
    """What a page needs to draw a MaximalSafeSet within X, ready for JSON: "rings" of corners, and "text".

    See Also
    --------
    maximal_set
    """
    if maximal.set is None:
        text = "none: X holds no RPI set (in floating point)" if maximal.verdict == "refuted" else "not settled"
        return {"rings": [], "text": text}
    text = f"{_share(maximal.set.area, X)}, in floating point, not proven"
    return {"rings": [ring.tolist() for ring in maximal.set.rings()], "text": text}


def _verdict(look: Look) -> str:
    """The sentence above the picture."""
    safe = look.safe
    if safe.set:
        return f"Proven safe: no disturbance leads out of F_max = F_{safe.iterations}"
    return f"No F_max was found: {safe.reason.split(':')[0]}"


def _facts(look: Look) -> list[Fact]:
    """What stands beside the picture."""
    return [*_safe_facts(look), *_terminal_facts(look), ("computed in", f"{1e3 * look.seconds:.0f} ms")]


def _safe_facts(look: Look) -> list[Fact]:
    safe, X = look.safe, look.loop.system.state_set
    largest = max(np.abs(mode.disturbance.vertices()).max() for mode in look.loop.system.modes)
    facts = [
        ("largest |d|∞", f"{largest:.4g}"),
        ("iterations of Fₖ", f"{safe.iterations} ({'F_max proven' if safe.set else 'no F_max'})"),
    ]
    if safe.set:
        facts.append(("area of F_max", _share(safe.set.area, X)))
    elif safe.witness is not None:
        x, after = (np.round(state, 3).tolist() for state in safe.witness.states)
        facts.append(("leaves X", f"x = {x} → {after}, d = {np.round(safe.witness.disturbances[0], 4).tolist()}"))
    return facts


def _terminal_facts(look: Look) -> list[Fact]:
    terminal = look.terminal
    if terminal is None:
        return [("terminal set", f"none: {look.remark}")]
    reason = terminal.reason.split(";")[0]
    if not terminal.criterion and terminal.steps == MAX_STEPS:
        reason = f"not settled after {MAX_STEPS} steps"
    return [
        ("steps to R_min" if terminal.criterion else "last Rₖ", f"k = {terminal.steps}: {reason}"),
        ("its area", f"{terminal.set.area:.4g}"),
        ("α of Theorem 1", _alpha(terminal)),
    ]


def _alpha(terminal: TerminalSet) -> str:
    """alpha and what it means."""
    if np.isnan(terminal.alpha):
        return "none: the centre is not inside R_min"
    if terminal.stable:
        return f"1 + {terminal.alpha - 1:.2g} (stable)"
    return f"{terminal.alpha:.6g} (Theorem 1 says nothing)"


def _share(area: float, X: Polytope) -> str:
    return f"{area:.4g} of {X.area:.4g} ({area / X.area:.0%} of X)"


def _corners(P: Polytope) -> list[list[float]]:
    """Vertices as lists."""
    return P.vertices().tolist()


def _path(trajectory: Array) -> list[list[float]]:
    """States as lists, up to the first that is not there."""
    return trajectory[np.isfinite(trajectory).all(axis=1)].tolist()
