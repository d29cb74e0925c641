"""Certificates: what was found about a loop, in one file that anybody can check without trusting this package.

`write` enlarges the sets of floating-point engines until their claims are exactly true, `verify` checks them by
`checker.py`, which shares no code with the engines. Every number is the float that it is, as in `rational`.
"""

import json
from dataclasses import dataclass
from fractions import Fraction
from math import prod

import numpy as np

from ..analysis.reach import support
from ..analysis.safe_set import SafeSet
from ..analysis.terminal_set import TerminalSet
from ..arithmetic.rational import above, binary, maximize
from ..checks import require_kind
from ..engines import exact
from ..engines.exact import Exact
from ..engines.registry import engine_for
from ..files import write_json
from ..sets.polytope import Polytope
from ..systems.loop import ClosedLoop
from ..systems.pwa import NonlinearSystem
from . import checker
from .checker import Report

LARGEST_INFLATION = 1e-6  # by which a set may grow to make its claim true, relative to the width of X along the row
REPAIRS = 30  # steps towards the smallest set that holds a claim, before it is overshot


@dataclass(frozen=True)
class Certificate:
    """What `make` made.

    Attributes
    ----------
    content : dict
        What is written to the file (format mireach-certificate/1, see `checker`).
    report : Report
        What the checker says of it.
    inflation : float
        The most by which an offset of a set was raised to make the claims exactly true.
    """

    content: dict
    report: Report
    inflation: float

    @property
    def alpha(self):
        """alpha of eq. StabCondFmin as a Fraction; None if nothing is claimed of it."""
        alpha = self.content["claims"].get("theorem_1", {}).get("alpha")
        return None if alpha is None else Fraction(alpha)

    def save(self, path):
        """Write the file."""
        write_json(path, self.content)


def write(path, loop, safe, terminal=None, *, plant=None, engine=None):
    """`make` a certificate and write it to a file."""
    made = make(loop, safe, terminal, plant=plant, engine=engine)
    made.save(path)
    return made


def make(loop, safe, terminal=None, *, plant=None, engine=None):
    """A certificate of what was found about a loop.

    Parameters
    ----------
    loop : ClosedLoop
    safe : SafeSet
        With a set; any engine may have found it.
    terminal : TerminalSet or None
        Of that safe set. None claims nothing beyond the safe set.
    plant : NonlinearSystem or None
        That the loop's system approximates, its f a polynomial: the error set and Theorem 2 are claimed as well.
    engine : Engine, str or None
        For more than two states: whose bounds the certificate carries; None is the MILP. For two states the bounds are
        exact.

    Returns
    -------
    Certificate

    Raises
    ------
    ValueError
        If there is no safe set, the terminal set does not start from it or has no steps, or f is not a polynomial.

    Notes
    -----
    In the plane, R_1 of each set is bounded anew in rational arithmetic and rounded up to floats. Where it exceeds the
    set that should hold it, by the rounding of the engine that found that set, the set is enlarged: the iteration
    h <- max(h, h of R_1) leads to the smallest set with these rows that holds the claim. Where more than
    `LARGEST_INFLATION` would be needed the set is left as it is. Nothing depends on the unit of the states.

    What the checker does not confirm is "not proven" in the file, with the checker's reason, and where it has one
    with a witness: a state of fractions without a successor, or a step that leads out of the set. For more than two
    states the bounds of a solver are "bounded" at best.
    """
    require_kind(loop, ClosedLoop, "loop")
    require_kind(safe, SafeSet, "safe")
    if safe.set is None:
        raise ValueError(f"there is no safe set to certify: {safe.reason}")
    history = [safe.set]
    if terminal is not None:
        require_kind(terminal, TerminalSet, "terminal")
        history = terminal.history
        if history[0] is not safe.set:
            raise ValueError("terminal does not start from safe; give the terminal set of this safe set")
        if len(history) < 2:
            raise ValueError("terminal has no steps, only the safe set; leave it out, or give one with steps >= 1")
    planar = loop.system.state_size == 2
    engine = Exact() if planar else engine_for(loop, engine)
    C = _template(loop, history)
    wanted = [_offsets(loop, R, C) for R in history]
    sets, bounds = _repaired(loop, C, wanted, engine)
    content = {
        "format": checker.FORMAT,
        "system": _system(loop.system),
        "network": loop.network.to_dict(),
        "template": C.tolist(),
        "sets": [h.tolist() for h in sets],
        "claims": _claims(C, sets, terminal, plant, planar),
    }
    if plant is not None:
        content["plant"] = {"f": _polynomials(plant, loop, safe)}
    if not planar:
        content["bounds"] = {"solver": engine.software, "offsets": [h.tolist() for h in bounds]}
    report = _settled(content)
    content["digest"] = checker.digest(checker.parse(json.dumps(content)))
    return Certificate(content, report, max(float((h - given).max()) for h, given in zip(sets, wanted)))


