"""The table of one case study: what the paper prints, where it has the case, and what was computed here."""

from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ..analysis.reach import support
from ..analysis.terminal_set import TerminalSet
from ..typing import Array
from .case_analysis import Analysis
from .case_studies import CaseStudy, data_file
from .seed_study import load_rows
from .tables import html_table, markdown_table

HEAD = ("item", "paper", "here", "remark")


class Row(NamedTuple):
    """One line of the table: what is compared, what the paper prints, what was computed, and why they differ."""

    item: str
    paper: object
    here: object
    remark: str = ""


class Comparison(NamedTuple):
    """The table *paper vs. here* of one case; notebooks show it as a table.

    Attributes
    ----------
    name : str
        Of the case.
    has_paper : bool
        Whether the paper has the case; otherwise the table has no such column.
    rows : list of Row
    seconds : dict of str to float
        Of each stage of the analysis.

    See Also
    --------
    compare
    """

    name: str
    has_paper: bool
    rows: list[Row]
    seconds: dict[str, float]

    def __str__(self) -> str:
        return f"case {self.name}: {len(self.rows)} items{' compared with the paper' if self.has_paper else ''}"

    def _table(self) -> tuple[tuple[str, ...], list[tuple[object, ...]]]:
        """The head and the lines."""
        columns = [j for j, name in enumerate(HEAD) if self.has_paper or name != "paper"]
        return tuple(HEAD[j] for j in columns), [tuple(row[j] for j in columns) for row in self.rows]

    def _repr_html_(self) -> str:
        return html_table(*self._table())

    def markdown(self) -> str:
        """The table as a section in Markdown, with the seconds of each stage below it."""
        times = ", ".join(f"{key.replace('_', ' ')} {value:.3g} s" for key, value in self.seconds.items())
        title = f"## Case `{self.name}`{'' if self.has_paper else ', beyond the paper'}\n"
        lines = [title, *markdown_table(*self._table())]
        return "\n".join([*lines, "", f"Seconds: {times}.", ""])


def compare(analysis: Analysis) -> Comparison:
    """What the analysis of a case found, beside what the paper prints if it has the case.

    Parameters
    ----------
    analysis : Analysis

    Returns
    -------
    Comparison
    """
    case = analysis.case
    rows = [
        *_network_rows(case),
        *_iteration_rows(analysis),
        *_centred_rows(analysis),
        *_theorem_1_rows(analysis),
        *_other_set_rows(analysis),
        *_proof_rows(analysis),
    ]
    if "safe_set_box" in case.paper:
        box, paper = analysis.F_max.bounding_box(), np.array(case.paper["safe_set_box"])
        rows.append(Row("F_max", _box(*paper), _box(*box), case.definition.safe_set_remark))
    if case.fit is not None:
        rows += _fit_rows(analysis)
    return Comparison(case.name, bool(case.paper), rows, analysis.seconds)


def _network_rows(case: CaseStudy) -> Iterator[Row]:
    paper, hidden = case.paper, case.network.hidden
    first = hidden[0]
    shape = f"{len(hidden) - 2}x{first.width} maxout, pool {first.pool}"
    modes, samples = len(case.system.modes), len(case.data) + len(case.data.infeasible)
    yield Row("network", shape, f"{shape} + saturation", "two exact maxout layers project onto U (Sec. II.A)")
    yield Row(
        "binaries of one step",
        modes + sum(len(layer.bias) for layer in hidden[:-2]),
        modes + case.network.binaries,
        f"the saturation layers add {sum(len(layer.bias) for layer in hidden[-2:])}",
    )
    yield Row(
        "states of the data set",
        paper.get("samples"),
        samples,
        f"{len(case.data)} have a solution, for {len(case.data.infeasible)} none was found",
    )
    yield Row("disturbance bound", paper.get("disturbance_bound"), case.disturbance_bound)


def _iteration_rows(analysis: Analysis) -> Iterator[Row]:
    case, paper = analysis.case, analysis.case.paper
    safe, terminal = analysis.safe, analysis.terminal
    iterations = steps = ""
    if paper:
        studied = load_rows(data_file(case.name, "seeds.csv"))
        proven = [row.iterations for row in studied if row.verdict == "proven"]
        iterations = _spread(paper["iterations"], safe.iterations, proven)
        steps = _spread(paper["steps"], terminal.steps, [row.steps for row in studied if row.criterion])
    yield Row("iterations to F_max", paper.get("iterations"), safe.iterations, iterations)
    yield Row("k-bar (about the origin)", paper.get("steps"), terminal.steps, steps)
    holds, reason = ("holds", "") if terminal.criterion else ("fails", terminal.reason)
    yield Row("eq. (25), TerminationFmin, epsilon = 1e-3", "holds", holds, reason)


def _centred_rows(analysis: Analysis) -> Iterator[Row]:
    item, centred = "k-bar (about the equilibrium)", analysis.centred
    if centred is None:
        yield Row(item, "-", "-", "the nominal loop has no equilibrium: it circles around a jump")
    else:
        c = np.round(centred.centre, 4).tolist()
        yield Row(item, "-", centred.steps, f"equilibrium {c}; {centred.reason}")


