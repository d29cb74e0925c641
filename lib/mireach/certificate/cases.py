"""Proofs by cases for certificates: trees that `checker` follows, found by branch and bound with HiGHS.

A node of a tree is a case: some neurons are won by given channels, the others are relaxed. HiGHS maximizes a row of the
image in it. Its multipliers, rounded to short whole numbers, are the proof: the checker derives the rows of the case
again and adds them up. So nothing here has to be exact. What the checker would not accept is split, or the offset is
raised by what is missing.
"""

import json
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from math import frexp, gcd, inf, ldexp
from typing import Any, NamedTuple

import numpy as np

from ..analysis.reach import support
from ..analysis.terminal_set import TerminalSet
from ..arithmetic.rational import above, binary, rational
from ..engines.steps import PULLS, farthest_step
from ..errors import CellLimitError, SolverError
from ..sets.polytope import Polytope
from ..solvers.linear_program import LinearProgram
from ..systems.loop import ClosedLoop
from ..typing import Array, IntArray
from . import checker

MOST_CASES = 50_000  # of a certificate
INSIDE = 1e-9  # by which states are moved towards the centre, so that their floats lie in the set
PENALTY = 1e6  # of a limit that is exceeded, relative to the form
TIE = 1e-6  # weight of a neuron whose upper limits do not matter
BITS = (16, 24, 32, 42, 52)  # lengths of weights that are tried, in this order

Node = list[int]


class RowProof(NamedTuple):
    """A proof that the image of a set satisfies a row.

    Attributes
    ----------
    nodes : list of list of int
        The tree, see `checker.CaseCheck.holds`.
    excess : Fraction
        By how much the offset of the row has to be raised for the proof to hold; 0 if it holds as it is.
    mode : int or None
        From 0; None for Phi itself.
    state : array (n,) or None
        Where the row is exceeded if anywhere, up to rounding.
    """

    nodes: list[Node]
    excess: Fraction
    mode: int | None
    state: Array | None


class ImageProof(NamedTuple):
    """A proof that the image of a set lies in {x : C x <= offsets}.

    Attributes
    ----------
    trees : list of list of list of int
        A tree for every row.
    offsets : array (l,)
    rows : list of RowProof
        For every row that of the mode with the largest excess.
    """

    trees: list[list[Node]]
    offsets: Array
    rows: list[RowProof]


