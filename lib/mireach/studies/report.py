"""`reproduce`: both case studies from the shipped networks to figures, report.json and report.md."""

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from time import perf_counter

import numpy as np
from tqdm.auto import tqdm

from ..analysis.boundedness import UltimateBound, ultimately_bounded
from ..analysis.contraction import contraction
from ..analysis.maximal_set import MaximalSafeSet, maximal_safe_set
from ..analysis.minimal_set import MinimalSet, scaled_minimal_set
from ..analysis.reach import outer_reach, support
from ..analysis.rpi import check_rpi
from ..analysis.safe_set import SafeSet, safe_set
from ..analysis.terminal_set import TerminalSet, terminal_set
from ..certificate.writer import Certificate, make
from ..files import write_json, write_whole
from ..sets.polytope import Polytope
from .case_studies import PAPER, CaseStudy, case_study, data_file
from .seed_study import load_rows

FORMAT = "mireach-report/1"
SETTLING = 10  # steps that trajectories run on after they have to be in the terminal set
INSIDE = 1e-9  # simulated states count as inside a set to within this, for rounding (units of x)
TRAJECTORIES = 200
SIZES = {"seed_areas": (6.4, 3.8)}  # of figures that are not square, in inches


@dataclass(frozen=True, eq=False)
class Analysis:
    """Everything that is computed for one case study.

    Attributes
    ----------
    case : CaseStudy
    safe : SafeSet
    terminal : TerminalSet
        About the origin, as in the paper.
    centred : TerminalSet or None
        About the closed loop's equilibrium; None if it has none.
    minimal : MinimalSet
    maximal : MaximalSafeSet
    certificate : Certificate
        Of F_max, the terminal set about the origin, and the theorems.
    exactly : dict of str to bool
        Of every set, whether its claim is proven in exact arithmetic.
    tubes : list of arrays (N, steps + 1, n)
        Trajectories with disturbance (of the plant, where there is one), one array an initial state or draw.
    nominal : array (k, steps + 1, n)
        Trajectories of the nominal loop (of the plant, where there is one) from the paper's initial states.
    reach : list of Polytope
        R_i-bar of the first of those states, i = 1, ..., k-bar.
    contraction : float
        Largest alpha with R_1(alpha R_min-bar) in R_min-bar.
    bounded : UltimateBound or None
        Theorem 2, where there is a nonlinear plant.
    cross_check : dict
        Of the cells against the MILP.
    seconds : dict of str to float
    """

    case: CaseStudy
    safe: SafeSet
    terminal: TerminalSet
    centred: TerminalSet | None
    minimal: MinimalSet
    maximal: MaximalSafeSet
    certificate: Certificate
    exactly: dict
    tubes: list
    nominal: np.ndarray
    reach: list
    contraction: float
    bounded: UltimateBound | None
    cross_check: dict
    seconds: dict


def reproduce(
    results="results", figures="docs/figures", certificates="data", engine=None, cross_check="milp", progress=True
):
    """Analyse both cases, draw the figures, write the report and the certificates.

    Parameters
    ----------
    results : str or Path
        Folder of report.json and report.md.
    figures : str or Path
        Folder of the figures, as SVG and PNG.
    certificates : str or Path
        Folder that gets CASE/certificate.json.
    engine : str or None
        As in `support`.
    cross_check : str or None
        Another engine that recomputes supports of X, F_max, the terminal set and single states; None
        leaves it out.
    progress : bool

    Returns
    -------
    str
        The text of report.md.

    Raises
    ------
    ValueError
        If a network has no safe set.
    """
    from .. import plotting  # noqa: F401 - where matplotlib is missing this says so, before the work is done

    analyses = [analyse(case_study(name), engine, cross_check, progress) for name in PAPER]
    draw_figures(analyses, Path(figures))
    for analysis in analyses:
        analysis.certificate.save(Path(certificates) / analysis.case.name / "certificate.json")
    text = "\n".join(["# The paper and this reproduction\n", *(markdown(analysis) for analysis in analyses)])
    cases = {analysis.case.name: as_dict(analysis) for analysis in analyses}
    write_json(Path(results) / "report.json", {"format": FORMAT, "cases": cases})
    write_whole(Path(results) / "report.md", text)
    return text