def _theorem_1_rows(analysis: Analysis) -> Iterator[Row]:
    paper = analysis.case.paper
    terminal = analysis.terminal
    certificate = analysis.certificate
    printed = f"1 + {paper['alpha'] - 1:.1g}" if "alpha" in paper else "-"
    alpha = f"1 + {terminal.alpha - 1:.2g}" if terminal.alpha > 1 else f"{terminal.alpha:.6g}"
    yield Row("alpha at k-bar (Theorem 1)", printed, alpha, _alpha_remark(terminal))
    yield Row("delta_max", "> 0", f"{terminal.delta_max:.3g}", "units of x")
    yield Row(
        "largest alpha with R_1(alpha R_min) in R_min",
        "-",
        f"1 + {analysis.contraction - 1:.2g}" if analysis.contraction > 1 else "1",
        "all that the proof of Theorem 1 uses of eq. (26), StabCondFmin; above 1 the terminal set is stable",
    )
    theorem = certificate.report["theorem_1"]
    remark = f"alpha = {certificate.alpha}; {theorem.reason}"
    yield Row("Theorem 1, decided by a fraction", "-", theorem.verdict, remark)


def _other_set_rows(analysis: Analysis) -> Iterator[Row]:
    minimal, maximal = analysis.minimal, analysis.maximal
    item = "scaled minimal RPI set (1 + eps) R_k-bar(0)"
    if minimal.set is None:
        yield Row(item, "-", "-", minimal.reason)
    elif minimal.reached_at is None:
        yield Row(item, "-", f"k = {minimal.steps}", "not reached from F_max")
    else:
        yield Row(item, "-", f"k = {minimal.steps}", f"reached from F_max at k = {minimal.reached_at}")
    if maximal is None:
        return
    area = 0.0 if maximal.set is None else maximal.set.area
    yield Row(
        "area of the maximal safe set (of F_max)",
        "cannot be computed",
        f"{area:.2f} ({analysis.F_max.area:.2f})",
        f"{maximal.verdict} in rational arithmetic, {maximal.iterations} iterations; the true set has at most "
        f"{maximal.outer.area - area:.1g} more",
    )


def _proof_rows(analysis: Analysis) -> Iterator[Row]:
    for name, holds in analysis.exactly.items():
        yield Row(f"{name}: proven exactly", "-", "yes" if holds else "no")
    if analysis.maximal is None:
        gaps = _gaps(analysis)
        yield Row(
            "bounds of R_1 less their exact values", "-", f"{min(gaps):.2g} to {max(gaps):.2g}", "of F_max and of R_min"
        )
    counts = analysis.count_trajectories()
    yield Row(
        "trajectories",
        "all stay and enter",
        f"{counts['inside_safe_set']} of {counts['simulated']} stay in F_max, "
        f"{counts['entered_terminal_set']} are in the terminal set from k-bar on",
    )
    if check := analysis.cross_check:
        yield Row(
            "cells against the MILP",
            "-",
            f"{check['largest_difference']:.2g}",
            f"largest difference of {check['supports_compared']} supports; by {check['engine']}, F_max is "
            f"{check['safe_set_rpi']} RPI and the terminal set {check['terminal_set_rpi']}",
        )


def _gaps(analysis: Analysis) -> list[float]:
    """The bounds of the default engine on h of R_1(F_max) and R_1(R_min), less the exact values."""
    case, sets = analysis.case, {"safe_set": analysis.F_max, "terminal_set": analysis.terminal.set}
    return [
        float(Fraction(bound) - exact)
        for name, F in sets.items()
        for bound, exact in zip(support(case.loop, F, case.directions).bound, analysis.exact_supports[name])
    ]


def _fit_rows(analysis: Analysis) -> Iterator[Row]:
    fit = analysis.case.fit
    bounded = analysis.bounded
    paper = analysis.case.paper
    assert fit is not None and bounded is not None  # both are there where the plant is nonlinear
    lower, upper = fit.modes[0].region.bounding_box()
    yield Row("regions of the fit", paper["regions"], len(fit.modes), f"chessboard of side {upper[0] - lower[0]:g}")
    yield Row("largest error on the grid", paper["max_error"], f"{fit.max_error:.6f}", "10 points per axis and region")
    yield Row("largest error, proven", "-", f"{fit.errors.max():.6f}", "over all of X x U, in ball arithmetic")
    conditions = "; ".join(f"{name}: {'yes' if holds else 'no'}" for name, holds in bounded.conditions.items())
    yield Row("Theorem 2", "holds", bounded.verdict, conditions)


def _alpha_remark(terminal: TerminalSet) -> str:
    if terminal.stable:
        return "Theorem 1 applies at k-bar"
    k = terminal.stable_steps
    last = f"Theorem 1 applies at {len(k)} earlier k, the last of them {k[-1]}" if k else "Theorem 1 applies at no k"
    return f"at k-bar some facets no longer move, so alpha is exactly 1; {last}"


def _spread(paper: int, here: int, others: list[int]) -> str:
    """Why a number that depends on the network differs: the spread over the seed study."""
    if paper == here:
        return ""
    low = np.min(others)
    middle = np.median(others)
    high = np.max(others)
    return f"depends on the trained network: {low:.0f} to {high:.0f} over {len(others)} seeds, median {middle:.0f}"


def _box(lower: Array, upper: Array) -> str:
    return " x ".join(f"[{low:.2f}, {high:.2f}]" for low, high in zip(lower, upper))
