"""An independent checker of certificates: integer arithmetic, standard library only, no code shared with this package.

    python3 run.py verify FILE        or, with nothing installed,        python3 lib/mireach/certificate/checker.py FILE

A certificate (format mireach-certificate/1, or /2 with `cases`) is one JSON file:

    system      modes (A, B, p, region of (x, u), disturbance), state_set X, input_set U; every set is {"H", "h"}
    network     Phi, as in network.json
    template    C, one row per direction
    sets        offsets h of F_max = R_0, R_1, ..., R_k, the terminal set; each of them is {x : C x <= h}
    claims      the claims, see `CLAIMS`, each with a "verdict"
    plant       f of x+ = f(x, u), where the system approximates a plant: for every component of f a list of
                {"coefficient", "powers"}, the powers in the order x, u
    cases       in format /2, a proof by cases: {"inputs", "images", "attained"}, see `Cases`
    bounds      in some files of format /1, of a solver; nothing rests on them
    digest      SHA-256 of everything else

How numbers are read. Every number is the IEEE double that it is, which is the double nearest to the decimal in the
file, and from then on an exact fraction: 0.1 is 3602879701896397 / 2^55. Only fractions that are written as text,
"p/q", are these fractions themselves: alpha, the coefficients of f, and the entries of witnesses. See `number`.

What the system is. A mode acts on (x, u) with x in X, u in U and (x, u) in its region, and x+ = A x + B u + p + d for
any d of its disturbance set. A state x has a successor if a mode acts on (x, Phi(x)). All sets are closed: pieces that
are only an edge or a point count, and where regions meet, every one of their modes acts.

How a claim is proven. All numbers are whole, so that nothing is ever rounded. A corner (W, X), W > 0, stands for the
point X / W of R^n. A *form* (c, a) over a unit > 0 is the affine function with the value (c W + a X) / (unit W) there,
and also the half-space in which it is at most 0. There are two kinds of proof about the image of a set.

By cells: Phi is affine on convex pieces, and so is x+ on the cells that regions cut from them. They are polytopes,
given by their corners and the limits that are tight in each (double description). Affine functions are largest in
corners, which decides every claim, and gives a witness against one that is false.

By cases, where the cells are too many: the file has trees in which the winning channels of some neurons are chosen, and
for every case the multipliers of weak duality. The limits of a case are derived here; the multipliers add up to a proof
or they do not. See `Case`, `bound` and `CaseCheck`.

What a check may cost. Sizes are limited before anything is converted (the `MOST_` constants), so that reading takes a
few seconds at most; digest and mathematics end after `seconds`, or where they would hold more than `MOST_MEMORY`.
"""

import argparse
import hashlib
import json
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from dataclasses import fields as fields_of
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from itertools import zip_longest
from math import ceil, factorial, floor, gcd, lcm, prod
from operator import gt, mul, sub
from pathlib import Path
from typing import Any

FORMAT, WITH_CASES, NETWORK = "mireach-certificate/1", "mireach-certificate/2", "mireach-network/1"
CLAIMS = {
    "inputs": "Phi(x) lies in U for every x in X",
    "safe_set": "F_max is not empty and lies in X, and all of its states have successors, all in F_max: it is RPI",
    "sequence": "every R_k before the last lies in F_max, and R_(k+1) contains its image",
    "terminal_set": "the last R_k lies in F_max, is RPI, and contains the state k = `steps` steps after any in F_max",
    "criterion": "eq. (25), TerminationFmin, about `centre` with `epsilon`: `holds` or not",
    "theorem_1": "the largest alpha >= 0 with alpha R_k in R_(k-1), about `centre`, is `alpha`, null if the centre is "
    "not inside R_k or not in R_(k-1); R_k is not empty, and `stable` if alpha > 1",
    "error_set": "f - f_PWA lies in D for every x in X and u in U",
    "theorem_2": "the origin is inside R_k, and the plant is ultimately bounded in R_k, uniformly in F_max",
}
OF_SEQUENCE, OF_PLANT = ("sequence", "terminal_set", "criterion", "theorem_1"), ("error_set", "theorem_2")
VERDICTS = ("proven", "bounded", "not proven")  # what a certificate says itself; bounded: by a solver, in older files

KINDS = {  # of proof, by what is counted in it
    "pieces": "cells",
    "cells": "cells",
    "cases": "weak duality",
    "states": "replay",
    "vertices": "vertices",
    "boxes": "polynomial bounds",
}

SECONDS = 600  # after which the rest is "not checked"
MOST_BYTES = 6_000_000  # of a file
MOST_LEVELS = 20  # of lists and objects in one another
MOST_COMMAS = 500_000  # of a file, which limits the number of its entries
MOST_ENTRIES = 2_000  # of one list
MOST_REMEMBERED = 100_000  # supports of disturbance sets
MOST_MEMORY = 300_000_000  # bytes of whole numbers that are held at once, see `bytes_of`
BATCH = 16  # forms after which time and memory are looked at
MANY = 50  # corners of a polytope from which on their memory counts by itself
MOST_LAYERS = 100  # of a network
GRID = 150  # bits by which the grid of a box is finer than the smallest of its ends
MOST_DIGITS = 4_000  # of a fraction that is read or written
MOST_POWERS = 20  # of a term of f, together
MOST_TERMS = 10_000  # of a component of f, counted after (x + c)^k was multiplied out
MOST_BOXES = 20_000  # into which a region is split to bound the error of one mode
SHORT = 12  # decimals at most of a witness that is not printed as fractions
NUMERAL = re.compile(r"-?[0-9]{1,40}(\.[0-9]{1,40})?([eE][+-]?[0-3]?[0-9]{1,2})?")
MARKS = re.compile(r'\\.|["\[\]{}]', re.DOTALL)  # an escape, a quotation mark, the ends of lists and objects
FRACTION = re.compile(rf"-?[0-9]{{1,{MOST_DIGITS}}}(/[1-9][0-9]{{0,{MOST_DIGITS - 1}}})?")

Row = tuple[Fraction, ...]
HalfSpace = tuple[Row, Fraction]  # (a, b), the half-space a x <= b
Rows = Sequence[HalfSpace]
Corner = tuple[int, ...]  # (W, X), W > 0, the point X / W
Form = tuple[int, ...]  # (c, a), the function (c W + a X) / (unit W) of the point
Polytope = dict[Corner, int]  # the corners, and for each of them a mask of the limits that are tight there
Piece = tuple[Polytope, list[Form], int]  # where Phi is affine, its forms, and their unit
Limit = tuple[Form, int]  # a form that is at most 0, and its unit
Tree = Sequence[Sequence[int]]  # nodes, see `CaseCheck.holds`
Choices = dict[tuple[int, int], int]  # {(layer, neuron): the channel that wins}
Grid = list[tuple[int, int]]  # (low, high) of 1 and of every coordinate, in parts of a grid
Polynomial = dict[tuple[int, ...], Fraction]  # {powers: coefficient}
Box = list[tuple[Fraction, Fraction]]  # (low, high) of every coordinate
Claim = dict[str, Any]
Witness = dict[str, Any]
Finding = tuple[str, str, Witness | None]  # verdict, reason, witness


class Malformed(ValueError):
    """The file is no certificate."""


class Stopped(Exception):
    """The time or the memory of a check is used up; the message says which."""


class Budget:
    """What one check may use: call it where time passes, `hold` where numbers are kept. Either may raise Stopped."""

    def __init__(self, seconds: float) -> None:
        if not seconds >= 0:  # nan as well
            raise ValueError(f"seconds must be a number from 0 on; got {seconds!r}")
        self.seconds, self.end = seconds, time.monotonic() + seconds

    def __call__(self) -> None:
        if time.monotonic() > self.end:
            raise Stopped(f"stopped after {self.seconds:g} s")

    def hold(self, size: int) -> None:
        if size > MOST_MEMORY:
            raise Stopped(f"stopped, for it needs more than {MOST_MEMORY // 10**6} MB")


class Numeral(str):
    """A number as it is written."""


@dataclass(frozen=True)
class Result:
    """The result about one claim.

    `verdict` is "proven", "refuted" or "not checked"; `witness`, where there is one, a dict of fractions: "state",
    and for a step "mode", "disturbance", "after". `work` counts what was looked at, in `seconds`.
    """

    claim: str
    verdict: str
    reason: str
    witness: Witness | None = None
    work: dict[str, int] = field(default_factory=dict)
    seconds: float = field(default=0.0, compare=False)

    @property
    def kind(self) -> str:
        """How the result was derived: one of `KINDS`, or "other claims" where it only rests on them."""
        return next((KINDS[what] for what in self.work if what in KINDS), "other claims")

    def __str__(self) -> str:
        work = ", ".join(f"{count} {what}" for what, count in self.work.items())
        return f"{self.claim:<13} {self.verdict:<12} {self.reason}" + (f" [by {self.kind}: {work}]" if work else "")

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return {**{one.name: getattr(self, one.name) for one in fields_of(self)}, "kind": self.kind}


@dataclass(frozen=True)
class Report:
    """The results about a certificate.

    `digest` is "as written", "missing", "changed", "ignored", or "not checked" if the time was up; `network` says
    whether the certificate speaks of the network that was asked about (None: nothing was asked).
    """

    results: tuple[Result, ...]
    digest: str
    network: bool | None

    @property
    def proven(self) -> bool:
        """Whether every claim is proven, of the network that was asked about, and the digest is as written."""
        every = all(result.verdict == "proven" for result in self.results)
        return every and self.digest in ("as written", "ignored") and self.network is not False

    def __getitem__(self, claim: str) -> Result:
        """The Result about a claim of `CLAIMS`."""
        return {one.claim: one for one in self.results}[claim]

    def __str__(self) -> str:
        lines = list(map(str, self.results))
        lines.append(f"{'digest':<13} {self.digest}")
        if self.network is not None:
            lines.append(
                f"{'network':<13} {'the one asked about' if self.network else 'ANOTHER than the one asked about'}"
            )
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        claims = [one.to_dict() for one in self.results]
        return {"proven": self.proven, "digest": self.digest, "network": self.network, "claims": claims}