class CaseProver:
    """Finds proofs by cases about sets {x : C x <= h} of a loop, and keeps them.

    Parameters
    ----------
    loop : ClosedLoop
    C : array (l, n)
    content : dict
        Of a certificate of the loop; its claims do not matter.
    """

    def __init__(self, loop: ClosedLoop, C: Array, content: dict[str, Any]) -> None:
        self._loop, self._C = loop, C
        self._certificate = checker.Certificate.of(checker.parse(json.dumps(content)))
        self._clock = checker.Budget(inf)
        self._check = checker.Claims(self._certificate, self._clock).cases
        self._directions = [row for row, _ in self._certificate.sets[0]]
        self._programs: dict[Any, _Relaxation] = {}
        self._images: dict[tuple[bytes, bytes], ImageProof] = {}
        self._count = 0

    def __call__(self, h: Array, wanted: Array) -> Array:
        """Offsets, not below `wanted`, of a set that is proven to hold R_1({x : C x <= h})."""
        return self._image(h, wanted).offsets

    def cases(self, sets: Sequence[Array], terminal: TerminalSet | None) -> dict[str, Any]:
        """What a certificate of these sets says under "cases"."""
        return {
            "inputs": [one.nodes for one in self._inputs],
            "images": [
                {"from": k, "to": j, "rows": self._image(sets[k], sets[j]).trees} for _, k, j in _inclusions(len(sets))
            ],
            "attained": [] if terminal is None else self._attained(sets[-1], terminal),
        }

    def witnesses(self, sets: Sequence[Array]) -> Iterator[tuple[str, dict[str, Any]]]:
        """Pairs (claim, witness): an exact state or step against a claim whose proof does not hold, if one is found."""
        for one, (a, b) in zip(self._inputs, self._certificate.input_set):
            for x in () if one.state is None else _pulled(one.state, self._loop.system.state_set):
                beyond = checker.dot(a, self._certificate.network(x, self._clock)) > b
                if beyond and all(checker.dot(c, x) <= limit for c, limit in self._certificate.state_set):
                    yield "inputs", {"state": checker.texts(x)}
                    break
        for claim, k, j in _inclusions(len(sets)):
            image = self._image(sets[k], sets[j])
            for r in np.flatnonzero(image.offsets > sets[j]).tolist():
                one = image.rows[r]
                step = None
                if one.state is not None and one.mode is not None:
                    step = farthest_step(self._loop, Polytope(self._C, sets[k]), self._C[r], one.state, one.mode)
                if step is not None and step.value > binary(sets[j][r]):
                    yield claim, {**step.escape(self._loop).to_dict(), "mode": step.mode + 1}
                    break

    def _image(self, h: Array, wanted: Array) -> ImageProof:
        """The ImageProof with the smallest offsets, not below `wanted`, that are found.

        Raises
        ------
        CellLimitError
            If the certificate needs more than `MOST_CASES`.
        """
        key = h.tobytes(), wanted.tobytes()
        if key not in self._images:
            self._enter(tuple(zip(self._directions, map(Fraction, h.tolist()))))
            trees, offsets, rows = [], [], []
            for a, b in zip(self._directions, wanted.tolist()):
                proofs = [self._row(number, (a, Fraction(b))) for number in range(len(self._certificate.modes))]
                worst = max(proofs, key=lambda one: one.excess)
                trees.append([node for one in proofs for node in one.nodes])
                offsets.append(above(rational(Fraction(b) + worst.excess)) if worst.excess else b)
                rows.append(worst)
            found = ImageProof(trees, np.array(offsets), rows)
            self._images[key] = self._images[key[0], found.offsets.tobytes()] = found
        return self._images[key]

    @cached_property
    def _inputs(self) -> list[RowProof]:
        """That Phi(X) lies in U: a RowProof for every row of U."""
        self._enter(self._certificate.state_set)
        return [self._row(None, row) for row in self._certificate.input_set]

    def _attained(self, h: Array, terminal: TerminalSet) -> list[dict[str, Any]]:
        """For every row a of the last set a mode and a state with the largest a x+, see `checker.Claims.criterion`."""
        c, share = terminal.centre, terminal.epsilon / (1 + terminal.epsilon)
        S = Polytope(self._C, h - (h - self._C @ c) * share)
        found = []
        for witness in support(self._loop, S, self._C).witness:
            if witness is None:
                return []
            x = c + (witness.states[0] - c) * (1 - INSIDE)
            found.append({"mode": int(witness.modes[0]) + 1, "state": x.tolist()})
        return found

    def _enter(self, rows: checker.Rows) -> None:
        self._check.enter(rows)
        self._programs.clear()

    def _row(self, number: int | None, row: checker.HalfSpace) -> RowProof:
        """Branch and bound, depth first."""
        nodes: list[Node] = []
        excess, state = Fraction(0), None
        hidden = self._certificate.network.hidden
        objective, own = self._check.objective(number, row)
        left: list[checker.Choices] = [{}]
        while left:
            choices = left.pop()
            self._count += 1
            if self._count > MOST_CASES:
                raise CellLimitError(f"a proof by cases needs more than {MOST_CASES} cases")
            case, limits = self._check.case(number, choices)
            form, unit = checker.combine(objective, case.z, case.unit), own * case.unit
            key = number, frozenset(choices.items())
            if key not in self._programs:
                self._programs[key] = _Relaxation(case, limits, [pool for _, pool in hidden])
            program = self._programs[key]
            multipliers, z = program.maximize(form, unit)
            weights, bound = _weights(multipliers, form, unit, limits, case.box)
            if bound is None or bound > excess:
                neuron = program.split(z, multipliers)
                if neuron is not None:
                    nodes.append(list(neuron))
                    pool = hidden[neuron[0]][1]
                    left += [{**choices, neuron: j} for j in reversed(range(pool))]
                    continue
                if bound is None:  # the case is empty up to rounding
                    weights, bound = _weights(program.penalized(form, unit), form, unit, limits, case.box)
                if bound is None:
                    raise SolverError("HiGHS found no bound in a case")
            if bound > excess:
                excess, state = bound, None if z is None else z[: self._certificate.network.states]
            nodes.append(weights)
        return RowProof(nodes, excess, number, state)