# -- sets ---------------------------------------------------------------------------------------------


def _template(loop, history):
    """All rows that are needed: those of X, of F_max and of the sets that follow."""
    rows = [*history[-1].H, *history[0].H, *loop.system.state_set.H]
    return np.array(list({(row + 0.0).tobytes(): row + 0.0 for row in rows}.values()))


def _offsets(loop, R, C):
    """Offsets of R & X along C: the given ones of their rows, elsewhere the support function, rounded up."""
    H, h = np.vstack([R.H, loop.system.state_set.H]) + 0.0, [*R.h, *loop.system.state_set.h]
    given = {}
    for row, offset in zip(H, h):
        given[row.tobytes()] = min(offset, given.get(row.tobytes(), np.inf))
    rows = binary(H), binary(h)
    return np.array([given[row.tobytes()] if row.tobytes() in given else _support(R, rows, row) for row in C])


def _support(R, rows, c):
    """The smallest float that is not below max {c x : rows}; that of R in floats if no point satisfies the rows."""
    value = maximize(*rows, binary(c)).value
    return R.support(c[None])[0] if value == -np.inf else above(value)


def _repaired(loop, C, wanted, engine):
    """Offsets, at least those that are wanted, with which R_1 of each set lies in the next; and h of R_1 of each.

    Where that needs more than `LARGEST_INFLATION`, offsets stay what they were.
    """
    X = loop.system.state_set
    rows = binary(X.H), binary(X.h)
    most = LARGEST_INFLATION * np.array([_support(X, rows, c) + _support(X, rows, -c) for c in C])
    h, image = _invariant(loop, C, wanted[0], engine, most)
    sets, images = [h], [image]
    for given in wanted[1:]:
        raised = np.maximum(given, images[-1])
        h = np.minimum(raised if (raised - given <= most).all() else given, sets[-1])
        sets.append(h)
        images.append(_image(loop, C, h, engine))
    return sets, images


def _invariant(loop, C, wanted, engine, most):
    """The smallest offsets above `wanted` with R_1({C x <= h}) in {C x <= h}, and h of R_1 then.

    `wanted` again if an offset would have to be raised by more than `most`.
    """
    h = wanted
    for _ in range(REPAIRS):
        image = _image(loop, C, h, engine)
        if (image <= h).all():
            return h, image
        h = np.maximum(h, image)
        if (h - wanted > most).any():
            return wanted, _image(loop, C, wanted, engine)
    step = h - wanted  # the iteration creeps: a little more is tried
    while (step <= most).all():
        h, step = wanted + step, 2 * step
        image = _image(loop, C, h, engine)
        if (image <= h).all():
            return h, image
    return wanted, _image(loop, C, wanted, engine)


def _image(loop, C, h, engine):
    """h of R_1({x : C x <= h}) along C, rounded up."""
    return support(loop, Polytope(C, h), C, engine=engine).bound


# -- content ------------------------------------------------------------------------------------------


def _system(system):
    modes = [
        {
            **{name: getattr(mode, name).tolist() for name in "ABp"},
            "region": mode.region.to_dict(),
            "disturbance": mode.disturbance.to_dict(),
        }
        for mode in system.modes
    ]
    return {"modes": modes, "state_set": system.state_set.to_dict(), "input_set": system.input_set.to_dict()}