def verify(
    path: str | Path, network: str | Path | None = None, ignore_digest: bool = False, seconds: float = SECONDS
) -> Report:
    """Derive every claim of a certificate again.

    Parameters
    ----------
    path : str or Path
    network : str, Path or None
        A network.json; the report then says whether the certificate speaks of it.
    ignore_digest : bool
        Whether to go on to the mathematics without comparing the digest.
    seconds : float
        From the call on; after this time what is left is "not checked".

    Returns
    -------
    Report

    Raises
    ------
    Malformed
        If the file is no certificate; the message says what is missing, of another size, or no number.
    OSError
        If a file cannot be read.
    """
    clock = Budget(seconds)
    return _check(read(path), None if network is None else Network.of(read(network)), ignore_digest, clock)


def check(
    content: Any, network: "Network | None" = None, ignore_digest: bool = True, seconds: float = SECONDS
) -> Report:
    """`verify` for content that `parse` has read, and a Network."""
    return _check(content, network, ignore_digest, Budget(seconds))


def _check(content: Any, network: "Network | None", ignore_digest: bool, clock: Budget) -> Report:
    certificate = Certificate.of(content)
    asked = None if network is None else network == certificate.network
    try:
        state, reason = "ignored" if ignore_digest else compare_digest(content, clock), ""
    except Stopped as stop:
        state, reason = "not checked", str(stop)
    if state == "changed":
        reason = "the content is not what the digest was made of"
    if reason:
        return Report(tuple(Result(name, "not checked", reason) for name in certificate.claims), state, asked)
    return Report(Claims(certificate, clock).results(), state, asked)


# -- reading ------------------------------------------------------------------------------------------


def read(path: str | Path) -> Any:
    """The content of a JSON file as `parse` has it; Malformed if it is none, or too large."""
    with open(path, "rb") as file:
        text = file.read(MOST_BYTES + 1)
    if len(text) > MOST_BYTES:
        raise Malformed(f"{path} has more than {MOST_BYTES} bytes")
    return parse(text)


def parse(text: str | bytes) -> Any:
    """JSON with every number as a Numeral; Malformed if it is not plain JSON (UTF-8) of a reasonable size.

    Levels and entries are counted in the text, before anything is built from it.
    """
    try:
        text = text if isinstance(text, str) else str(text, "utf-8-sig")
        require_moderate(text)
        return json.loads(
            text, parse_int=numeral, parse_float=numeral, parse_constant=numeral, object_pairs_hook=without_duplicates
        )
    except Malformed:
        raise
    except (ValueError, RecursionError) as error:
        raise Malformed(f"this is not JSON, or only a part of it: {error}") from error


def require_moderate(text: str) -> None:
    """Malformed if lists and objects stand too deep in one another, or if there are too many entries."""
    if text.count(",") > MOST_COMMAS:
        raise Malformed(f"the file has more than {MOST_COMMAS} commas, and so too many entries")
    level, quoted = 0, False
    for mark in map(re.Match.group, MARKS.finditer(text)):
        if mark == '"':
            quoted = not quoted
        elif not quoted and mark in "[]{}":
            level += 1 if mark in "[{" else -1
            if level > MOST_LEVELS:
                raise Malformed(f"lists and objects stand in one another more than {MOST_LEVELS} levels deep")


def numeral(text: str) -> Numeral:
    """A number as it is written, if it is short and a finite double."""
    if not NUMERAL.fullmatch(text) or abs(float(text)) == float("inf"):
        raise Malformed(f"{text[:50]} is no number of reasonable size, which a finite double is")
    return Numeral(text)


def without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        ((name, _),) = Counter(name for name, _ in pairs).most_common(1)
        raise Malformed(f"the key {name[:50]!r} stands there twice")
    return found


def digest(content: dict[str, Any], clock: Callable[[], None] = lambda: None) -> str:
    """SHA-256 of everything but the digest, independent of the order of keys and of how a decimal is written."""
    found = hashlib.sha256()
    for text in canonical({key: content[key] for key in content if key != "digest"}, clock):
        found.update(text.encode())
    return found.hexdigest()


def canonical(value: Any, clock: Callable[[], None]) -> Iterator[str]:
    """One text for one content, in parts: keys sorted, the decimals that are written as fractions in lowest terms."""
    clock()
    if isinstance(value, dict):
        for i, key in enumerate(sorted(value)):
            yield f"{',' if i else '{'}{json.dumps(key)}:"
            yield from canonical(value[key], clock)
        yield "}" if value else "{}"
    elif isinstance(value, list):
        for i, entry in enumerate(value):
            yield "," if i else "["
            yield from canonical(entry, clock)
        yield "]" if value else "[]"
    else:
        yield str(Fraction(value)) if isinstance(value, Numeral) else json.dumps(value)


def compare_digest(content: dict[str, Any], clock: Budget) -> str:
    if "digest" not in content:
        return "missing"
    return "as written" if content["digest"] == digest(content, clock) else "changed"


def number(value: Any, where: str) -> Fraction:
    """A number as the double nearest to what is written, exactly; what is too small for a double is 0."""
    if not isinstance(value, Numeral):
        raise Malformed(f"{where}: {str(value)[:50]!r} is no number")
    return Fraction(float(value))


def natural(value: Any, where: str) -> int:
    """A whole number from 0 on."""
    found = number(value, where)
    if found < 0 or found.denominator > 1:
        raise Malformed(f"{where}: {value} is no whole number from 0 on")
    return int(found)


def coefficient_of(value: Any, where: str) -> Fraction:
    """A number, or text of the form p/q where no double is that fraction."""
    return number(value, where) if isinstance(value, Numeral) else fraction(value, where)


def fraction(value: Any, where: str) -> Fraction:
    """Text of the form p/q."""
    if type(value) is not str or not FRACTION.fullmatch(value):  # a Numeral is none
        raise Malformed(f"{where}: {str(value)[:50]!r} is no fraction")
    return Fraction(value)


def vector(value: Any, where: str, size: int, kind: Callable[[Any, str], Any] = number) -> tuple[Any, ...]:
    """A list of `size` numbers, each read by `kind`."""
    if not isinstance(value, list) or len(value) != size:
        raise Malformed(f"{where} should be a list of {size}")
    return tuple(kind(entry, where) for entry in value)


def matrix(value: Any, where: str, columns: int, rows: int | None = None) -> tuple[Row, ...]:
    """A list of lists of `columns` numbers; any positive number of them unless `rows` is given."""
    if not isinstance(value, list) or not 0 < len(value) <= MOST_ENTRIES or rows not in (None, len(value)):
        raise Malformed(f"{where} should be a list of {rows or f'1 to {MOST_ENTRIES}'} rows")
    return tuple(vector(row, where, columns) for row in value)


def fields(value: Any, where: str, names: Sequence[str], optional: Sequence[str] = ()) -> list[Any]:
    """The values of these keys of a dict that has them, and no others but `optional` ones."""
    if not isinstance(value, dict):
        raise Malformed(f"{where} should have the keys {', '.join(names)}")
    for name in names:
        if name not in value:
            raise Malformed(f"{where} lacks the key {name!r}")
    for name in value:
        if name not in (*names, *optional):
            raise Malformed(f"{where} has the key {name[:50]!r}, of which nothing is known")
    return [value[name] for name in names]


# -- content ------------------------------------------------------------------------------------------


def rows_of(value: Any, dimension: int, where: str) -> Rows:
    """The rows (a, b) of a set {x : a x <= b}."""
    H, h = fields(value, where, ("H", "h"))
    H = matrix(H, where, dimension)
    return tuple(zip(H, vector(h, where, len(H))))


@dataclass(frozen=True)
class Mode:
    """x+ = A x + B u + p + d wherever (x, u) lies in the region; region and disturbance are rows (a, b)."""

    A: tuple[Row, ...]
    B: tuple[Row, ...]
    p: Row
    region: Rows
    disturbance: Rows

    @staticmethod
    def of(value: Any, n: int, m: int, where: str) -> "Mode":
        A, B, p, region, disturbance = fields(value, where, ("A", "B", "p", "region", "disturbance"))
        return Mode(
            matrix(A, f"A of {where}", n, n),
            matrix(B, f"B of {where}", m, n),
            vector(p, f"p of {where}", n),
            rows_of(region, n + m, f"the region of {where}"),
            rows_of(disturbance, n, f"the disturbance set of {where}"),
        )

    @property
    def rows(self) -> list[Row]:
        """The rows (p, A, B) of x+ without d."""
        return [(p, *A, *B) for A, B, p in zip(self.A, self.B, self.p)]


@dataclass(frozen=True)
class Network:
    """Hidden layers (rows, pool) and rows of the output; a row is (b, w_1, ..., w_q)."""

    hidden: tuple[tuple[tuple[Row, ...], int], ...]
    output: tuple[Row, ...]

    @staticmethod
    def of(value: Any) -> "Network":
        name, layers, output = fields(value, "the network", ("format", "hidden", "output"))
        if name != NETWORK or not isinstance(layers, list) or len(layers) > MOST_LAYERS:
            raise Malformed(f"the network should have the format {NETWORK!r} and at most {MOST_LAYERS} hidden layers")
        hidden, columns = [], None
        for number, layer in enumerate(layers, start=1):
            where = f"hidden layer {number}"
            weight, bias, pool = fields(layer, where, ("weight", "bias", "pool"))
            rows, pool = Network._rows(weight, bias, columns, where), natural(pool, where)
            if pool < 1 or len(rows) % pool:
                raise Malformed(f"{where} has {len(rows)} rows, which do not divide into groups of {pool}")
            hidden.append((rows, pool))
            columns = len(rows) // pool
        weight, bias = fields(output, "the output", ("weight", "bias"))
        return Network(tuple(hidden), Network._rows(weight, bias, columns, "the output"))

    @staticmethod
    def _rows(weight: Any, bias: Any, columns: int | None, where: str) -> tuple[Row, ...]:
        if columns is None:  # the first layer says how many inputs there are
            columns = len(weight[0]) if isinstance(weight, list) and weight and isinstance(weight[0], list) else 0
        weight = matrix(weight, where, columns)
        return tuple((b, *row) for row, b in zip(weight, vector(bias, where, len(weight))))

    @property
    def states(self) -> int:
        return len((self.hidden[0][0] if self.hidden else self.output)[0]) - 1

    def __call__(self, x: Sequence[Fraction], clock: Budget) -> Row:
        """Phi(x) of fractions, from its definition."""
        for rows, pool in self.hidden:
            z = affine(rows, x, clock)
            x = [max(z[i : i + pool]) for i in range(0, len(z), pool)]
        return tuple(affine(self.output, x, clock))