def analyse(case, engine=None, cross_check="milp", progress=False):
    """All sets, theorems and trajectories of one case study: Analysis."""
    seconds, loop = {}, case.loop
    with _timed(seconds, "safe_set"):
        safe = safe_set(loop, case.safe_directions, engine, progress=progress)
    if safe.set is None:
        raise ValueError(f"case {case.name} has no safe set: {safe.reason}")
    with _timed(seconds, "terminal_set"):
        terminal = terminal_set(loop, safe, case.directions, case.epsilon, engine=engine, progress=progress)
    with _timed(seconds, "terminal_set_about_equilibrium"):
        centred = _about_equilibrium(case, safe, engine)
    with _timed(seconds, "scaled_minimal_set"):
        minimal = scaled_minimal_set(loop, case.directions, case.epsilon, safe=safe, engine=engine)
    with _timed(seconds, "maximal_safe_set"):
        maximal = maximal_safe_set(loop)
    with _timed(seconds, "certificate"):
        certificate = make(loop, safe, terminal, plant=case.plant)
    with _timed(seconds, "trajectories"):
        tubes, nominal = _simulate(case, safe, terminal.steps + SETTLING)
        point = Polytope(case.directions, case.directions @ case.starts[0])
        reach = outer_reach(loop, point, case.directions, terminal.steps, engine)
    with _timed(seconds, "exact_proofs"):
        exactly = _exactly(loop, certificate, centred, minimal, maximal, reach)
    with _timed(seconds, "contraction"):
        growth = contraction(loop, terminal.set, terminal.centre, engine)
    bounded = None
    if case.plant is not None:
        with _timed(seconds, "theorem_2"):
            bounded = ultimately_bounded(case.plant, loop, safe, terminal)
    check = {}
    if cross_check is not None:
        with _timed(seconds, "cross_check"):
            check = _cross_check(case, safe, terminal, engine, cross_check, progress)
    return Analysis(
        case=case,
        safe=safe,
        terminal=terminal,
        centred=centred,
        minimal=minimal,
        maximal=maximal,
        certificate=certificate,
        exactly=exactly,
        tubes=tubes,
        nominal=nominal,
        reach=reach[1:],
        contraction=growth,
        bounded=bounded,
        cross_check=check,
        seconds=seconds,
    )


def draw_figures(analyses, folder):
    """Figures 1 and 2 (`pwa`), 3 and the maximal safe set (`double_integrator`), and the areas of the seed study.

    Each as SVG and PNG.
    """
    from matplotlib.figure import Figure

    from .. import plotting

    studies = {analysis.case.name: load_rows(data_file(analysis.case.name, "seeds.csv")) for analysis in analyses}
    sizes = {analysis.case.name: analysis.case.system.state_set.area for analysis in analyses}
    drawings = {"seed_areas": partial(plotting.plot_areas, studies=studies, sizes=sizes)}
    for analysis in analyses:
        drawings |= _drawings(analysis)
    for name, draw in drawings.items():
        figure = Figure(figsize=SIZES.get(name, (6.4, 6.2)), layout="constrained")
        draw(figure.add_subplot())
        plotting.save_figure(figure, folder / f"{name}.svg", bbox_inches="tight")
        plotting.save_figure(figure, folder / f"{name}.png", dpi=150, bbox_inches="tight")


def _drawings(analysis):
    """The figures of one case: name -> function that draws on Axes."""
    from .. import plotting

    case, safe, terminal = analysis.case, analysis.safe, analysis.terminal
    sets = {"system": case.system, "safe": safe, "terminal": terminal}
    if case.name == "pwa":
        tubes = {"tubes": analysis.tubes, "nominal": analysis.nominal}
        return {
            "figure1": partial(plotting.plot_sequence, **sets),
            "figure2": partial(plotting.plot_tubes, **sets, **tubes),
        }
    path = analysis.nominal[0][: terminal.steps + 1]
    step = partial(case.plant.step, case.network)
    return {
        "figure3": partial(plotting.plot_vector_field, **sets, step=step, path=path, reach=analysis.reach),
        "maximal_set": partial(plotting.plot_maximal, system=case.system, safe=safe, maximal=analysis.maximal),
    }


