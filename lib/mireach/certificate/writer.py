"""Certificates: the results about a loop in one file that anybody can check without trusting this package.

`write` enlarges the sets of floating-point engines until their claims are exactly true, and adds a proof by cases where
a loop has many cells. `verify` checks them with `checker.py`, which shares no code with the engines. A number is the
IEEE float that it is, as in `rational`.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import prod
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from ..analysis.reach import support
from ..analysis.safe_set import SafeSet
from ..analysis.terminal_set import TerminalSet
from ..arithmetic.rational import above, binary, maximize
from ..checks import require_kind
from ..engines import exact
from ..engines.exact import Exact
from ..engines.exact_cells import affordable, cells
from ..errors import CellLimitError
from ..files import write_json
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.nonlinear import NonlinearSystem
from ..tolerances import LARGEST_INFLATION
from ..typing import Array
from . import checker
from .cases import CaseProver
from .checker import Report

CELLS_OF_A_PROOF = 500  # of a loop with four states whose proof is by cells; see `exact_cells.affordable` for others
INCLUSIONS = ("safe_set", "sequence", "terminal_set")  # claims that hold if sets are enlarged
REPAIRS = 30  # steps of the iteration towards the smallest set, before larger sets are tried


@dataclass(frozen=True)
class Certificate:
    """A certificate, and what the checker says of it.

    Attributes
    ----------
    content : dict
        The content of the file (format mireach-certificate/1, or /2 with a proof by cases; see `checker`).
    report : Report
        The report of the checker.
    inflation : float
        The largest increase of an offset of a set that made the claims exactly true.
    """

    content: dict[str, Any]
    report: Report
    inflation: float

    @property
    def alpha(self) -> Fraction | None:
        """alpha of eq. (26), StabCondFmin, as a Fraction; None if there is no such claim."""
        alpha = self.content["claims"].get("theorem_1", {}).get("alpha")
        return None if alpha is None else Fraction(alpha)

    def save(self, path: str | Path) -> None:
        """Write the file."""
        write_json(path, self.content)


def write(
    path: str | Path,
    loop: ClosedLoop,
    safe: SafeSet,
    terminal: TerminalSet | None = None,
    *,
    plant: NonlinearSystem | None = None,
    proof: Literal["cells", "cases"] | None = None,
) -> Certificate:
    """`make` a certificate and write it to a file.

    Parameters
    ----------
    path : str or pathlib.Path
    loop, safe, terminal, plant, proof
        As in `make`.

    Returns
    -------
    Certificate
    """
    made = make(loop, safe, terminal, plant=plant, proof=proof)
    made.save(path)
    return made


def make(
    loop: ClosedLoop,
    safe: SafeSet,
    terminal: TerminalSet | None = None,
    *,
    plant: NonlinearSystem | None = None,
    proof: Literal["cells", "cases"] | None = None,
) -> Certificate:
    """A certificate of the results about a loop.

    Parameters
    ----------
    loop : ClosedLoop
    safe : SafeSet
        With a set, from any engine.
    terminal : TerminalSet or None
        Of that safe set. None makes no claim beyond the safe set.
    plant : NonlinearSystem or None
        The plant that the loop's system approximates, with a polynomial f: the error set and Theorem 2 are claimed as
        well.
    proof : {"cells", "cases"} or None
        How the images of sets are proven. "cells": the checker derives the cells of the loop, and the file holds
        nothing for that. "cases": the file holds trees of cases with multipliers, for loops with too many cells. None
        chooses "cells" for up to 500 cells of four states, half as many for each further state, twice as many for each
        less.

    Returns
    -------
    Certificate

    Raises
    ------
    TypeError
        If an argument is of another kind.
    ValueError
        If there is no safe set, the terminal set does not start from it or has no steps, f is not a polynomial, or
        there is no such proof.
    CellLimitError
        If `proof` is "cells" and there are more than the exact engine keeps, or if a proof by cases becomes too long.

    Notes
    -----
    Sets of engines that round are most often right as they are. Where R_1 of a set exceeds the set that should contain
    it, that set is enlarged: the iteration h <- max(h, h of R_1), with R_1 rounded up, leads to the smallest set with
    these rows for which the claim is true. A proof by cases has short multipliers and needs a little room, about 1e-12
    of the size of X. Where more than `LARGEST_INFLATION` would be necessary the set is not changed. Nothing depends on
    the unit of the states.

    A claim that the checker does not confirm is "not proven" in the file, with the checker's reason and, if it has
    one, a witness: a state of fractions without a successor, or a step that leads out of the set.
    """
    require_kind(loop, ClosedLoop, "loop")
    if proof not in (None, "cells", "cases"):
        raise ValueError(f'proof must be "cells", "cases" or None; got {proof!r:.60}')
    history = _history(safe, terminal)
    C = _template(loop, history)
    wanted = [_offsets(loop, R, C) for R in history]
    known = {"system": loop.system.to_dict(), "network": loop.network.to_dict(), "template": C.tolist()}
    f = {} if plant is None else {"plant": {"f": _polynomials(plant, loop, history[0])}}

    def content(sets: Sequence[Array], **more: Any) -> dict[str, Any]:
        said = {"sets": [h.tolist() for h in sets], "claims": _claims(C, sets, terminal, plant)}
        return {"format": checker.WITH_CASES if more else checker.FORMAT, **known, **said, **f, **more}

    if proof == "cells" or (proof is None and _has_few_cells(loop)):
        sets, made = wanted, content(wanted)
        report = _settled(made)
        if any(one.claim in INCLUSIONS and one.verdict == "refuted" for one in report.results):
            sets = _repaired(_ExactImages(loop, C), loop, C, wanted)
            made = content(sets)
            report = _settled(made)
    else:
        prover = CaseProver(loop, C, content(wanted))
        sets = _repaired(prover, loop, C, wanted)
        made = content(sets, cases=prover.cases(sets, terminal))
        for name, witness in prover.witnesses(sets):
            made["claims"].get(name, {}).update(verdict="not proven", witness=witness)
        report = _settled(made)
    made["digest"] = checker.digest(checker.parse(json.dumps(made)))
    return Certificate(made, report, max(float((h - given).max()) for h, given in zip(sets, wanted)))


def _has_few_cells(loop: ClosedLoop) -> bool:
    """Whether the checker is to derive the cells of a loop."""
    try:
        return len(cells(loop, CELLS_OF_A_PROOF)) <= affordable(loop.system.state_size, CELLS_OF_A_PROOF)
    except CellLimitError:
        return False


# -- sets ---------------------------------------------------------------------------------------------


def _history(safe: SafeSet, terminal: TerminalSet | None) -> Sequence[Polytope]:
    """F_max = R_0, R_1, ..., R_k; TypeError or ValueError if safe and terminal do not give them."""
    require_kind(safe, SafeSet, "safe")
    if safe.set is None:
        raise ValueError(f"there is no safe set to certify: {safe.reason}")
    if terminal is None:
        return [safe.set]
    require_kind(terminal, TerminalSet, "terminal")
    if terminal.history[0] is not safe.set:
        raise ValueError("terminal does not start from safe; give the terminal set of this safe set")
    if len(terminal.history) < 2:
        raise ValueError("terminal has no steps, only the safe set; leave it out, or give one with steps >= 1")
    return terminal.history


def _template(loop: ClosedLoop, history: Sequence[Polytope]) -> Array:
    """The rows of X, of F_max and of the sets that follow, each once."""
    rows = [*history[-1].H, *history[0].H, *loop.system.state_set.H]
    return np.array(list({(row + 0.0).tobytes(): row + 0.0 for row in rows}.values()))


def _offsets(loop: ClosedLoop, R: Polytope, C: Array) -> Array:
    """Offsets of R & X along C: the given offsets for their own rows, else the support function, rounded up."""
    H, h = np.vstack([R.H, loop.system.state_set.H]) + 0.0, [*R.h, *loop.system.state_set.h]
    given: dict[bytes, float] = {}
    for row, offset in zip(H, h):
        given[row.tobytes()] = min(offset, given.get(row.tobytes(), np.inf))
    rows = binary(H), binary(h)
    return np.array([given[row.tobytes()] if row.tobytes() in given else _support(R, rows, row) for row in C])


def _support(R: Polytope, rows: tuple[Any, Any], c: Array) -> float:
    """max {c x : rows}, rounded up; the support function of R in floats if no point satisfies the rows."""
    value = maximize(*rows, binary(c)).value
    return R.support(c[None])[0] if value == -np.inf else above(value)


class _Images(Protocol):
    """Images of sets {x : C x <= h} under a loop."""

    def __call__(self, h: Array, wanted: Array) -> Array:
        """Offsets along C, not below `wanted`, of a set that holds R_1({x : C x <= h})."""


class _ExactImages:
    """Images in exact arithmetic, rounded up."""

    def __init__(self, loop: ClosedLoop, C: Array) -> None:
        self._loop, self._C = loop, C

    def __call__(self, h: Array, wanted: Array) -> Array:
        return np.maximum(wanted, support(self._loop, Polytope(self._C, h), self._C, engine=Exact()).bound)


def _repaired(images: _Images, loop: ClosedLoop, C: Array, wanted: Sequence[Array]) -> list[Array]:
    """Offsets, not below `wanted`, for which R_1 of each set lies in the next one.

    Where that needs more than `LARGEST_INFLATION`, offsets are not changed.
    """
    X = loop.system.state_set
    most = LARGEST_INFLATION * np.array([_support(X, X.exact, c) + _support(X, X.exact, -c) for c in C])
    sets = [_invariant(images, wanted[0], most)]
    for given in wanted[1:]:
        raised = images(sets[-1], given)
        sets.append(np.minimum(raised if (raised - given <= most).all() else given, sets[-1]))
    return sets


def _invariant(images: _Images, wanted: Array, most: Array) -> Array:
    """The smallest offsets h, not below `wanted`, with R_1({x : C x <= h}) in {x : C x <= h}.

    They are `wanted` if an offset would have to be raised by more than `most`.
    """
    h = wanted
    for _ in range(REPAIRS):
        raised = images(h, h)
        if (raised <= h).all():
            return h
        h = raised
        if (h - wanted > most).any():
            return wanted
    step = h - wanted  # the iteration converges slowly: larger sets are tried
    while (step <= most).all():
        h, step = wanted + step, 2 * step
        if (images(h, h) <= h).all():
            return h
    return wanted


# -- content ------------------------------------------------------------------------------------------


def _claims(
    C: Array, sets: Sequence[Array], terminal: TerminalSet | None, plant: NonlinearSystem | None
) -> dict[str, dict[str, Any]]:
    """The claims before the checker has run."""
    claims: dict[str, dict[str, Any]] = {"inputs": {}, "safe_set": {}}
    if terminal is not None:
        c = terminal.centre.tolist()
        alpha = exact.growth(C, sets[-2], sets[-1], c)
        alpha = None if alpha is not None and alpha < 0 else alpha  # c is not in the set before the last
        claims |= {
            "sequence": {},
            "terminal_set": {"steps": terminal.steps},
            "criterion": {"epsilon": terminal.epsilon, "centre": c, "holds": terminal.criterion},
            "theorem_1": {
                "alpha": None if alpha is None else str(alpha),
                "centre": c,
                "stable": alpha is not None and alpha > 1,
            },
        }
    if plant is not None:
        claims |= {"error_set": {}, "theorem_2": {}}
    return {name: {"verdict": "proven", **claim} for name, claim in claims.items()}


def _settled(content: dict[str, Any]) -> Report:
    """Run the checker; claims that it does not confirm become "not proven", with its reason. Its last Report."""
    report = checker.check(checker.parse(json.dumps(content)))
    claims, found = content["claims"], {one.claim: one for one in report.results}
    refuted = {name for name, one in found.items() if one.verdict == "refuted"}
    if "criterion" in refuted and "terminal_set" not in refuted:  # the checker decides it exactly
        claims["criterion"]["holds"] = not claims["criterion"]["holds"]
        return _settled(content)
    for name, result in found.items():
        rests_on_error = name == "theorem_2" and found["error_set"].verdict != "proven"
        if name in refuted or rests_on_error or (result.verdict, claims[name]["verdict"]) == ("not checked", "proven"):
            claims[name] |= {"verdict": "not proven", "reason": result.reason}
            if result.witness is not None:
                claims[name]["witness"] = result.witness
    return report


def _polynomials(plant: NonlinearSystem, loop: ClosedLoop, F: Polytope) -> list[list[dict[str, Any]]]:
    """f of a plant as lists of terms.

    Raises
    ------
    ValueError
        If f is not a polynomial, or F = F_max and U are not within the plant's limits.
    """
    require_kind(plant, NonlinearSystem, "plant")
    if not (F.is_subset(plant.state_set) and loop.system.input_set.is_subset(plant.input_set)):
        raise ValueError("F_max or U leaves the limits of the plant, outside which its f is not defined")
    n, size = loop.system.state_size, loop.system.state_size + loop.system.input_size
    z = [_Polynomial({tuple(int(i == j) for j in range(size)): Fraction(1)}) for i in range(size)]
    try:
        components = [z[0] * 0 + part for part in plant.f(z[:n], z[n:])]
    except TypeError as error:
        raise ValueError(
            f"f of the plant is not a polynomial in x and u, which a certificate needs: {error}"
        ) from error
    return [
        [{"coefficient": _written(value), "powers": list(powers)} for powers, value in part.terms.items() if value]
        for part in components
    ]


def _written(value: Fraction) -> float | str:
    """A fraction as a float if that is exact, else as text p/q."""
    return float(value) if _is_float(value) else str(value)


def _is_float(value: Fraction) -> bool:
    """Whether a fraction is a float."""
    try:
        return Fraction(float(value)) == value
    except OverflowError:
        return False


class _Polynomial:
    """A polynomial {powers: coefficient} in fractions; other operands are numbers, read as the floats that they are."""

    __array_ufunc__ = None  # numpy numbers leave the arithmetic to this class; numpy functions raise TypeError

    def __init__(self, terms: dict[tuple[int, ...], Fraction]) -> None:
        self.terms = terms

    def _of(self, other: Any) -> "_Polynomial":
        """A number as a constant polynomial."""
        if isinstance(other, _Polynomial):
            return other
        size = len(next(iter(self.terms)))
        return _Polynomial({(0,) * size: Fraction(float(other))})

    def __add__(self, other: Any) -> "_Polynomial":
        found = dict(self.terms)
        for powers, value in self._of(other).terms.items():
            found[powers] = found.get(powers, Fraction(0)) + value
        return _Polynomial(found)

    def __mul__(self, other: Any) -> "_Polynomial":
        found: dict[tuple[int, ...], Fraction] = {}
        for powers, value in self.terms.items():
            for others, factor in self._of(other).terms.items():
                both = tuple(map(sum, zip(powers, others)))
                found[both] = found.get(both, Fraction(0)) + value * factor
        return _Polynomial(found)

    def __pow__(self, exponent: Any) -> "_Polynomial":
        if exponent != int(exponent) or exponent < 0:
            raise TypeError(f"the power {exponent} is no whole number from 0 on")
        return prod([self] * int(exponent), start=self._of(1))

    def __neg__(self) -> "_Polynomial":
        return self * -1

    def __sub__(self, other: Any) -> "_Polynomial":
        return self + -self._of(other)

    def __rsub__(self, other: Any) -> "_Polynomial":
        return -self + other

    def __truediv__(self, other: Any) -> "_Polynomial":
        return _Polynomial({powers: value / Fraction(float(other)) for powers, value in self.terms.items()})

    __radd__, __rmul__ = __add__, __mul__
