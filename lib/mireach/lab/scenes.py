"""What the page of a disturbance lab shows of a look: points, and facts in words."""

from typing import Any

import numpy as np

from ..analysis.maximal_set import MaximalSafeSet
from ..analysis.terminal_set import TerminalSet
from ..sets.polytope import Polytope
from ..typing import Array
from .answers import MAX_STEPS, Look
from .views import View, size_name, size_of

Fact = tuple[str, str]  # name, value
POWERS = {1: "", 2: "²", 3: "³"}  # of a unit


def scene(look: Look) -> dict[str, Any]:
    """What a page needs to draw a look, ready for JSON: points, and the facts in words.

    Returns
    -------
    dict
        "state", "regions", "safe", "terminal" and "sequence" by the vertices of what the view shows of them, which are
        [] where it shows nothing; "nominal", "disturbed", "plant" and "witness" as lists of points, "centre" of the
        stopping rule, "axes" as a list of (coordinate from 0, label), the view's "caption", "pending", "verdict" in one
        sentence, and "facts" as a list of (name, value).

    Examples
    --------
    >>> from mireach.lab import look, subject
    >>> scene(look(subject("pwa"), {"amount": 0.1}))["verdict"]
    'Proven safe: no disturbance leads out of F_max = F_1'
    """
    view, safe, terminal = look.view, look.safe, look.terminal
    X, R = look.loop.system.state_set, terminal and terminal.set
    return {
        "state": corners(view, X),
        "regions": [corners(view, region) for region in look.regions],
        "sequence": [{"name": name, "k": k, "points": corners(view, P)} for name, k, P in look.sequence],
        "safe": safe.set and corners(view, safe.set),
        "terminal": R and corners(view, R),
        "nominal": _path(view, look.nominal),
        "disturbed": [_path(view, path) for path in look.disturbed],
        "plant": None if look.plant is None else _path(view, look.plant),
        "witness": safe.witness and view.points(safe.witness.states).tolist(),
        "centre": view.points(terminal.centre if terminal else np.zeros(X.dimension)).tolist(),
        "axes": [*zip(view.axes, view.names)],
        "caption": _caption(look),
        "pending": look.pending,
        "verdict": _verdict(look),
        "facts": _facts(look),
    }


def corners(view: View, P: Polytope) -> list[list[float]]:
    """Vertices of what a view shows of a Polytope; [] where it shows nothing.

    Examples
    --------
    >>> from mireach.lab.views import Section
    >>> corners(Section((0, 1), [0, 0, 5]), Polytope.box([0, 0, 0], [1, 1, 1]))
    []
    """
    return view.polygon(P).vertices().tolist()


def maximal_scene(maximal: MaximalSafeSet, X: Polytope) -> dict[str, Any]:
    """What a page needs to draw a MaximalSafeSet within X, ready for JSON: "rings" of corners, and "text".

    See Also
    --------
    maximal_set
    """
    if maximal.set is None:
        text = "none: X holds no RPI set (in floating point)" if maximal.verdict == "refuted" else "not settled"
        return {"rings": [], "text": text}
    text = f"{_share(maximal.set.area, X.area)}, in floating point, not proven"
    return {"rings": [ring.tolist() for ring in maximal.set.rings()], "text": text}


def _verdict(look: Look) -> str:
    """The sentence above the picture."""
    safe = look.safe
    if safe.set:
        return f"Proven safe: no disturbance leads out of F_max = F_{safe.iterations}"
    return f"No F_max was found: {safe.reason.split(':')[0]}"


def _caption(look: Look) -> str:
    """The view's caption, and what it does not show of the sets and of a step that leaves X; empty in the plane."""
    view, safe, terminal = look.view, look.safe, look.terminal
    if not view.caption:
        return ""
    sets = {"F_max": safe.set, "the terminal set": terminal.set if terminal else None}
    missed = [name for name, P in sets.items() if P is not None and view.polygon(P).is_empty]
    parts = [view.caption]
    if missed:
        parts.append(f"The section does not meet {' or '.join(missed)}.")
    if safe.witness is not None:
        parts.append("The step that leaves X is a projection too: the cross may be drawn inside, but lies outside X.")
    return " ".join(parts)


def _facts(look: Look) -> list[Fact]:
    """What stands beside the picture."""
    seconds = ("computed in", f"{1e3 * look.seconds:.0f} ms")
    return [*_start_facts(look), *_safe_facts(look), *_terminal_facts(look), seconds]


def _start_facts(look: Look) -> list[Fact]:
    """The initial state, where the picture does not show all of it."""
    if not look.view.hidden:
        return []
    safe = look.safe.set
    where = "" if safe is None else ", in F_max" if safe.contains(look.view.state) else ", outside F_max"
    return [("initial state", f"x = {np.round(look.view.state, 3).tolist()}{_unit(look)}{where}")]


def _safe_facts(look: Look) -> list[Fact]:
    safe, X, n = look.safe, look.loop.system.state_set, look.loop.system.state_size
    largest = max(np.abs(mode.disturbance.vertices()).max() for mode in look.loop.system.modes)
    facts = [
        ("largest |d|∞", f"{largest:.4g}{_unit(look)}"),
        ("iterations of Fₖ", f"{safe.iterations} ({'F_max proven' if safe.set else 'no F_max'})"),
    ]
    if safe.set:
        facts.append((f"{size_name(n)} of F_max", _share(size_of(safe.set), size_of(X), _unit(look, n))))
    elif safe.witness is not None:
        x, after = (np.round(state, 3).tolist() for state in safe.witness.states)
        d = np.round(safe.witness.disturbances[0], 4).tolist()
        facts.append(("leaves X", f"x = {x} → {after}, d = {d}{_unit(look, within=', all in ')}"))
    return facts


def _terminal_facts(look: Look) -> list[Fact]:
    terminal, n = look.terminal, look.loop.system.state_size
    if look.pending and look.safe.set:
        return [("terminal set", "follows when you pause")]
    if terminal is None:
        return [("terminal set", f"none: {look.remark}")]
    reason = terminal.reason.split(";")[0]
    if not terminal.criterion and terminal.steps == MAX_STEPS:
        reason = f"not settled after {MAX_STEPS} steps"
    return [
        ("steps to R_min" if terminal.criterion else "last Rₖ", f"k = {terminal.steps}: {reason}"),
        (f"its {size_name(n)}", f"{size_of(terminal.set):.4g}{_unit(look, n)}"),
        ("α of Theorem 1", _alpha(terminal)),
    ]


def _alpha(terminal: TerminalSet) -> str:
    """alpha and what it means."""
    if np.isnan(terminal.alpha):
        return "none: the centre is not inside R_min"
    if terminal.stable:
        return f"1 + {terminal.alpha - 1:.2g} (stable)"
    return f"{terminal.alpha:.6g} (Theorem 1 says nothing)"


def _share(size: float, whole: float, unit: str = "") -> str:
    share = f"{size / whole:.0%} of X" if whole else "X is flat"
    return f"{size:.4g} of {whole:.4g}{unit} ({share})"


def _unit(look: Look, power: int = 1, within: str = " ") -> str:
    """The unit of the states, or its power, after what comes before it; empty if there is none."""
    unit = look.view.unit
    return f"{within}{unit}{POWERS.get(power, f'^{power}')}" if unit else ""


def _path(view: View, trajectory: Array) -> list[list[float]]:
    """What a view shows of states, up to the first that is not there."""
    path: list[list[float]] = view.points(trajectory[np.isfinite(trajectory).all(axis=1)]).tolist()
    return path