def as_dict(analysis):
    """One case of report.json."""
    case, safe, terminal = analysis.case, analysis.safe, analysis.terminal
    report = {
        "network": f"data/{case.name}/network.json",
        "disturbance_bound": case.disturbance_bound,
        "safe_set": {**safe.set.to_dict(), "iterations": safe.iterations, "verdict": safe.verdict},
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
        "maximal_safe_set": _maximal_dict(analysis.maximal),
        "proven_exactly": analysis.exactly,
        "claims": {
            result.claim: {"verdict": result.verdict, "reason": result.reason}
            for result in analysis.certificate.report.results
        },
        "exact_alpha": None if analysis.certificate.alpha is None else str(analysis.certificate.alpha),
        "trajectories": count_trajectories(analysis),
        "cross_check": analysis.cross_check,
        "paper": case.paper,
        "seconds": {key: round(value, 4) for key, value in analysis.seconds.items()},
    }
    if case.fit is not None:
        report["fit"] = {"max_error": case.fit.max_error, "proven_error": float(case.fit.errors.max())}
        report["theorem_2"] = {"verdict": analysis.bounded.verdict, "conditions": analysis.bounded.conditions}
    return report


def count_trajectories(analysis):
    """How many simulated trajectories stay in F_max, and are in the terminal set from k-bar on."""
    paths = np.concatenate(analysis.tubes)
    safe, terminal = analysis.safe.set, analysis.terminal
    return {
        "simulated": len(paths),
        "inside_safe_set": int(safe.contains(paths, INSIDE).all(axis=1).sum()),
        "entered_terminal_set": int(terminal.set.contains(paths[:, terminal.steps :], INSIDE).all(axis=1).sum()),
    }


def markdown(analysis):
    """The table *paper vs. here* of one case, as Markdown."""
    rows = [*_common_rows(analysis), *(_pwa_rows if analysis.case.name == "pwa" else _integrator_rows)(analysis)]
    lines = [f"## Case `{analysis.case.name}`\n", "| item | paper | here | remark |", "| --- | --- | --- | --- |"]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    times = ", ".join(f"{key.replace('_', ' ')} {value:.3g} s" for key, value in analysis.seconds.items())
    return "\n".join([*lines, "", f"Seconds: {times}.", ""])


# -- parts --------------------------------------------------------------------------------------------


class _timed:
    """with _timed(seconds, name): notes how long the block took."""

    def __init__(self, seconds, name):
        self.seconds, self.name = seconds, name

    def __enter__(self):
        self.begin = perf_counter()

    def __exit__(self, *_):
        self.seconds[self.name] = perf_counter() - self.begin


def _about_equilibrium(case, safe, engine):
    try:
        centre = case.loop.equilibrium()
    except ValueError:
        return None
    return terminal_set(case.loop, safe, case.directions, case.epsilon, centre, engine)


def _exactly(loop, certificate, centred, minimal, maximal, reach):
    """Of every set by name, whether its claim is proven in exact arithmetic."""

    def holds_images(sets):
        return all((support(loop, F, G.H, engine="exact").bound <= G.h).all() for F, G in pairwise(sets))

    found = {
        "F_max": certificate.report["safe_set"].verdict == "proven",
        "R_1 to R_k": certificate.report["sequence"].verdict == "proven",
        "terminal set": certificate.report["terminal_set"].verdict == "proven",
    }
    if centred is not None:
        found["terminal set about the equilibrium"] = holds_images([*centred.history, centred.set])
    if minimal.set is not None:
        found["scaled minimal set"] = holds_images([minimal.set, minimal.set])
    found["maximal safe set"] = maximal.verdict == "proven"
    found["reachable sets of the first state"] = holds_images(reach)
    return found


def _simulate(case, safe, steps):
    """Trajectories for the figures and the counts: (list of tubes, nominal trajectories from the paper's states)."""
    rng = np.random.default_rng(0)
    if case.plant is not None:
        starts = safe.set.sample(rng, TRAJECTORIES)
        tubes = [case.plant.simulate(case.network, starts, steps)]
        return tubes, case.plant.simulate(case.network, case.starts, steps)
    each = TRAJECTORIES // len(case.starts)
    tubes = [case.loop.simulate(np.tile(start, (each, 1)), steps, rng) for start in case.starts]
    return tubes, case.loop.simulate(case.starts, steps)


