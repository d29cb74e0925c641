"""`reproduce`: the case studies from the shipped networks to figures, report.json and report.md."""

from pathlib import Path
from typing import Any

import numpy as np

from ..analysis.maximal_set import MaximalSafeSet
from ..analysis.terminal_set import TerminalSet
from ..certificate.writer import Certificate
from ..files import write_json, write_whole
from .case_analysis import Analysis, analyse
from .case_studies import REPORTED, case_study
from .comparison import compare

FORMAT = "mireach-report/1"


def reproduce(
    results: str | Path = "results",
    figures: str | Path = "docs/figures",
    certificates: str | Path = "data",
    *,
    engine: Any = None,
    cross_check: str | None = "milp",
    progress: bool = False,
) -> str:
    """Analyse the paper's cases and the two tank systems; draw the figures; write the report and the certificates.

    Parameters
    ----------
    results : str or Path
        Folder of report.json and report.md.
    figures : str or Path
        Folder of the figures, as SVG and PNG.
    certificates : str or Path
        Folder that gets CASE/certificate.json.
    engine, cross_check
        As in `case_analysis.analyse`.
    progress : bool
        Show progress bars.

    Returns
    -------
    str
        The text of report.md.

    Raises
    ------
    ValueError
        If a network has no safe set.
    MissingExtraError
        If matplotlib is missing; nothing has been computed then.
    """
    from .figures import draw_figures  # imports matplotlib

    analyses = [analyse(case_study(name), engine, cross_check, progress=progress) for name in REPORTED]
    draw_figures(analyses, figures)
    for analysis in analyses:
        analysis.certificate.save(Path(certificates) / analysis.case.name / "certificate.json")
    text = "\n".join(["# The paper and this reproduction\n", *(compare(analysis).markdown() for analysis in analyses)])
    cases = {analysis.case.name: as_dict(analysis) for analysis in analyses}
    write_json(Path(results) / "report.json", {"format": FORMAT, "cases": cases})
    write_whole(Path(results) / "report.md", text)
    return text


def as_dict(analysis: Analysis) -> dict[str, Any]:
    """One case of report.json."""
    case = analysis.case
    safe = analysis.safe
    terminal = analysis.terminal
    certificate = analysis.certificate
    report: dict[str, Any] = {
        "network": f"data/{case.name}/network.json",
        "disturbance_bound": case.disturbance_bound,
        "safe_set": {**analysis.F_max.to_dict(), "iterations": safe.iterations, "verdict": safe.verdict},
        "terminal_set": _terminal_dict(terminal),
        "reach_sequence": [R.to_dict() for R in terminal.history],
        "alpha": _number(terminal.alpha),
        "delta_max": _number(terminal.delta_max),
        "stable": terminal.stable,
        "stable_steps": terminal.stable_steps,
        "contraction": analysis.contraction,
        "terminal_set_about_equilibrium": None if analysis.centred is None else _terminal_dict(analysis.centred),
        "scaled_minimal_set": {
            **({} if analysis.minimal.set is None else analysis.minimal.set.to_dict()),
            "verdict": analysis.minimal.verdict,
            "steps": analysis.minimal.steps,
            "reached_at": analysis.minimal.reached_at,
        },
        "maximal_safe_set": None if analysis.maximal is None else _maximal_dict(analysis.maximal),
        "proven_exactly": analysis.exactly,
        "exact_supports": {
            "directions": case.directions.tolist(),
            **{name: [str(value) for value in values] for name, values in analysis.exact_supports.items()},
        },
        "claims": _claims_dict(certificate),
        "exact_alpha": None if certificate.alpha is None else str(certificate.alpha),
        "trajectories": analysis.count_trajectories(),
        "cross_check": analysis.cross_check,
        "paper": case.paper,
        "seconds": {key: round(value, 4) for key, value in analysis.seconds.items()},
    }
    if case.fit is not None:
        report["fit"] = {"max_error": case.fit.max_error, "proven_error": float(case.fit.errors.max())}
    if analysis.bounded is not None:
        report["theorem_2"] = {"verdict": analysis.bounded.verdict, "conditions": analysis.bounded.conditions}
    return report


def _terminal_dict(terminal: TerminalSet) -> dict[str, Any]:
    return {
        **terminal.set.to_dict(),
        "steps": terminal.steps,
        "epsilon": terminal.epsilon,
        "centre": terminal.centre.tolist(),
        "criterion": terminal.criterion,
        "reason": terminal.reason,
    }


def _claims_dict(certificate: Certificate) -> dict[str, Any]:
    said = ("verdict", "reason", "kind", "work")
    return {one.claim: {key: getattr(one, key) for key in said} for one in certificate.report.results}


def _maximal_dict(maximal: MaximalSafeSet) -> dict[str, Any]:
    return {
        **({} if maximal.set is None else {**maximal.set.to_dict(), "area": maximal.set.area}),
        "outer_area": maximal.outer.area,
        "iterations": maximal.iterations,
        "verdict": maximal.verdict,
        "slack": maximal.slack,
    }


def _number(value: float) -> float | None:
    """A float for JSON, which knows no NaN."""
    return float(value) if np.isfinite(value) else None