@dataclass(frozen=True)
class Certificate:
    """A certificate, read: numbers are fractions, sets are rows (a, b)."""

    modes: tuple[Mode, ...]
    state_set: Rows
    input_set: Rows
    network: Network
    sets: tuple[Rows, ...]
    claims: dict[str, Claim]
    plant: tuple[Polynomial, ...] | None
    cases: "Cases | None"

    def acting(self, mode: Mode) -> list[HalfSpace]:
        """The rows of (x, u) where a mode acts, besides x in X."""
        none = (Fraction(0),) * self.network.states
        return [*mode.region, *(((*none, *a), b) for a, b in self.input_set)]

    @staticmethod
    def of(content: Any) -> "Certificate":
        if not isinstance(content, dict) or content.get("format") not in (FORMAT, WITH_CASES):
            raise Malformed(f"the file has neither the format {FORMAT!r} nor {WITH_CASES!r}")
        keys = ("format", "system", "network", "template", "sets", "claims")
        other = ("cases",) if content["format"] == WITH_CASES else ("bounds",)
        _, system, network, template, sets, claims = fields(
            content, "the certificate", keys, ("digest", "plant", *other)
        )
        network = Network.of(network)
        n, m = network.states, len(network.output)
        modes, state_set, input_set = fields(system, "the system", ("modes", "state_set", "input_set"))
        if not isinstance(modes, list) or not 0 < len(modes) <= MOST_ENTRIES or not n:
            raise Malformed("the system should have a list of modes and at least one state")
        C = matrix(template, "the template", n)
        if not all(map(any, C)):
            raise Malformed("the template has a row of zeros, which is no direction")
        sets = matrix(sets, "sets", len(C))
        names = ("inputs", "safe_set", *OF_SEQUENCE * (len(sets) > 1), *OF_PLANT * ("plant" in content))
        return Certificate(
            tuple(Mode.of(mode, n, m, f"mode {number}") for number, mode in enumerate(modes, start=1)),
            rows_of(state_set, n, "the state set"),
            rows_of(input_set, m, "the input set"),
            network,
            tuple(tuple(zip(C, h)) for h in sets),
            {name: read_claim(name, claim, n) for name, claim in zip(names, fields(claims, "claims", names))},
            read_plant(content["plant"], n, n + m) if "plant" in content else None,
            read_cases(content["cases"], n) if "cases" in content else None,
        )


def read_claim(name: str, value: Any, n: int) -> dict[str, Any]:
    """What a claim says, numbers as fractions."""
    where = f"the claim {name!r}"
    kinds = {
        "steps": lambda v: natural(v, where),
        "epsilon": lambda v: number(v, where),
        "centre": lambda v: vector(v, where, n),
        "alpha": lambda v: None if v is None else fraction(v, where),
        "holds": lambda v: v,
        "stable": lambda v: v,
    }
    own = {"terminal_set": ("steps",), "criterion": ("epsilon", "centre", "holds")}
    names = {**own, "theorem_1": ("alpha", "centre", "stable")}.get(name, ())
    verdict, *values = fields(value, where, ("verdict", *names), ("reason", "witness"))
    if verdict not in VERDICTS:
        raise Malformed(f"{where} has a verdict that is none of {', '.join(VERDICTS)}")
    witness = value.get("witness")
    if witness is not None and verdict != "not proven":
        raise Malformed(f"{where} is {verdict}, and yet has a witness against it")
    found = {key: kinds[key](value) for key, value in zip(names, values)}
    if not isinstance(found.get("holds", True), bool) or not isinstance(found.get("stable", True), bool):
        raise Malformed(f"{where} should say true or false")
    if found.get("epsilon", 1) <= 0:
        raise Malformed(f"{where} needs a positive epsilon")
    return {"verdict": verdict, "witness": witness, **found}


def read_plant(value: Any, n: int, size: int) -> tuple[Polynomial, ...]:
    """The components of f as {powers: coefficient}."""
    (f,) = fields(value, "the plant", ("f",))
    if not isinstance(f, list) or len(f) != n or not all(isinstance(terms, list) for terms in f):
        raise Malformed(f"f should be {n} lists of terms")
    components = []
    for terms in f:
        found, count = {}, 0
        for term in terms:
            coefficient, powers = fields(term, "a term of f", ("coefficient", "powers"))
            powers = vector(powers, "the powers of f", size, natural)
            count += prod(power + 1 for power in powers)
            if sum(powers) > MOST_POWERS or count > MOST_TERMS:
                raise Malformed(f"f has powers above {MOST_POWERS}, or more than {MOST_TERMS} terms if multiplied out")
            if powers in found:
                raise Malformed(f"the powers {powers} of f stand there twice")
            found[powers] = coefficient_of(coefficient, "f")
        components.append(found)
    return tuple(components)


@dataclass(frozen=True)
class Cases:
    """A proof by cases.

    A tree is a list of nodes in the order in which they are visited; for an image it has a part for every mode, one
    after the other. A node of two entries (layer, neuron) splits a case; any other has an odd number of entries, the
    weights of a `bound`. See `CaseCheck.holds`.

    inputs      a tree for every row of U
    images      {(k, j): a tree for every row of R_j}, for the image of R_k
    attained    for every row of R_k a mode, from 0, and a state that attain it, see `Claims.criterion`; or none
    """

    inputs: tuple[Tree, ...]
    images: dict[tuple[int, int], tuple[Tree, ...]]
    attained: tuple[tuple[int, Row], ...]


def read_cases(value: Any, n: int) -> Cases:
    """Trees as lists of nodes, which are lists of whole numbers."""
    inputs, images, attained = fields(value, "the cases", ("inputs", "images", "attained"))
    if not isinstance(images, list) or not isinstance(attained, list):
        raise Malformed("images and attained should be lists")
    found = {}
    for image in images:
        k, j, rows = fields(image, "an image of the cases", ("from", "to", "rows"))
        found[natural(k, "from"), natural(j, "to")] = read_trees(rows, "the rows of an image")
    states = []
    for one in attained:
        mode, x = fields(one, "a state of the cases", ("mode", "state"))
        states.append((natural(mode, "mode") - 1, vector(x, "a state of the cases", n)))
    return Cases(read_trees(inputs, "the cases of the inputs"), found, tuple(states))


def read_trees(value: Any, where: str) -> tuple[Tree, ...]:
    """A list of lists of nodes."""
    lists = isinstance(value, list) and all(isinstance(tree, list) for tree in value)
    if not lists or not all(isinstance(node, list) for tree in value for node in tree):
        raise Malformed(f"{where} should be a list of trees, which are lists of nodes, which are lists")
    return tuple(tuple(tuple(natural(entry, where) for entry in node) for node in tree) for tree in value)


# -- polytopes ----------------------------------------------------------------------------------------


def dot(a: Iterable[Any], x: Iterable[Any]) -> Any:
    """a x of rows of fractions."""
    return sum(map(mul, a, x))