def _cross_check(case, safe, terminal, engine, other, progress):
    """Supports of one step by two engines over X, F_max, the terminal set and single states."""
    origin = np.zeros(case.system.state_size)
    points = [Polytope.box(x, x) for x in (*case.starts, origin)]
    sets = [case.system.state_set, safe.set, terminal.set, *points]
    values, bounds, safe_side = [], [], True
    for F in tqdm(sets, desc=f"cross-check by {other}", unit="set", disable=not progress):
        here = support(case.loop, F, case.directions, engine=engine)
        there = support(case.loop, F, case.directions, engine=other)
        values.append(np.abs(here.value - there.value))
        bounds.append(np.abs(here.bound - there.bound))
        safe_side &= bool((there.bound >= here.value).all())
    return {
        "engine": other,
        "supports_compared": len(sets) * len(case.directions),
        "largest_difference": float(np.max(values)),
        "largest_difference_of_bounds": float(np.max(bounds)),
        "bounds_on_the_safe_side": safe_side,
        "safe_set_rpi": check_rpi(case.loop, safe.set, other).verdict,
        "terminal_set_rpi": check_rpi(case.loop, terminal.set, other).verdict,
    }


def _terminal_dict(terminal):
    return {
        **terminal.set.to_dict(),
        "steps": terminal.steps,
        "epsilon": terminal.epsilon,
        "centre": terminal.centre.tolist(),
        "criterion": terminal.criterion,
        "reason": terminal.reason,
    }


def _maximal_dict(maximal):
    return {
        **({} if maximal.set is None else {**maximal.set.to_dict(), "area": maximal.set.area}),
        "outer_area": maximal.outer.area,
        "iterations": maximal.iterations,
        "verdict": maximal.verdict,
        "slack": maximal.slack,
    }


def _number(value):
    """A float for JSON, which knows no NaN."""
    return float(value) if np.isfinite(value) else None


def _common_rows(analysis):
    case, paper, terminal = analysis.case, analysis.case.paper, analysis.terminal
    rows = load_rows(data_file(case.name, "seeds.csv"))
    hidden = case.network.hidden
    yield "network", _shape(case), f"{_shape(case)} + saturation", "two exact maxout layers project onto U (Sec. II.A)"
    yield (
        "binaries of one step",
        len(case.system.modes) + sum(len(layer.bias) for layer in hidden[:-2]),
        len(case.system.modes) + case.network.binaries,
        "the saturation layers add 4",
    )
    solved = len(case.data)
    yield (
        "states of the data set",
        paper["samples"],
        paper["samples"],
        f"{solved} have a solution, for {len(case.data.infeasible)} none was found",
    )
    yield "disturbance bound", paper["disturbance_bound"], case.disturbance_bound, ""
    yield (
        "iterations to F_max",
        paper["iterations"],
        analysis.safe.iterations,
        _remark(paper["iterations"], analysis.safe.iterations, [r.iterations for r in rows if r.verdict == "proven"]),
    )
    steps = [r.steps for r in rows if r.criterion]
    yield "k-bar (about the origin)", paper["steps"], terminal.steps, _remark(paper["steps"], terminal.steps, steps)
    criterion = "holds" if terminal.criterion else "fails"
    yield "eq. TerminationFmin, epsilon = 1e-3", "holds", criterion, "" if terminal.criterion else terminal.reason
    if analysis.centred is None:
        yield "k-bar (about the equilibrium)", "-", "-", "the nominal loop has no equilibrium: it circles around a jump"
    else:
        c = np.round(analysis.centred.centre, 4).tolist()
        yield (
            "k-bar (about the equilibrium)",
            "-",
            analysis.centred.steps,
            f"equilibrium {c}; {analysis.centred.reason}",
        )
    alpha = f"1 + {terminal.alpha - 1:.2g}" if terminal.alpha > 1 else f"{terminal.alpha:.6g}"
    yield "alpha at k-bar (Theorem 1)", _paper_alpha(paper), alpha, _alpha_remark(terminal)
    yield "delta_max", "> 0", f"{terminal.delta_max:.3g}", "units of x"
    yield (
        "largest alpha with R_1(alpha R_min) in R_min",
        "-",
        f"1 + {analysis.contraction - 1:.2g}" if analysis.contraction > 1 else "1",
        "all that the proof of Theorem 1 uses of eq. StabCondFmin; above 1 the terminal set is stable",
    )
    yield (
        "Theorem 1, decided by a fraction",
        "-",
        analysis.certificate.report["theorem_1"].verdict,
        f"alpha = {analysis.certificate.alpha}; {analysis.certificate.report['theorem_1'].reason}",
    )
    minimal = analysis.minimal
    where = "-" if minimal.set is None else f"k = {minimal.steps}"
    reached = (
        f"reached from F_max at k = {minimal.reached_at}"
        if minimal.reached_at is not None
        else "not reached from F_max"
    )
    yield (
        "scaled minimal RPI set (1 + eps) R_k-bar(0)",
        "-",
        where,
        reached if minimal.set is not None else minimal.reason,
    )
    maximal = analysis.maximal
    area = 0.0 if maximal.set is None else maximal.set.area
    yield (
        "area of the maximal safe set (of F_max)",
        "cannot be computed",
        f"{area:.2f} ({analysis.safe.set.area:.2f})",
        f"{maximal.verdict} in rational arithmetic, {maximal.iterations} iterations; the true set has at most "
        f"{maximal.outer.area - area:.1g} more",
    )
    for name, holds in analysis.exactly.items():
        yield f"{name}: proven exactly", "-", "yes" if holds else "no", ""
    counts = count_trajectories(analysis)
    text = (
        "{inside_safe_set} of {simulated} stay in F_max, {entered_terminal_set} are in the terminal set from k-bar on"
    )
    yield "trajectories", "all stay and enter", text.format(**counts), ""
    if check := analysis.cross_check:
        yield (
            "cells against the MILP",
            "-",
            f"{check['largest_difference']:.2g}",
            f"largest difference of {check['supports_compared']} supports; by {check['engine']}, F_max is "
            f"{check['safe_set_rpi']} RPI and the terminal set {check['terminal_set_rpi']}",
        )