class _Relaxation:
    """The linear program of a case: its limits, and its box.

    Columns are scaled by powers of two to the size of the box, so that units do not matter.
    """

    def __init__(self, case: checker.Case, limits: Sequence[checker.Limit], pools: Sequence[int]) -> None:
        self._pools = pools
        self._case, self._first = case, len(limits) - len(case.limits)
        ends = np.array([[low / case.box[0][0], high / case.box[0][0]] for low, high in case.box[1:]])
        _, exponents = np.frexp(np.abs(ends).max(axis=1))
        self._scale = np.ldexp(1.0, exponents)
        self._ends = ends / self._scale[:, None]
        self._rows = np.array([self._floats(form, unit) for form, unit in limits])
        self._program, self._columns = self._built(elastic=False)

    def _floats(self, form: checker.Form, unit: int) -> Array:
        """A form in floats, in scaled variables: array (1 + variables,)."""
        found = np.zeros(1 + len(self._scale))
        found[: len(form)] = [entry / unit for entry in form]
        found[1:] *= self._scale
        return found

    def _built(self, elastic: bool) -> tuple[LinearProgram, IntArray]:
        """The program, and its columns; elastic: with one more column, by which all limits may be exceeded."""
        program = LinearProgram()
        columns = program.add_columns(*self._ends.T)
        if elastic:
            columns = np.concatenate([columns, program.add_columns([0.0], [inf])])
        for constant, *row in self._rows.tolist():
            size = max(map(abs, (constant, *row))) or 1.0
            program.add_row(columns, [*row, -size] if elastic else row, upper=-constant)
        return program, columns

    def maximize(self, form: checker.Form, unit: int) -> tuple[Array, Array | None]:
        """The multipliers of a form and of the limits at its maximum, and z there.

        If no point satisfies all limits, z is None, and the multiplier of the form is 0.
        """
        c = self._floats(form, unit)[1:]
        found = self._program.maximize(self._columns, c)
        if found.point is not None:
            return np.array([1.0, *np.maximum(self._program.multipliers(), 0)]), found.point * self._scale
        program, columns = self._built(elastic=True)
        program.maximize(columns, [*np.zeros(len(c)), -1.0])
        return np.array([0.0, *np.maximum(program.multipliers(), 0)]), None

    def penalized(self, form: checker.Form, unit: int) -> Array:
        """The multipliers as in `maximize`, if limits may be exceeded at a price."""
        c = self._floats(form, unit)[1:]
        program, columns = self._built(elastic=True)
        program.maximize(columns, [*c, -PENALTY * np.abs(c).max(initial=TIE)])
        return np.array([1.0, *np.maximum(program.multipliers(), 0)])

    def split(self, z: Array | None, multipliers: Array) -> tuple[int, int] | None:
        """The open neuron whose relaxation matters most at z, or None if there is none."""
        best, chosen = -1.0, None
        places = [*self._case.open.values(), len(self._case.limits)]
        for neuron, first, after in zip(self._case.open, places, places[1:]):
            if z is None:
                return neuron
            uppers = self._first + first + self._pools[neuron[0]]
            rows = self._rows[self._first + first : uppers]
            gap = -(rows[:, 0] + rows[:, 1:] @ (z / self._scale)).max()
            score = gap * (TIE + multipliers[1 + uppers : 1 + self._first + after].sum())
            if score > best:
                best, chosen = score, neuron
        return chosen


def _inclusions(count: int) -> list[tuple[str, int, int]]:
    """Claim, k and j for every inclusion of R_1(R_k) in R_j that a certificate of so many sets claims."""
    last = count - 1
    steps = [("sequence", k, k + 1) for k in range(last)]
    return [("safe_set", 0, 0), *steps, *([("terminal_set", last, last)] if last else [])]


def _pulled(x: Array, X: Polytope) -> Iterator[tuple[Fraction, ...]]:
    """A state, and states beside it in the direction of the centre of X."""
    centre, _ = X.chebyshev_centre()
    for share in (0.0, *PULLS):
        yield tuple(map(Fraction, (x + share * (centre - x)).tolist()))


def _weights(
    multipliers: Array, form: checker.Form, unit: int, limits: Sequence[checker.Limit], box: checker.Grid
) -> tuple[Node, Fraction | None]:
    """Short whole numbers close to multipliers (1 + limits,), up to a factor, and the bound that they prove.

    They are as short as they may be for the bound to be at most 0, else the longest of `BITS`.
    """
    _, top = frexp(max(multipliers))
    node: Node = []
    bound = None
    for bits in BITS:
        whole = [round(ldexp(entry, bits - top)) for entry in multipliers]
        common = gcd(*whole) or 1
        node = [whole[0] // common]
        for i, w in enumerate(whole[1:]):
            if w:
                node += [i, w // common]
        bound = checker.bound(form, unit, node, limits, box)
        if bound is not None and bound <= 0:
            break
    return node, bound
