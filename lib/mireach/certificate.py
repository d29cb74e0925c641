"""Certificates: what was found about a loop, in one file that anybody can check without trusting this package.

`write` makes the sets of floating-point engines exactly true, `verify` checks them by `checker.py`, which shares no
code with the engines.
"""

import json
from dataclasses import dataclass
from fractions import Fraction
from math import prod

import highspy
import numpy as np

from . import checker
from .checker import Report, verify
from .checks import require_kind
from .engines import exact
from .files import write_json
from .invariance import SafeSet, TerminalSet
from .loop import ClosedLoop
from .polytope import Polytope
from .reach import support
from .system import NonlinearSystem

__all__ = ["Certificate", "Report", "make", "verify", "write"]

LARGEST_INFLATION = 1e-6  # by which a set may grow to make its claim true, relative to 1 + its offsets
REPAIRS = 30  # steps towards the smallest set that holds a claim, before it is overshot
LOOSE = 1e-9  # room of rows that only restate a set, in units of C x


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


def write(path, loop, safe, terminal=None, *, plant=None, engine="milp"):
    """`make` a certificate and write it to a file."""
    made = make(loop, safe, terminal, plant=plant, engine=engine)
    made.save(path)
    return made


def make(loop, safe, terminal=None, *, plant=None, engine="milp"):
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
    engine : str
        For more than two states: whose bounds the certificate carries.

    Returns
    -------
    Certificate

    Raises
    ------
    ValueError
        If there is no safe set, the terminal set does not start from it, or f is not a polynomial.

    Notes
    -----
    Data of the plant are read as the decimals that they are, all else as floats. In the plane, R_1 of each set is
    bounded anew in rational arithmetic and rounded up to floats. Where it passes the set that should hold it, by the
    rounding of the engine that found that set, the set is enlarged: h <- max(h, h of R_1), again and again, leads to
    the smallest set with these rows that holds the claim. Where more than `LARGEST_INFLATION` would be needed the
    set is left as it is, and the certificate says "not proven", with a step of fractions that leads out of it.
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
    planar = loop.system.state_size == 2
    engine = "exact" if planar else engine
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
        solver = f"HiGHS {highspy.Highs().version()}" if engine == "milp" else engine
        content["bounds"] = {"solver": solver, "offsets": [h.tolist() for h in bounds]}
    report = _settled(content)
    content["digest"] = checker.digest(checker.parse(json.dumps(content)))
    return Certificate(content, report, max(float((h - given).max()) for h, given in zip(sets, wanted)))


# -- sets ---------------------------------------------------------------------------------------------


def _template(loop, history):
    """All rows that are needed: those of X, of F_max and of the sets that follow."""
    rows = [*history[-1].H, *history[0].H, *loop.system.state_set.H]
    return np.array(list({(row + 0.0).tobytes(): row + 0.0 for row in rows}.values()))


def _offsets(loop, R, C):
    """Offsets of a set along C: its own, those of X, and room along rows that only restate it."""
    X, known = loop.system.state_set, {}
    for row, offset in zip(np.vstack([R.H, X.H]) + 0.0, [*R.h, *map(_floor, X.h)]):
        known[row.tobytes()] = min(offset, known.get(row.tobytes(), np.inf))
    loose = R.support(C) + LOOSE
    return np.array([known.get(row.tobytes(), room) for row, room in zip(C, loose)])


def _floor(value):
    """The largest float that is not above the decimal by which a float is written."""
    return float(value if Fraction(value) <= Fraction(repr(float(value))) else np.nextafter(value, -np.inf))


def _repaired(loop, C, wanted, engine):
    """Offsets, at least those that are wanted, with which R_1 of each set lies in the next; and h of R_1 of each.

    Where that needs more than `LARGEST_INFLATION`, offsets stay what they were.
    """
    h, image = _invariant(loop, C, wanted[0], engine)
    sets, images = [h], [image]
    for given in wanted[1:]:
        raised = np.maximum(given, images[-1])
        h = np.minimum(raised if _is_small(raised - given, given) else given, sets[-1])
        sets.append(h)
        images.append(_image(loop, C, h, engine))
    return sets, images


def _invariant(loop, C, wanted, engine):
    """The smallest offsets from `wanted` on with R_1({C x <= h}) in {C x <= h}, and h of R_1 then."""
    h = wanted
    for _ in range(REPAIRS):
        image = _image(loop, C, h, engine)
        if (image <= h).all():
            return h, image
        h = np.maximum(h, image)
        if not _is_small(h - wanted, wanted):
            return wanted, _image(loop, C, wanted, engine)
    step = h - wanted  # it creeps: a little more is tried
    while _is_small(step, wanted):
        h, step = wanted + step, 2 * step
        image = _image(loop, C, h, engine)
        if (image <= h).all():
            return h, image
    return wanted, _image(loop, C, wanted, engine)


def _is_small(inflation, h):
    return (inflation <= LARGEST_INFLATION * (1 + np.abs(h))).all()


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
    c = [Fraction(repr(entry)) for entry in centre]
    shares = []
    for row, *limits in zip(C.tolist(), before.tolist(), h.tolist()):
        middle = sum(Fraction(entry) * part for entry, part in zip(row, c))
        outer, inner = (Fraction(limit) - middle for limit in limits)
        if inner <= 0:
            return None
        shares.append(outer / inner)
    return min(shares)


def _settled(content):
    """Ask the checker; a claim that it refutes becomes "not proven", with the witness. Returns its last Report."""
    report = checker.check(checker.parse(json.dumps(content)))
    claims, refuted = content["claims"], {one.claim: one for one in report.results if one.verdict == "refuted"}
    if "criterion" in refuted and "terminal_set" not in refuted:  # it is decided exactly, one way or the other
        claims["criterion"]["holds"] = not claims["criterion"]["holds"]
        return _settled(content)
    for name, result in refuted.items():
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
        [{"coefficient": float(value), "powers": list(powers)} for powers, value in part.terms.items() if value]
        for part in components
    ]


class _Polynomial:
    """A polynomial {powers: coefficient} in fractions; floats that meet it count as the decimals that are written."""

    __array_ufunc__ = None  # numpy's numbers leave the arithmetic to this class, its functions raise TypeError

    def __init__(self, terms):
        self.terms = terms

    def _of(self, other):
        if isinstance(other, _Polynomial):
            return other
        size = len(next(iter(self.terms)))
        return _Polynomial({(0,) * size: Fraction(repr(float(other)))})

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
        return self * (1 / Fraction(repr(float(other))))

    __radd__, __rmul__ = __add__, __mul__