def whole(row: Iterable[Fraction]) -> tuple[tuple[int, ...], int]:
    """A row of fractions as whole numbers, and the number by which it was multiplied for that."""
    row = tuple(row)
    unit = lcm(*(entry.denominator for entry in row))
    return tuple(entry.numerator * (unit // entry.denominator) for entry in row), unit


def affine(rows: Iterable[Row], x: Sequence[Fraction], clock: Budget) -> list[Fraction]:
    """b + w x for each row (b, w) of fractions, reduced once per row."""
    x, unit = whole((Fraction(1), *x))
    found = []
    for row, own in map(whole, rows):
        clock()
        found.append(Fraction(dot(row, x), own * unit))
    return found


def half_space(a: Row, b: Fraction) -> Form:
    """The form that is at most 0 where a x <= b."""
    return whole((-b, *a))[0]


def bytes_of(*lists: Iterable[Sequence[int]]) -> int:
    """Roughly the memory that corners or forms take."""
    return sum([120 + 32 * len(row) + sum(map(int.bit_length, row)) // 8 for rows in lists for row in rows])


def point(corner: Corner) -> Row:
    """A corner as fractions."""
    return tuple(Fraction(entry, corner[0]) for entry in corner[1:])


def at(form: Form, corner: Corner) -> int:
    """c W + a X: at most 0 in the half-space of the form."""
    return sum(map(mul, form, corner))


def crossing(x: Corner, y: Corner, before: int, after: int) -> Corner:
    """The corner between x and y where a form vanishes that is `before` < 0 at x and `after` > 0 at y.

    after x - before y, for the form has the value after before - before after = 0 there; W stays positive.
    """
    between = [after * a - before * b for a, b in zip(x, y)]
    common = gcd(*between)
    return tuple(entry // common for entry in between)


def clip(P: Polytope, form: Form, clock: Budget, flat: bool = True, values: Sequence[int] | None = None) -> Polytope:
    """The part of a polytope in the half-space of a form; {} if there is none. `values` are `at` its corners, if known.

    Its corners are those of P in the half-space, and one on each edge of P that crosses the boundary. Two corners
    share an edge if and only if no third is tight in all the limits in which both are: these limits describe the
    smallest face that holds both. On an edge at least n - 1 of them are tight, which is a quick test. Limits that are
    tight inside an edge are tight on all of it.

    A form that is nowhere positive changes nothing and needs no bit. A bit that is set nowhere is used again: its limit
    is tight in no corner, and so superfluous. A part that only touches the boundary is a face of P, of lower dimension;
    without `flat` it is {} as well.
    """
    values = [sum(map(mul, form, x)) for x in P] if values is None else values
    if not values or max(values) <= 0:
        return P
    kept: Polytope = {}
    inside = []
    beyond = []
    touching = []
    used = 0
    for (x, mask), value in zip(P.items(), values):
        if value > 0:
            beyond.append((x, mask, value))
            continue
        kept[x] = mask
        used |= mask
        if value < 0:
            inside.append((x, mask, value))
        else:
            touching.append(x)
    if not (inside or flat):
        return {}
    bit = ~used & (used + 1)
    for x in touching:
        kept[x] |= bit
    least, masks = len(form) - 2, list(P.values())
    for x, mask, before in inside:
        if len(kept) > MANY:
            clock.hold(len(kept) * bytes_of([x]))
        for y, other, after in beyond:
            common = mask & other
            if common.bit_count() >= least:
                clock()
                if len([each for each in masks if each & common == common]) == 2:
                    kept[crossing(x, y, before, after)] = common | bit
    return kept


def clip_all(P: Polytope, forms: Iterable[Form], clock: Budget) -> Polytope:
    """The part of a polytope in all half-spaces."""
    for form in forms:
        clock()
        if not P:
            break
        P = clip(P, form, clock)
    return P


def polytope(rows: Rows, where: str, clock: Budget) -> Polytope:
    """{x : a x <= b for every row (a, b)}, {} if it is empty; Malformed if it is not bounded.

    For whole a and b the smallest faces of this set hold points with no entry beyond n! max|a|^(n-1) max|b|, by
    Cramer's rule: the determinant below the fraction is whole and not 0. A simplex around all such points is cut. A set
    that is not empty has such a face, and so meets the simplex inside; it is not bounded if and only if it goes on to
    the boundary of the simplex, where there is a corner then.
    """
    forms = [half_space(a, b) for a, b in rows]
    n = len(forms[0]) - 1
    most = max(1, *(abs(entry) for form in forms for entry in form[1:]))
    clock.hold((n + 1) ** 2 * (32 + n * (most.bit_length() + n.bit_length()) // 8))
    r = factorial(n) * most ** (n - 1) * max(abs(form[0]) for form in forms) + 1
    ends = [(-r,) * n] + [(*(-r,) * i, (2 * n - 1) * r, *(-r,) * (n - 1 - i)) for i in range(n)]
    every = (1 << n + 1) - 1
    P = clip_all({(1, *x): every ^ 1 << i for i, x in enumerate(ends)}, forms, clock)
    if any(min(x[1:]) == -r * x[0] or sum(x[1:]) == n * r * x[0] for x in P):
        raise Malformed(f"{where} is not bounded")
    return P


def product(P: Polytope, Q: Polytope, clock: Budget) -> Polytope:
    """{(x, u) : x in P, u in Q}."""
    clock.hold(len(P) * bytes_of(Q) + len(Q) * bytes_of(P))
    shift = max(P.values(), default=0).bit_length()
    found = {}
    for x, mask in P.items():
        clock()
        for u, other in Q.items():
            both = x[0] * u[0], *(entry * u[0] for entry in x[1:]), *(entry * x[0] for entry in u[1:])
            found[both] = mask | other << shift
    return found


def middle(P: Polytope) -> Row:
    """A point inside a polytope: a mean of all corners, whose weights differ by less than a factor of two."""
    most = max(x[0] for x in P)
    return point(tuple(map(sum, zip(*([most // x[0] * entry for entry in x] for x in P)))))


def uncovered(P: Polytope, regions: Iterable[Sequence[Form]], clock: Budget) -> Polytope:
    """A part of a polytope that no region (a list of forms) covers, or {}.

    What closed regions leave of a polytope is open relative to it: it is empty, or of the dimension of the polytope.
    Parts are kept with their boundaries, which regions may cover; the `middle` of a part is covered by none, since
    every form that cut it off is positive in one of its corners at least and negative in none.
    """
    bare = [P]
    for region in regions:
        following = []
        held = 0
        for part in bare:
            for form in region:  # what lies beyond the first limit, beyond the second but not the first, ...
                clock()
                if any(at(form, x) > 0 for x in part):
                    following.append(clip(part, tuple(-entry for entry in form), clock, flat=False))
                    held += bytes_of(following[-1])
                    clock.hold(held)
                    part = clip(part, form, clock, flat=False)
        bare = [part for part in following if part]
    return bare[0] if bare else {}


# -- the loop -----------------------------------------------------------------------------------------


def over_one_unit(rows: Iterable[Row], clock: Budget) -> tuple[list[tuple[int, ...]], int]:
    """Rows of fractions as rows of whole numbers over one unit: rows, unit."""
    rows = list(rows)
    unit = 1
    for row in rows:
        clock()
        unit = lcm(unit, *(entry.denominator for entry in row))
    clock.hold(sum(32 + (unit.bit_length() + entry.numerator.bit_length()) // 8 for row in rows for entry in row))
    return [tuple(entry.numerator * (unit // entry.denominator) for entry in row) for row in rows], unit


def axes(n: int, unit: int = 1) -> list[Form]:
    """The coordinates of x as forms over a unit."""
    return [tuple(unit * (i == j) for j in range(n + 1)) for i in range(1, n + 1)]


def combine(row: Sequence[int], forms: Sequence[Form], unit: int) -> Form:
    """The form b + w_1 f_1 + ... + w_q f_q of whole numbers (b, w) and forms over a unit; entries that lack are 0."""
    return mixed(row, list(zip_longest(*forms, fillvalue=0)), unit)


def mixed(row: Sequence[int], columns: Sequence[Sequence[int]], unit: int) -> Form:
    """As `combine`, of the columns of the matrix with the forms as rows."""
    weights = row[1:]
    entries = [sum(map(mul, weights, column)) for column in columns]
    entries[0] += row[0] * unit
    return tuple(entries)


def combined(
    rows: Iterable[Sequence[int]], forms: Sequence[Form], unit: int, clock: Budget, held: int = 0
) -> list[Form]:
    """`combine` for each row; `held` are the bytes that others hold."""
    found: list[Form] = []
    columns = list(zip_longest(*forms, fillvalue=0))
    for row in rows:
        found.append(mixed(row, columns, unit))
        if len(found) % BATCH == 0:
            clock()
            held += bytes_of(found[-BATCH:])
            clock.hold(held)
    return found


def winners(P: Polytope, channels: Sequence[Form], clock: Budget) -> Iterator[tuple[Polytope, Form]]:
    """Parts of a polytope that cover it, each with the largest of several forms on it.

    Parts of lower dimension than the polytope are left out: Phi is continuous, and their neighbours hold them. Of forms
    that are equal on the polytope the first has the part.
    """
    heights = []
    for form in channels:
        clock()
        heights.append([sum(map(mul, form, x)) for x in P])
    largest = [max(column) for column in zip(*heights)]
    if largest in heights:
        yield P, channels[heights.index(largest)]
        return
    for j, form in enumerate(channels):
        part = {} if heights[j] in heights[:j] else P
        for other, height in zip(channels, heights):
            if part and any(map(gt, height, heights[j])):
                values = list(map(sub, height, heights[j])) if part is P else None
                part = clip(part, tuple(map(sub, other, form)), clock, flat=False, values=values)
        if part:
            yield part, form


def affine_pieces(network: Network, domain: Polytope, clock: Budget) -> list[Piece]:
    """Polytopes that cover the domain, each with the forms of Phi on it and their unit: list of triples."""
    pieces: list[Piece] = [(domain, axes(network.states), 1)]
    for fractions, pool in network.hidden:
        rows, own = over_one_unit(fractions, clock)
        following, size = [], 0
        for P, forms, unit in pieces:
            channels = combined(rows, forms, unit, clock, size)
            parts: list[Any] = [(P, [])]
            for start in range(0, len(channels), pool):
                neuron = channels[start : start + pool]
                split = []
                held = 0
                for old, won in parts:
                    for new, form in winners(old, neuron, clock):
                        split.append((new, [*won, form]))
                        held += bytes_of([form], () if new is old else new) + 8 * len(won)
                        clock.hold(size + held)
                parts = split
            for part, won in parts:
                following.append((part, won, unit * own))
                size += bytes_of(part, won)
                clock.hold(size)
        pieces = following
    rows, own = over_one_unit(network.output, clock)
    found, size = [], 0
    for P, forms, unit in pieces:
        found.append((P, combined(rows, forms, unit, clock, size), unit * own))
        size += bytes_of(P, found[-1][1])
    return found


@dataclass(frozen=True)
class Cell:
    """A polytope on which mode number `mode` acts (from 0), with the forms of A x + B Phi(x) + p and their unit."""

    part: Polytope
    mode: int
    after: list[Form]
    unit: int


# -- cases --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """What is known of Phi(x) for the x of a box if some neurons are won by given channels.

    The variables are z = (x, y), with an entry of y for every neuron of which the winner is open.

    box         ends (low, high) of 1 and of every variable, in parts of a grid
    limits      forms of z that are at most 0, each with its unit
    open        {(layer, neuron): the number of its first limit}, in the order of the variables
    z           forms of x and Phi(x) over `unit`
    """

    box: Grid
    limits: list[Limit]
    open: dict[tuple[int, int], int]
    z: list[Form]
    unit: int


def gridded(box: Box) -> Grid:
    """The ends of 1 and of a box, rounded outward to a grid of 2^-`GRID` times the smallest of them."""
    least = min(1, *(max(abs(low), abs(high)) or 1 for low, high in box))
    grid = 1 << GRID + ceil(1 / least).bit_length()
    return [(grid, grid), *((floor(low * grid), ceil(high * grid)) for low, high in box)]


def highest(form: Form, box: Grid) -> int:
    """The maximum of a form over a box, times its unit and the grid; entries that the form lacks are 0."""
    return sum(a * (high if a > 0 else low) for a, (low, high) in zip(form, box))


def ahead(form: Form, other: Form) -> Form:
    """form - other; entries that one of them lacks are 0."""
    return tuple(a - b for a, b in zip_longest(form, other, fillvalue=0))


def case_of(network: Network, box: Grid, choices: Choices, clock: Budget) -> Case:
    """The Case of a box in which the winners are `choices`, {(layer, neuron): channel}, all counted from 0.

    A neuron is max(f_1, ..., f_q). Where f_j wins by choice, f_i - f_j <= 0 for every i. Where the bounds of the
    differences over the box show that f_j is the largest, it wins, and nothing is to be said. Else the neuron is a
    variable y, between the largest of the lower and the largest of the upper bounds of f_1, ..., f_q, and `open_limits`
    are known of it.
    """
    box, unit = list(box), 1
    forms = axes(len(box) - 1)
    limits: list[Limit] = []
    still_open: dict[tuple[int, int], int] = {}
    size = 0
    for layer, (fractions, pool) in enumerate(network.hidden):
        rows, own = over_one_unit(fractions, clock)
        channels = combined(rows, forms, unit, clock, size)
        unit *= own
        forms = []
        for start in range(0, len(channels), pool):
            known = len(limits)
            neuron = channels[start : start + pool]
            winner = choices.get((layer, start // pool))
            if winner is not None:
                limits += [(ahead(form, neuron[winner]), unit) for form in neuron if form is not neuron[winner]]
            else:
                leads = []
                for form in neuron:
                    clock()
                    leads.append(max(highest(ahead(other, form), box) for other in neuron))
                winner = leads.index(0) if 0 in leads else None
            if winner is not None:
                forms.append(neuron[winner])
            else:
                y = (0,) * len(box) + (unit,)
                still_open[layer, start // pool] = known
                limits += open_limits(neuron, leads, y, unit, box[0][0])
                low = max(-highest(ahead((), form), box) for form in neuron)
                high = max(highest(form, box) for form in neuron)
                box.append((low // unit, -(-high // unit)))
                forms.append(y)
            size += bytes_of(form for form, _ in limits[known:])
            clock.hold(size)
    rows, own = over_one_unit(network.output, clock)
    outputs = combined(rows, forms, unit, clock, size)
    return Case(box, limits, still_open, [*axes(network.states, unit * own), *outputs], unit * own)


def open_limits(neuron: Sequence[Form], leads: Sequence[int], y: Form, unit: int, grid: int) -> Iterator[Limit]:
    """What is known of y = max(f_1, ..., f_q), with lead_j / (unit grid) >= f_i - f_j for every i.

    f_i - y <= 0                                    for every i
    y - f_j - lead_j <= 0                           for every j, if q > 2
    (h - l) (y - f_2) - h (f_1 - f_2) + h l <= 0    if q = 2 and l <= f_1 - f_2 <= h: the chord of the maximum
    """
    for form in neuron:
        yield ahead(form, y), unit
    if len(neuron) == 2:
        high, low = -(-leads[1] // unit), -leads[0] // unit
        row = high * low, (high - low) * grid, -high * grid, low * grid
        yield combine(row, [y, *neuron], unit), unit * grid << (high - low).bit_length()
    else:
        for form, lead in zip(neuron, leads):
            yield combine((-lead, grid, -grid), [y, form], 1), unit * grid


def bound(form: Form, unit: int, weights: Sequence[int], limits: Sequence[Limit], box: Grid) -> Fraction | None:
    """An upper bound of a form in a case by weak duality; None if there is none.

    `weights` are m, and pairs (i, w) of the number of a limit and its weight; all are at least 0. With
    rest = m form - sum of w_i limit_i, m form <= rest in the case, where limits are at most 0, and so
    form <= (maximum of rest over the box) / m. For m = 0, rest is at least 0 in all points of the case: if its maximum
    is negative there are none, and -1 is as true a bound as any.
    """
    m, numbers, factors = weights[0], weights[1::2], weights[2::2]
    chosen = [(form, unit), *(limits[i] for i in numbers)]
    common = lcm(*(unit for _, unit in chosen))
    scaled = [w * (common // unit) for w, (_, unit) in zip((m, *(-w for w in factors)), chosen)]
    rest = highest(combine((0, *scaled), [form for form, _ in chosen], 1), box)
    if m:
        return Fraction(rest, m * common * box[0][0])
    return Fraction(-1) if rest < 0 else None


class CaseCheck:
    """Proofs by cases about the images of one set after the other."""

    def __init__(self, certificate: "Certificate", X: Polytope, disturbances: Sequence[Sequence[Row]], clock: Budget):
        self.certificate, self._disturbances, self._clock = certificate, disturbances, clock
        self._ends = [(min(entry), max(entry)) for entry in zip(*map(point, X))]
        self._known: dict[Any, tuple[Case, list[Limit]]] = {}
        self._spread: dict[tuple[int, Row], Fraction] = {}
        self.checked = 0

    def enter(self, rows: Rows) -> None:
        """Speak of the states of X with a x <= b for these rows from now on."""
        self._rows, self._held = rows, 0
        self._known.clear()
        ends = [list(pair) for pair in self._ends]
        for a, b in rows:
            used = [i for i, entry in enumerate(a) if entry]
            if len(used) == 1:  # the row cuts the box
                i, end = used[0], b / a[used[0]]
                ends[i] = [ends[i][0], min(ends[i][1], end)] if a[i] > 0 else [max(ends[i][0], end), ends[i][1]]
        self._box = gridded([(low, high) for low, high in ends])

    def case(self, number: int | None, choices: Choices) -> tuple[Case, list[Limit]]:
        """The Case with these choices where a mode acts (None: in all of the set), and all that is at most 0 in it.

        These are the rows of the set, those of (x, u) where the mode acts, and the limits of the Case.
        """
        key = number, frozenset(choices.items())
        if key not in self._known:
            case = case_of(self.certificate.network, self._box, choices, self._clock)
            limits = [whole((-b, *a)) for a, b in self._rows]
            for a, b in () if number is None else self.certificate.acting(self.certificate.modes[number]):
                self._clock()
                row, own = whole((-b, *a))
                limits.append((combine(row, case.z, case.unit), own * case.unit))
            limits += case.limits
            self._held += bytes_of((form for form, _ in limits), case.z, case.box, choices)
            if self._held > MOST_MEMORY // 2:
                self._known.clear()
                self._held = 0
            self._known[key] = case, limits
        return self._known[key]

    def objective(self, number: int | None, row: HalfSpace) -> tuple[Form, int]:
        """a x+ + h(a) - b in a mode, h the support function of its D, or a u - b: a form of (x, u), and its unit."""
        a, b = row
        if number is None:
            return whole((-b, *((Fraction(0),) * self.certificate.network.states), *a))
        if (number, a) not in self._spread:
            self._spread[number, a] = max(dot(a, d) for d in self._disturbances[number])
        constant, *linear = (dot(a, column) for column in zip(*self.certificate.modes[number].rows))
        return whole((constant + self._spread[number, a] - b, *linear))

    def holds(self, nodes: Iterator[Sequence[int]], number: int | None, row: HalfSpace) -> bool:
        """Whether the next nodes of a tree show that a row holds in a mode (None: for Phi), whatever channels win.

        The nodes stand in the order in which they are visited: (layer, neuron) splits a case into those that the
        channels of this neuron win, in their order; any other node are the weights of a `bound`.
        """
        hidden = self.certificate.network.hidden
        objective, unit = self.objective(number, row)
        left: list[Choices] = [{}]
        held = 0
        while left:
            self._clock()
            choices, node = left.pop(), next(nodes, ())
            held -= bytes_of(choices)
            if len(node) == 2:
                layer, neuron = node
                if layer >= len(hidden) or neuron >= len(hidden[layer][0]) // hidden[layer][1]:
                    return False
                if (layer, neuron) in choices:
                    return False
                for j in reversed(range(hidden[layer][1])):
                    left.append({**choices, (layer, neuron): j})
                    held += bytes_of(left[-1])
                    self._clock.hold(held)
                continue
            self.checked += 1
            case, limits = self.case(number, choices)
            if not len(node) % 2 or any(i >= len(limits) for i in node[1::2]):
                return False
            form = combine(objective, case.z, case.unit)
            found = bound(form, unit * case.unit, node, limits, case.box)
            if found is None or found > 0:
                return False
        return True


# -- the claims ---------------------------------------------------------------------------------------


def proven(reason: str) -> Finding:
    return "proven", reason, None


def refuted(reason: str, witness: Witness | None = None) -> Finding:
    return "refuted", reason, witness


def unchecked(reason: str) -> Finding:
    return "not checked", reason, None


class Claims:
    """All claims of one certificate; the method with a claim's name decides it."""

    def __init__(self, certificate: Certificate, clock: Budget) -> None:
        self.certificate, self._clock = certificate, clock
        self.sets, self.last = certificate.sets, len(certificate.sets) - 1
        self.n = len(certificate.modes[0].A)
        self.found: dict[str, Result] = {}
        self._work: Counter[str] = Counter()
        self._spread: dict[tuple[int, int], Fraction] = {}
        self._along: dict[tuple[int, int], tuple[Form, int]] = {}
        self._clipped: tuple[int | None, list[tuple[int, Polytope]]] = None, []
        self._polytopes: dict[int, Polytope] = {}
        self._C = [a for a, _ in self.sets[0]]

    def results(self) -> tuple[Result, ...]:
        """One Result per claim, in the order of `CLAIMS`.

        A claim that the certificate does not make is not proven. A witness in the file counts for nothing: the Result
        has the one that is derived here, and says so if the file has another.
        """
        for key, claim in self.certificate.claims.items():
            self._work.clear()
            start = time.monotonic()
            try:
                verdict, reason, witness = getattr(self, key)(claim)
            except Stopped as stop:
                verdict, reason, witness = unchecked(str(stop))
            if verdict == "proven" and claim["verdict"] == "not proven":
                verdict, reason, witness = unchecked("the certificate itself does not claim it")
            if claim["witness"] not in (None, parse(json.dumps(witness))):
                reason += "; the witness in the file is another than the one derived here"
            seconds = time.monotonic() - start
            self.found[key] = Result(key, verdict, reason, witness, dict(self._work), seconds)
        return tuple(self.found.values())

    def inputs(self, claim: Claim) -> Finding:
        """No row a u - b of U is positive in a corner of a piece, where it is largest; for an empty U one is."""
        if self.certificate.cases is not None:
            found = self._by_cases(self.certificate.cases.inputs, None)
            return proven(CLAIMS["inputs"]) if found is None else self._claimed_state(claim) or found
        for P, forms, unit in self._pieces:
            self._work["pieces"] += 1
            for a, b in self.certificate.input_set:
                self._clock()
                excess = combine(half_space(a, b), forms, unit)
                for x in P:
                    if at(excess, x) > 0:
                        return self._input_outside(point(x), self.certificate.network(point(x), self._clock), (a, b))
        return proven(CLAIMS["inputs"])

    def safe_set(self, claim: Claim) -> Finding:
        """F_max is not empty, lies in X, is covered by modes, and holds its image.

        States without a successor are witnesses by themselves: those outside X, those with an input outside U, those
        that no region contains.
        """
        if not self._corners(0):
            return refuted("F_max is empty")
        found = self._beyond(0) or self._without_successor() or self._leaves(0, 0, claim)
        return found or proven(CLAIMS["safe_set"])

    def sequence(self, claim: Claim) -> Finding:
        """The image of R_k lies in R_(k+1), k = 0, 1, ...; that of an empty set does in any set.

        States of R_k without a successor have no image; where `safe_set` is proven there are none.
        """
        for k in range(self.last):
            found = self._beyond(k) or self._leaves(k, k + 1, claim)
            if found:
                return found
            self._work["steps"] += 1
        return proven(CLAIMS["sequence"])

    def terminal_set(self, claim: Claim) -> Finding:
        """With F_max RPI and the images contained, R_k is reached in step k; it is not empty, for F_max is not."""
        if claim["steps"] != self.last:
            return refuted(f"the sequence has {self.last} steps, not {claim['steps']}")
        found = self._missing("safe_set", "sequence") or self._beyond(self.last)
        found = found or self._leaves(self.last, self.last, claim)
        return found or proven(f"R_{self.last} is RPI and reached from all of F_max within {self.last} steps")

    def criterion(self, claim: Claim) -> Finding:
        """S = c + (R_k - c) / (1 + epsilon) lies in R_1-bar(S), the smallest set with the rows C around R_1(S).

        A row a x <= b of R_k is a x <= a c + (b - a c) / (1 + epsilon) = b - (b - a c) epsilon / (1 + epsilon) of S.
        S lies in R_1-bar(S) if h of R_1(S) >= h of S along every row. The equation asks for c in R_k: the criterion
        fails where b - a c < 0 for a row; 0 is allowed, c then lies on the boundary of R_k and of S. Where c is in R_k
        S is not empty, for it holds c, and is part of R_k, which lies in F_max, where the cells are.
        """
        if missing := self._missing("safe_set", "terminal_set"):
            return missing
        c, epsilon = claim["centre"], claim["epsilon"]
        apart = [b - dot(a, c) for a, b in self.sets[-1]]
        S = tuple((a, b - room * epsilon / (1 + epsilon)) for (a, b), room in zip(self.sets[-1], apart))
        P = polytope(S, "S", self._clock) if min(apart) >= 0 else {}  # c lies in R_k
        cases = self.certificate.cases
        if P and cases is not None:
            self._work["states"] += len(cases.attained)
            if len(cases.attained) != len(S):
                return unchecked("the certificate names no states in which the rows are attained")
            holds = all(
                self._attained(S, r, self._support(P, a), *one)
                for r, ((a, _), one) in enumerate(zip(S, cases.attained))
            )
            if not holds:
                return unchecked("the states of the certificate do not attain every row")
        else:
            holds = bool(P) and all(self._attains(S, r, self._support(P, a)) for r, (a, _) in enumerate(S))
        word = "holds" if holds else "fails"
        says = f"eq. (25), TerminationFmin, about {show(c)} with epsilon = {about(epsilon)} {word}"
        return proven(says) if holds == claim["holds"] else refuted(says)

    def theorem_1(self, claim: Claim) -> Finding:
        """alpha = min over the rows (a, b) of R_(k-1) of (b - a c) / (h of R_k along a - a c).

        c + alpha (R_k - c) lies in R_(k-1) if a c + alpha (h of R_k along a - a c) <= b for every row, for alpha >= 0.
        Room b - a c against size h of R_k along a - a c, for every row:

            size > 0, room > 0     alpha <= room / size
            size > 0, room = 0     c lies on the boundary of R_(k-1): alpha = 0
            size > 0, room < 0     c lies outside R_(k-1), and in c + alpha (R_k - c) for every alpha >= 0: none
            size <= 0              c lies on the boundary of R_k or outside, or R_k is flat: the theorem speaks of no
                                   such c, and there is no alpha

        Theorem 1 needs alpha > 1; with alpha = 1 the boundaries of R_k and R_(k-1) touch.
        """
        c, R = claim["centre"], self._corners(self.last)
        if not R:
            return refuted("the terminal set is empty")
        self._work["vertices"] += len(R)
        sizes = [self._support(R, a) for a, _ in self.sets[-2]]
        apart = [(b - dot(a, c), size - dot(a, c)) for (a, b), size in zip(self.sets[-2], sizes)]
        alpha = None
        if min(size for _, size in apart) <= 0:
            says = "there is no alpha, for c is not inside R_k"
        elif min(room for room, _ in apart) < 0:
            says = f"there is no alpha, for c is not in {name(self.last - 1)}"
        else:
            alpha = min(room / size for room, size in apart)
            says = f"alpha = {beside_one(alpha)}"
        stable = alpha is not None and alpha > 1
        if claim["alpha"] != alpha or claim["stable"] != stable:
            return refuted(f"{says}; Theorem 1 {'applies' if stable else 'does not apply'}")
        if not stable:
            return proven(f"{says}, so that Theorem 1 does not apply at this k")
        missing = self._missing("inputs", "safe_set", "sequence", "terminal_set")
        return missing or proven(f"{says}: R_k is asymptotically stable with region of attraction F_max")

    def error_set(self, claim: Claim) -> Finding:
        """Each a (f - f_PWA) - b, (a, b) a row of D, is a polynomial nowhere positive in the region & X x U.

        0 is allowed, for D is closed. Where the region does not meet X x U there is nothing to show; where it does, an
        empty D has a row that is positive.
        """
        certificate = self.certificate
        n, m = self.n, len(certificate.network.output)
        plant, zero = certificate.plant, Fraction(0)
        if plant is None:
            return unchecked("the certificate names no plant")
        limits = [((*a, *[zero] * m), b) for a, b in certificate.state_set]
        limits += [((*[zero] * n, *a), b) for a, b in certificate.input_set]
        for number, mode in enumerate(certificate.modes, start=1):
            rows = [*mode.region, *limits]
            box = bounding_box(rows)
            if box is None:
                return unchecked(f"single coordinates of the region of mode {number} have no limits")
            for a, b in mode.disturbance:
                z, used = positive_somewhere(error_along(a, b, mode, plant), box, rows, self._clock)
                if z is not None:
                    says = f"x = {show(z[:n])}, u = {show(z[n:])}: f - f_PWA is not in D of mode {number}"
                    return refuted(says, {"state": texts(z[:n]), "input": texts(z[n:]), "mode": number})
                self._work["boxes"] += used
                if used > MOST_BOXES:
                    return unchecked(f"the error of mode {number} needs more than {MOST_BOXES} boxes")
        return proven(CLAIMS["error_set"])

    def theorem_2(self, claim: Claim) -> Finding:
        """R_k has the origin in its interior (h > 0), and everything that Theorem 2 asks of the loop is proven."""
        if "terminal_set" not in self.found:
            return unchecked("no terminal set is claimed")
        if min(b for _, b in self.sets[-1]) <= 0:
            return refuted("the origin is not inside the terminal set")
        missing = self._missing("inputs", "safe_set", "sequence", "terminal_set", "error_set")
        return missing or proven("the plant is ultimately bounded in R_k, uniformly in F_max")

    # -- what they need --

    def _missing(self, *names: str) -> Finding | None:
        """None if these claims are proven, else what is to be said of one that rests on them."""
        for claim in names:
            if self.found[claim].verdict != "proven":
                return unchecked(f"rests on {claim}, which is {self.found[claim].verdict}")
        return None

    @cached_property
    def _state_set(self) -> Polytope:
        X = polytope(self.certificate.state_set, "the state set", self._clock)
        if not X:
            raise Malformed("the state set is empty")
        return X

    @cached_property
    def _pieces(self) -> list[Piece]:
        return affine_pieces(self.certificate.network, self._state_set, self._clock)

    def _corners(self, k: int) -> Polytope:
        """R_k by its corners; {} if it is empty."""
        if k not in self._polytopes:
            self._polytopes[k] = polytope(self.sets[k], name(k), self._clock)
            self._clock.hold(sum(map(bytes_of, self._polytopes.values())))
        return self._polytopes[k]

    @cached_property
    def _disturbances(self) -> list[list[Row]]:
        """The corners of D of every mode, as points; a D without points would make every claim true."""
        found = []
        size = 0
        for number, mode in enumerate(self.certificate.modes, start=1):
            D = polytope(mode.disturbance, f"the disturbance set of mode {number}", self._clock)
            if not D:
                raise Malformed(f"the disturbance set of mode {number} is empty")
            size += 4 * bytes_of(D)
            self._clock.hold(size)
            found.append([point(d) for d in D])
        return found

    def _spread_of(self, number: int, r: int) -> Fraction:
        """max a d over D of a mode, for row r of the template."""
        if len(self._spread) > MOST_REMEMBERED:
            self._spread.clear()
        if (number, r) not in self._spread:
            self._spread[number, r] = max(dot(self._C[r], d) for d in self._disturbances[number])
        return self._spread[number, r]

    @cached_property
    def _cells_and_gap(self) -> tuple[list[Cell], Row | None]:
        """The cells of the loop over F_max, and a state of F_max that lies in none of them, or None.

        A cell is the part of a piece that lies in a region, with an input in U, be it an edge or a point. `winners`
        leaves out pieces of lower dimension than X: their neighbours hold their points, with the same Phi(x).
        """
        F = [half_space(a, b) for a, b in self.sets[0]]
        cells: list[Cell] = []
        gap, size = None, 0
        modes = self.certificate.modes
        maps = [over_one_unit(mode.rows, self._clock) for mode in modes]
        regions = []
        for mode in modes:
            self._clock()
            regions.append([half_space(a, b) for a, b in self.certificate.acting(mode)])
            size += bytes_of(regions[-1])
            self._clock.hold(size)
        for piece, forms, unit in self._pieces:
            self._clock()
            P = clip_all(piece, F, self._clock)
            if not P:
                continue
            z = [*axes(self.n, unit), *forms]  # (x, u)
            limits = [combined(region, z, unit, self._clock) for region in regions]
            for number, (rows, own) in enumerate(maps):
                part = clip_all(P, limits[number], self._clock)
                if part:
                    cells.append(Cell(part, number, [combine(row, z, unit) for row in rows], unit * own))
                    size += bytes_of(part, cells[-1].after)
                    self._clock.hold(size)
            bare = uncovered(P, limits, self._clock)
            gap = gap or (middle(bare) if bare else None)
        return cells, gap

    def _without_successor(self) -> Finding | None:
        """None if a mode acts on every state of F_max.

        With cases, Phi is in U, and then regions that cover F_max x U are enough.
        """
        if self.certificate.cases is None:
            _, gap = self._cells_and_gap
            if gap:
                return refuted(f"x = {show(gap)} lies in F_max and has no successor: {self._why_none(gap)}", state(gap))
            return None
        U = polytope(self.certificate.input_set, "the input set", self._clock)
        regions = [[half_space(a, b) for a, b in mode.region] for mode in self.certificate.modes]
        bare = uncovered(product(self._corners(0), U, self._clock), regions, self._clock)
        return unchecked(f"no region contains (x, u) = {show(middle(bare))}") if bare else self._missing("inputs")

    def _why_none(self, x: Row) -> str:
        """Why a state of X has no successor."""
        u = self.certificate.network(x, self._clock)
        if all(dot(a, u) <= b for a, b in self.certificate.input_set):
            return "no region contains it with its input"
        return f"its input u = {show(u)} lies outside U"

    def _beyond(self, k: int) -> Finding | None:
        """None if R_k lies in F_max and in X, where the cells are; an empty R_k does.

        Most often R_k has a row a x <= b' with b' <= b, which is enough: each of its rows holds for all of R_k.
        """
        own = dict(self.sets[k])
        for place, rows in (("F_max", self.sets[0]), ("X", self.certificate.state_set)):
            for a, b in rows:
                self._clock()
                if a in own and own[a] <= b:
                    continue
                form = half_space(a, b)
                for x in self._corners(k):
                    if at(form, x) > 0:
                        return refuted(f"x = {show(point(x))} lies in {name(k)}, but not in {place}", state(point(x)))
        return None

    def _support(self, P: Polytope, a: Row) -> Fraction:
        """max a x over a polytope."""
        row, unit = whole((Fraction(0), *a))
        best = Fraction(0)
        for number, x in enumerate(P):
            self._clock()
            value = Fraction(at(row, x), unit * x[0])
            best = max(best, value) if number else value
        return best

    # -- by cells --

    def _excess(self, r: int, b: Fraction, number: int) -> Form:
        """The form that is positive where a (A x + B Phi(x) + p + d) > b in a cell, for some d in D of its mode.

        With h the support function of D, a row r of the template, and s > 0 the number that makes s a whole, it is
        unit q s (a x+ + h(a) - b), x+ without d, for s (h(a) - b) = p / q.
        """
        cell = self._cells_and_gap[0][number]
        if len(self._along) > MOST_REMEMBERED:
            self._along.clear()
        if (number, r) not in self._along:
            row, scale = whole(self._C[r])
            self._along[number, r] = combine((0, *row), cell.after, 1), scale
        form, scale = self._along[number, r]
        rest = (self._spread_of(cell.mode, r) - b) * scale
        constant, *linear = (rest.denominator * entry for entry in form)
        return (constant + rest.numerator * cell.unit, *linear)

    def _parts(self, k: int) -> list[tuple[int, Polytope]]:
        """The cells that meet R_k, by their numbers, and the part of each in R_k.

        If R_k has the rows of the set before with offsets that are not larger, its parts are parts of those.
        """
        before, parts = self._clipped
        rows = self.sets[k]
        if before == k:
            return parts
        if before is None or any(b > old for (_, b), (_, old) in zip(rows, self.sets[before])):
            parts = [(number, cell.part) for number, cell in enumerate(self._cells_and_gap[0])]
        else:
            rows = [row for row, old in zip(rows, self.sets[before]) if row != old]
        forms = [half_space(a, b) for a, b in rows]
        clipped = ((number, clip_all(P, forms, self._clock)) for number, P in parts)
        found = []
        size = 0
        for number, P in clipped:
            if P:
                found.append((number, P))
                size += bytes_of(P)
                self._clock.hold(size)
        self._clipped = k, found
        return found

    def _leaves(self, k: int, j: int, claim: Claim) -> Finding | None:
        """None if the image of R_k lies in R_j, for R_k in F_max; else a step out. Nothing lies in an empty R_j."""
        cases = self.certificate.cases
        if cases is not None:
            found = self._by_cases(cases.images.get((k, j), ()), k, j)
            return found and (self._claimed_step(k, j, claim) or found)
        for number, P in self._parts(k):
            self._work["cells"] += 1
            for r, (a, b) in enumerate(self.sets[j]):
                self._clock()
                excess = self._excess(r, b, number)
                if any(at(excess, x) > 0 for x in P):
                    worst = max(P, key=lambda x: Fraction(at(excess, x), x[0]))
                    return self._step_out(k, j, (a, b), self._cells_and_gap[0][number].mode, point(worst))
        return None

    def _attains(self, S: Rows, r: int, level: Fraction) -> bool:
        """Whether a x+ >= level for row r of the template, some x in {x : S} and some d; S lies in R_k."""
        forms = [half_space(*row) for row in S]
        for number, P in self._parts(self.last):
            self._clock()
            self._work["cells"] += 1
            excess = self._excess(r, level, number)
            if any(at(excess, x) >= 0 for x in P):
                if any(at(excess, x) >= 0 for x in clip_all(P, forms, self._clock)):
                    return True
        return False

    # -- by cases --

    @cached_property
    def cases(self) -> CaseCheck:
        """What checks proofs by cases."""
        return CaseCheck(self.certificate, self._state_set, self._disturbances, self._clock)

    def _by_cases(self, trees: Sequence[Tree], k: int | None, j: int = 0) -> Finding | None:
        """None if trees of cases show that the image of R_k lies in R_j, or Phi(X) in U for k = None.

        There is a tree for every row of R_j, or of U, and in it one for every mode after the other.
        """
        where, rows = ("U", self.certificate.input_set) if k is None else (name(j), self.sets[j])
        image = "Phi(X)" if k is None else f"the image of {name(k)}"
        if len(trees) != len(rows):
            return unchecked(f"no cases are given that show {image} to lie in {where}")
        self.cases.enter(self.certificate.state_set if k is None else self.sets[k])
        modes = (None,) if k is None else range(len(self.certificate.modes))
        before = self.cases.checked
        for r, tree in enumerate(trees):
            nodes = iter(tree)
            shown = all(self.cases.holds(nodes, number, rows[r]) for number in modes) and next(nodes, None) is None
            self._work["cases"] += self.cases.checked - before
            before = self.cases.checked
            if not shown:
                return unchecked(f"the cases do not show that {image} satisfies row {r + 1} of {where}")
        return None

    def _attained(self, S: Rows, r: int, level: Fraction, number: int, x: Row) -> bool:
        """Whether x in {x : S} attains a x+ >= level in a mode, for row r of the template and some d."""
        d = (
            max(self._disturbances[number], key=lambda d: dot(self._C[r], d))
            if 0 <= number < len(self._disturbances)
            else ()
        )
        after = self._replay(self.last, number, x, d) if d and all(dot(a, x) <= b for a, b in S) else None
        return after is not None and dot(self._C[r], after) >= level

    def _claimed_state(self, claim: Claim) -> Finding | None:
        """The state of the claim's witness, if it lies in X and its input outside U."""
        try:
            (value,) = fields(claim["witness"], "the witness", ("state",))
            x = vector(value, "a witness", self.n, fraction)
        except Malformed:
            return None
        if any(dot(a, x) > b for a, b in self.certificate.state_set):
            return None
        u = self.certificate.network(x, self._clock)
        beyond = [row for row in self.certificate.input_set if dot(row[0], u) > row[1]]
        return self._input_outside(x, u, beyond[0]) if beyond else None

    def _input_outside(self, x: Row, u: Row, row: HalfSpace) -> Finding:
        """What is said of a state whose input lies beyond a row of U."""
        by = about(dot(row[0], u) - row[1])
        return refuted(f"x = {show(x)} gives u = {show(u)}, outside U by {by}", state(x))

    def _claimed_step(self, k: int, j: int, claim: Claim) -> Finding | None:
        """The step of the claim's witness, if it leads from R_k out of R_j."""
        witness, n = claim["witness"], self.n
        try:
            number, x, d, _ = fields(witness, "the witness", ("mode", "state", "disturbance", "after"))
            number, x, d = natural(number, "mode") - 1, *(vector(v, "a witness", n, fraction) for v in (x, d))
        except Malformed:
            return None
        if not 0 <= number < len(self.certificate.modes):
            return None
        after = self._replay(k, number, x, d)
        if after is None:
            return None
        beyond = [row for row in self.sets[j] if dot(row[0], after) > row[1]]
        if not beyond or any(dot(a, d) > b for a, b in self.certificate.modes[number].disturbance):
            return None
        return self._out(k, j, beyond[0], number, x, d, after)

    # -- witnesses --

    def _step_out(self, k: int, j: int, row: HalfSpace, number: int, x: Row) -> Finding:
        """A step from x in R_k beyond a row (a, b) of R_j; x is rounded to few digits if the step still leaves R_j."""
        a, b = row
        d = max(self._disturbances[number], key=lambda d: dot(a, d))
        for digits in range(1, SHORT + 1):
            self._clock()
            near = tuple(Fraction(round(entry * 10**digits), 10**digits) for entry in x)
            after = self._replay(k, number, near, d)
            if after is not None and dot(a, after) > b:
                x = near
                break
        after = self._replay(k, number, x, d)
        if after is None:
            return unchecked("a step out of the set was found, but it does not replay")
        return self._out(k, j, row, number, x, d, after)

    def _out(self, k: int, j: int, row: HalfSpace, number: int, x: Row, d: Row, after: Row) -> Finding:
        """What is said of a step that leads from R_k to beyond a row of R_j."""
        a, b = row
        step = {"state": texts(x), "mode": number + 1, "disturbance": texts(d), "after": texts(after)}
        leads = f"mode {number + 1} and d = {show(d)} lead to {show(after)}"
        outside = f"outside {name(j)} by {about(dot(a, after) - b)}"
        return refuted(f"x = {show(x)} lies in {name(k)}; {leads}, {outside}", step)

    def _replay(self, k: int, number: int, x: Row, d: Row) -> Row | None:
        """A x + B Phi(x) + p + d from the definition; None if x is not in R_k, or the mode does not act there."""
        if any(dot(a, x) > b for a, b in (*self.sets[k], *self.certificate.state_set)):
            return None
        mode, z = self.certificate.modes[number], (*x, *self.certificate.network(x, self._clock))
        if any(dot(a, z) > b for a, b in self.certificate.acting(mode)):
            return None
        return tuple(dot(row, (1, *z)) + e for row, e in zip(mode.rows, d))


# -- the error of an approximation --------------------------------------------------------------------


def bounding_box(rows: Rows) -> Box | None:
    """[(low, high)] by those rows (a, b) that limit one coordinate alone; None if a limit is missing."""
    low: list[Any] = [None] * len(rows[0][0])
    high: list[Any] = [None] * len(rows[0][0])
    for a, b in rows:
        used = [i for i, entry in enumerate(a) if entry]
        if len(used) == 1:
            i, end = used[0], b / a[used[0]]
            if a[i] > 0:
                high[i] = end if high[i] is None else min(high[i], end)
            else:
                low[i] = end if low[i] is None else max(low[i], end)
    return None if None in low or None in high else list(zip(low, high))


def error_along(a: Row, b: Fraction, mode: Mode, f: Sequence[Polynomial]) -> Polynomial:
    """a (f(z) - A x - B u - p) - b, z = (x, u), as a polynomial {powers: coefficient}."""
    size = len(mode.A) + len(mode.B[0])
    none, ones = (0,) * size, [tuple(int(i == j) for j in range(size)) for i in range(size)]
    found = {none: -b}
    for weight, component, A, B, p in zip(a, f, mode.A, mode.B, mode.p):
        affine = {none: p, **dict(zip(ones, (*A, *B)))}
        for sign, terms in ((1, component), (-1, affine)):
            for powers, coefficient in terms.items():
                found[powers] = found.get(powers, 0) + sign * weight * coefficient
    return found


def positive_somewhere(g: Polynomial, box: Box, rows: Rows, clock: Budget) -> tuple[Row | None, int]:
    """A point of {z in box : rows} in which a polynomial is positive, or None; and how many boxes that took.

    Nothing is known if that is more than `MOST_BOXES`. Every box is moved and scaled to [-1, 1]^N, see `largest`.
    A box is left alone if it is empty, if a row excludes all of it, or if its bound is at most 0, exactly.
    """
    boxes, used = [box], 0
    while boxes and used <= MOST_BOXES:
        clock()
        box, used = boxes.pop(), used + 1
        if any(low > high for low, high in box) or any(least(a, box) > b for a, b in rows):
            continue
        centre, radius = [(low + high) / 2 for low, high in box], [(high - low) / 2 for low, high in box]
        bound, likely, bent = largest(centred(g, centre, radius, clock), len(box))
        if bound <= 0:
            continue
        for t in ([Fraction(0)] * len(box), likely):
            z = tuple(c + r * entry for c, r, entry in zip(centre, radius, t))
            if value_at(g, z) > 0 and all(dot(a, z) <= b for a, b in rows):
                return z, used
        i = max(range(len(box)), key=lambda i: (bent[i], radius[i]))
        for half in ((box[i][0], centre[i]), (centre[i], box[i][1])):
            boxes.append([*box[:i], half, *box[i + 1 :]])
    return None, used


def least(a: Row, box: Box) -> Fraction:
    """min a z over a box."""
    return sum((entry * (low if entry > 0 else high) for entry, (low, high) in zip(a, box)), Fraction(0))


def value_at(g: Polynomial, z: Row) -> Fraction:
    """g(z)."""
    total = Fraction(0)
    for powers, term in g.items():
        for base, power in zip(z, powers):
            term *= base**power
        total += term
    return total


def centred(g: Polynomial, centre: Sequence[Fraction], radius: Sequence[Fraction], clock: Budget) -> Polynomial:
    """g(centre + radius t) as a polynomial of t, one coordinate after the other by the binomial theorem."""
    for i, (c, r) in enumerate(zip(centre, radius)):
        moved: Polynomial = {}
        for powers, factor in g.items():
            clock()
            top = powers[i]
            for k in range(top + 1):
                key = (*powers[:i], k, *powers[i + 1 :])
                moved[key] = moved.get(key, 0) + factor * c ** (top - k) * r**k
                factor = factor * (top - k) / (k + 1)
        g = moved
    return g


def largest(g: Polynomial, size: int) -> tuple[Fraction, list[Fraction], list[Fraction]]:
    """A bound of a polynomial over [-1, 1]^N, a point where it is likely to be large, what each coordinate bends it.

    The constant, plus the maximum of the linear and quadratic term of each coordinate, plus the size of all else: of
    a product of even powers, which lies in [0, 1], only a positive coefficient counts. b t + a t^2 is largest at
    t = -b / (2 a) where that is a maximum inside (a < 0 and |b| < -2 a), else at the end where b t = |b|.
    """
    bound = Fraction(0)
    linear = [Fraction(0)] * size
    square = [Fraction(0)] * size
    bent = [Fraction(0)] * size
    for powers, coefficient in g.items():
        used = [i for i in range(size) if powers[i]]
        if not used:
            bound += coefficient
        elif sum(powers) == 1:
            linear[used[0]] = coefficient
        elif len(used) == 1 and powers[used[0]] == 2:
            square[used[0]] = coefficient
        else:
            bound += max(coefficient, Fraction(0)) if all(power % 2 == 0 for power in powers) else abs(coefficient)
            for i in used:
                bent[i] += abs(coefficient)
    likely = []
    for i, (b, a) in enumerate(zip(linear, square)):
        peak = -b / (2 * a) if a < 0 and abs(b) < -2 * a else Fraction(1 if b >= 0 else -1)
        bound += peak * (b + a * peak)
        likely.append(peak)
        bent[i] += abs(a)
    return bound, likely, bent


# -- words --------------------------------------------------------------------------------------------


def texts(values: Iterable[Fraction]) -> list[str | None]:
    """Fractions as text, without rounding; None for one that would fill pages."""
    return [str(value) if max(abs(value.numerator), value.denominator) < 10**MOST_DIGITS else None for value in values]


def name(k: int) -> str:
    """What R_k is called."""
    return f"R_{k}" if k else "F_max"


def state(x: Row) -> Witness:
    """The witness that is a state alone."""
    return {"state": texts(x)}


def show(values: Iterable[Fraction]) -> str:
    """Fractions for a reader: as decimals where these are exact and short, else rounded, and marked so."""
    found = []
    for value in values:
        digits = next((k for k in range(SHORT + 1) if (10**k) % value.denominator == 0), None)
        short = digits is not None and abs(value) < 10**SHORT
        found.append(format(Decimal(value.numerator) / value.denominator, "f") if short else f"~{about(value)}")
    return f"({', '.join(found)})"


def about(value: Fraction, digits: int = 6) -> str:
    """A fraction rounded to so many digits."""
    try:
        found = float(value)
    except OverflowError:
        return "1e308 or more" if value > 0 else "-1e308 or less"
    if value and not found:
        return "less than 1e-323" if value > 0 else "above -1e-323"
    return f"{found:.{digits}g}"


def beside_one(alpha: Fraction) -> str:
    """alpha as 1 + what is beyond."""
    return "1" if alpha == 1 else f"1 {'+' if alpha > 1 else '-'} {about(abs(alpha - 1))}"


# -- the command --------------------------------------------------------------------------------------


def arguments(**options: Any) -> argparse.ArgumentParser:
    """The parser of the command."""
    parser = argparse.ArgumentParser(prog="verify", description=__doc__.split(":")[0], **options)
    parser.add_argument("file", metavar="FILE", help="a certificate")
    parser.add_argument("--network", metavar="NET.json", help="say whether the certificate speaks of this network")
    parser.add_argument("--ignore-digest", action="store_true", help="go on to the mathematics without comparing it")
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    parser.add_argument("--seconds", type=duration, default=SECONDS, help=f"stop after this time; default: {SECONDS}")
    return parser


def duration(text: str) -> float:
    """Seconds, from 0 on."""
    Budget(float(text))
    return float(text)


def run(options: argparse.Namespace) -> int:
    """Verify, print, and return the exit status: 0 if all is proven, 1 if not, 2 if the file is no certificate."""
    try:
        report = verify(options.file, options.network, options.ignore_digest, options.seconds)
    except (Malformed, OSError) as error:
        print(f"{options.file} is refused: {error}", file=sys.stderr)
        return 2
    print(json.dumps(report.to_dict(), indent=2) if options.json else report)
    return 0 if report.proven else 1


if __name__ == "__main__":
    sys.exit(run(arguments().parse_args()))