def _claims(C, sets, terminal, plant, planar):
    """What is claimed, before the checker has been asked."""
    claims, verdict = {"inputs": {}, "safe_set": {}}, "proven" if planar else "bounded"
    if terminal is not None:
        c = terminal.centre.tolist()
        alpha = exact.growth(C, *sets[-2:], c) if planar else _growth_of_offsets(C, *sets[-2:], c)
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
    claims = {name: {"verdict": verdict, **claim} for name, claim in claims.items()}
    if plant is not None:
        claims["error_set"] = {"verdict": "proven"}
        claims["theorem_2"] = {"verdict": verdict}
    return claims


def _growth_of_offsets(C, before, h, centre):
    """As `exact.growth`, from the offsets of both sets: a lower bound where R has rows that do not touch it."""
    c = [Fraction(entry) for entry in centre]
    shares = []
    for row, *limits in zip(C.tolist(), before.tolist(), h.tolist()):
        middle = sum(Fraction(entry) * part for entry, part in zip(row, c))
        outer, inner = (Fraction(limit) - middle for limit in limits)
        if inner <= 0:
            return None
        shares.append(outer / inner)
    return min(shares)


def _settled(content):
    """Ask the checker; what it does not confirm becomes "not proven", with its reason. Returns its last Report."""
    report = checker.check(checker.parse(json.dumps(content)))
    claims, found = content["claims"], {one.claim: one for one in report.results}
    refuted = {name for name, one in found.items() if one.verdict == "refuted"}
    if "criterion" in refuted and "terminal_set" not in refuted:  # it is decided exactly, one way or the other
        claims["criterion"]["holds"] = not claims["criterion"]["holds"]
        return _settled(content)
    for name, result in found.items():
        rests_on_error = name == "theorem_2" and found["error_set"].verdict != "proven"
        if name in refuted or rests_on_error or (result.verdict, claims[name]["verdict"]) == ("not checked", "proven"):
            claims[name] |= {"verdict": "not proven", "reason": result.reason}
            if result.witness is not None:
                claims[name]["witness"] = result.witness
    return report


def _polynomials(plant, loop, safe):
    """f of a plant as lists of terms.

    Raises
    ------
    ValueError
        If f is not a polynomial, or F_max and U are not within the plant's limits.
    """
    require_kind(plant, NonlinearSystem, "plant")
    if not (safe.set.is_subset(plant.state_set) and loop.system.input_set.is_subset(plant.input_set)):
        raise ValueError("F_max or U leaves the limits of the plant, which its f is not known beyond")
    n, m = loop.system.state_size, loop.system.input_size
    z = [_Polynomial({tuple(int(i == j) for j in range(n + m)): Fraction(1)}) for i in range(n + m)]
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


def _written(value):
    """A fraction as the float that it is, or as text p/q if no float is."""
    return float(value) if _is_float(value) else str(value)


def _is_float(value):
    try:
        return Fraction(float(value)) == value
    except OverflowError:
        return False


class _Polynomial:
    """A polynomial {powers: coefficient} in fractions; numbers that meet it are the floats that they are."""

    __array_ufunc__ = None  # numpy's numbers leave the arithmetic to this class, its functions raise TypeError

    def __init__(self, terms):
        self.terms = terms

    def _of(self, other):
        if isinstance(other, _Polynomial):
            return other
        size = len(next(iter(self.terms)))
        return _Polynomial({(0,) * size: Fraction(float(other))})

    def __add__(self, other):
        found = dict(self.terms)
        for powers, value in self._of(other).terms.items():
            found[powers] = found.get(powers, 0) + value
        return _Polynomial(found)

    def __mul__(self, other):
        found = {}
        for powers, value in self.terms.items():
            for others, factor in self._of(other).terms.items():
                both = tuple(map(sum, zip(powers, others)))
                found[both] = found.get(both, 0) + value * factor
        return _Polynomial(found)

    def __pow__(self, exponent):
        if exponent != int(exponent) or exponent < 0:
            raise TypeError(f"the power {exponent} is no whole number from 0 on")
        return prod([self] * int(exponent), start=self._of(1))

    def __neg__(self):
        return self * -1

    def __sub__(self, other):
        return self + -self._of(other)

    def __rsub__(self, other):
        return -self + other

    def __truediv__(self, other):
        return _Polynomial({powers: value / Fraction(float(other)) for powers, value in self.terms.items()})

    __radd__, __rmul__ = __add__, __mul__