def _pwa_rows(analysis):
    (low, high), paper = analysis.safe.set.bounding_box(), analysis.case.paper["safe_set_box"]
    here, there = _box(low, high), _box(*map(np.array, paper))
    why = "top and bottom follow from the modes and X, the left side if Phi(0, -10) = 1; the right one is the network's"
    yield "F_max", there, here, why


def _integrator_rows(analysis):
    case = analysis.case
    yield "regions of the fit", case.paper["regions"], len(case.system.modes), "chessboard of side 4"
    yield (
        "largest error on the grid",
        case.paper["max_error"],
        f"{case.fit.max_error:.6f}",
        "10 points per axis and region",
    )
    yield "largest error, proven", "-", f"{case.fit.errors.max():.6f}", "over all of X x U, in ball arithmetic"
    yield (
        "Theorem 2",
        "holds",
        analysis.bounded.verdict,
        "; ".join(f"{name}: {'yes' if holds else 'no'}" for name, holds in analysis.bounded.conditions.items()),
    )


def _shape(case):
    hidden = case.network.hidden[:-2]
    return f"{len(hidden)}x{hidden[0].width} maxout, pool {hidden[0].pool}"


def _paper_alpha(paper):
    return f"1 + {paper['alpha'] - 1:.1g}" if "alpha" in paper else "-"


def _alpha_remark(terminal):
    if terminal.stable:
        return "Theorem 1 applies at k-bar"
    k = terminal.stable_steps
    last = f"Theorem 1 applies at {len(k)} earlier k, the last of them {k[-1]}" if k else "Theorem 1 applies at no k"
    return f"at k-bar some facets no longer move, so alpha is exactly 1; {last}"


def _remark(paper, here, others):
    """Why a number that depends on the network differs: the spread over the seed study."""
    if paper == here:
        return ""
    low, middle, high = np.min(others), np.median(others), np.max(others)
    return f"depends on the trained network: {low:.0f} to {high:.0f} over {len(others)} seeds, median {middle:.0f}"


def _box(lower, upper):
    return " x ".join(f"[{low:.2f}, {high:.2f}]" for low, high in zip(lower, upper))
