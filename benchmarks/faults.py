"""Faults injected by hand, one at a time, each of which the tests of its room must catch.

    python benchmarks/faults.py [ROOM ...]

A fault is one replacement in a copy of lib/. The tests run against that copy, and one line per fault says whether a
test failed, and which. The tests are first run without any fault: those that fail then catch none. The exit status is
1 if a fault is not caught.
"""

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 600  # for the tests of one fault
FAILED = re.compile(r"^FAILED (.+?)(?: - .*)?$", re.MULTILINE)
TESTS = {  # the pytest arguments that must catch the faults of a room
    "cells": "tests/engines/test_cells.py -k 'both_values or network or only_rounding or error_of or acts or line'",
    "kernels": "tests/sets/test_kernels.py tests/engines/test_cells.py -k 'kernels or both_values or ties or point'",
    "space": "tests/engines/test_cells.py tests/test_fuzz.py -k 'any_dimension or face_or or needles_in_space'",
    "exact": "tests/engines/test_exact.py tests/engines/test_exact_cells.py tests/engines/test_exact_plane.py",
    "exact polytopes": "tests/sets/test_exact_polytopes.py",
    "steps": "tests/engines/test_steps.py",
    "inputs": "tests/engines/test_inputs.py",
    "comparison": "tests/analysis/test_comparison.py",
    "invariance": "tests/analysis/test_invariance.py",
    "own engines": "tests/analysis/test_own_engines.py",
    "units": "tests/engines/test_units.py -k 'not safe_sets'",
    "system": "tests/systems/test_partition.py",
    "rational": "tests/arithmetic/test_rational.py",
    "polytope": "tests/sets/test_convex_set.py",
    "lp": "tests/solvers",
    "milp": "tests/engines/test_milp.py tests/engines/test_bounds.py -k 'boxes or cutoff'",
    "approximation": "tests/approximation/test_error_bound.py",
    "checker": "tests/certificate/test_checker.py -k 'every_verdict or theorem_1 or error'",
    "proofs": "tests/certificate/test_checker.py -k '(polytope or sets_may or products or no_region or pieces or a_case"
    " or proof_by or of_a_mode or neurons or a_bound or a_tree or that_attain or later_set or last_set or a_step or "
    "regions_h) and not mutations and not take_too_long'",
    "maximal_set": "tests/analysis/test_maximal_set.py -k 'slack or hair'",
}


@dataclass(frozen=True)
class Fault:
    """One replacement in a file of lib/mireach; `old` occurs in it exactly once."""

    room: str
    file: str
    name: str
    old: str
    new: str


FAULTS = (
    # -- the plane in floats
    Fault(
        "cells",
        "engines/cells.py",
        "the bound is the attained value, without its error",
        "np.ceil(top / rows.unit + 0.05) * rows.unit, witness",
        "np.ceil(value / rows.unit) * rows.unit, witness",
    ),
    Fault(
        "cells",
        "engines/cells.py",
        "the error of u is not used for rows of u",
        'slack = np.einsum("nm,nm->n", np.abs(H[:, 2:]), found.error) + 4 * CORNER * rounding',
        "slack = 4 * CORNER * rounding",
    ),
    Fault(
        "cells",
        "engines/cells.py",
        "modes whose cells are only an edge along an axis, or a point, are dropped",
        "modes = np.flatnonzero([len(corners) for corners in found])",
        "modes = np.flatnonzero([len(corners) and np.ptp(corners, axis=0).min() > 0 for corners in found])",
    ),
    Fault(
        "kernels",
        "sets/kernels.py",
        "_doubt ignores the gaps between pieces",
        "most = max(most, neuron.error[base + c] + ahead + (abs(a0) + abs(a1)) * slits)",
        "most = max(most, neuron.error[base + c] + ahead)",
    ),
    Fault(
        "kernels",
        "sets/kernels.py",
        "sets that touch up to rounding count as disjoint",
        "            if excess[t] <= line.touch:",
        "            if excess[t] <= slack:",
    ),
    Fault(
        "kernels",
        "sets/kernels.py",
        "_cut loses new corners above or beside an old one",
        "if polygon[end, 0] != x or polygon[end, 1] != y:",
        "if polygon[end, 0] != x and polygon[end, 1] != y:",
    ),
    Fault(
        "kernels",
        "sets/kernels.py",
        "dual_bounds does not count its rounding",
        "            value = value + (rest0 + rest1) * extent * (1 + EXPRESSION)\n"
        "            bound[k] = np.ldexp(value + EXPRESSION * abs(value) + SMALL_PRODUCTS, most)",
        "            bound[k] = np.ldexp(value * (1 - EXPRESSION), most)",
    ),
    # -- the plane in rational arithmetic, and single steps
    Fault(
        "exact",
        "engines/exact_plane.py",
        "_clip drops corners on the line",
        "        if value <= 0:\n            kept.append(x)",
        "        if value < 0:\n            kept.append(x)",
    ),
    Fault(
        "exact",
        "engines/exact_plane.py",
        "first_escape skips the fourth corner of D",
        "for d in spread[cell.mode]}",
        "for d in spread[cell.mode][:3]}",
    ),
    Fault(
        "exact",
        "engines/exact.py",
        "support_steps skips the first corner of D",
        "pushed = [max(corners, key=lambda d: dot(v, d)) for corners in spread]",
        "pushed = [max(corners[-3:], key=lambda d: dot(v, d)) for corners in spread]",
    ),
    Fault(
        "exact",
        "engines/exact_cells.py",
        "a piece on which two channels tie is assigned to neither of them",
        "if values[j] in values[:j]:",
        "if values.count(values[j]) > 1:",
    ),
    Fault(
        "exact",
        "engines/exact_cells.py",
        "a piece that rows of u cut down to a face is dropped",
        "        if not part.is_empty:\n            yield ExactCell",
        "        if part.dimension == domain.dimension:\n            yield ExactCell",
    ),
    Fault(
        "exact",
        "engines/exact_cells.py",
        "a mode that acts on a face of X alone has no cell",
        "        if part.dimension < domain.dimension:",
        "        if part.dimension < pieces[i].part.dimension:",
    ),
    Fault(
        "exact polytopes",
        "sets/exact_polytopes.py",
        "opposite vertices of a quadrilateral share an edge",
        "if found > 2:",
        "if found > 4:",
    ),
    Fault(
        "exact polytopes",
        "sets/exact_polytopes.py",
        "a vertex on a new row does not count as tight there",
        "tight.append(self.tight[i] if value < 0 else self.tight[i] | bit)",
        "tight.append(self.tight[i])",
    ),
    Fault(
        "exact polytopes",
        "sets/exact_polytopes.py",
        "a face has the dimension of the whole",
        "self.dimension if inside else dimension(points)",
        "self.dimension",
    ),
    Fault(
        "steps",
        "engines/steps.py",
        "_piece leaves out the rows of the region",
        "return rows + composed_rows(list(zip(*acting.region.exact)), xu), composed(",
        "return rows, composed(",
    ),
    Fault(
        "steps",
        "engines/steps.py",
        "the winner is not compared with the channels before it",
        "                if i != j:",
        "                if i > j:",
    ),
    Fault(
        "steps",
        "engines/steps.py",
        "the disturbance is the opposite corner of D",
        "pushed = maximize(of_d, limits, direction)",
        "pushed = maximize(of_d, limits, binary(-np.asarray(v)))",
    ),
    Fault(
        "steps",
        "engines/steps.py",
        "attained does not check whether the disturbance lies in D",
        "loop.system.state_set.contains(x) and mode.disturbance.contains(d)):",
        "loop.system.state_set.contains(x)):",
    ),
    # -- verdicts
    Fault(
        "inputs",
        "engines/inputs.py",
        "interval arithmetic does not count its rounding",
        "rounding = np.where(simple, 0.0, 2.0**-52 * (terms + 2) * size)",
        "rounding = 0.0 * np.where(simple, 0.0, size)",
    ),
    Fault(
        "inputs",
        "engines/inputs.py",
        "exact arithmetic checks only the first row of U",
        "in zip(found, binary(U.h)):",
        "in zip(found[:1], binary(U.h)):",
    ),
    Fault(
        "comparison",
        "analysis/comparison.py",
        "rows hold by the attained value",
        "holds = ~asked if believed else ~asked | (bound <= allowed)",
        "holds = ~asked if believed else ~asked | (found.value <= allowed)",
    ),
    Fault(
        "comparison",
        "analysis/comparison.py",
        "for two states, a solver's bound is accepted",
        "believed = settled == SOLVER",
        "believed = settled == SOLVER and loop.system.state_size > 2",
    ),
    Fault(
        "comparison",
        "analysis/comparison.py",
        "ten times the resolution is allowed",
        "(found.resolution if tol is None else 0.0)",
        "(10 * found.resolution if tol is None else 0.0)",
    ),
    Fault(
        "own engines",
        "analysis/comparison.py",
        "a solver's word counts without a resolution",
        "elif engine.resolution:",
        "else:",
    ),
    Fault(
        "invariance",
        "analysis/safe_set.py",
        "safe_set takes attained values for the next set",
        "image, smaller = found.image, np.minimum(found.bound, h)",
        "image, smaller = found.image, np.minimum(found.image.value, h)",
    ),
    Fault(
        "own engines",
        "analysis/safe_set.py",
        "loose bounds refute",
        "if not is_attained(found.loop, found.image, found.V, h):",
        "if False:",
    ),
    Fault(
        "invariance",
        "analysis/terminal_set.py",
        "terminal_set starts from the rounded support of F_max",
        "h, history = F.bound(V), [F]",
        "h, history = F.support(V), [F]",
    ),
    Fault(
        "invariance",
        "analysis/terminal_set.py",
        "terminal_set reports one step too few",
        "    k = len(alphas)\n",
        "    k = len(alphas) - 1\n",
    ),
    Fault(
        "invariance",
        "analysis/contraction.py",
        "alpha is rounded up",
        "return below(min(shares))",
        "return above(min(shares))",
    ),
    Fault(
        "invariance",
        "analysis/boundedness.py",
        "ultimately_bounded accepts F_max as RPI because of attained values",
        "bool(steps) and steps[0].holds.all()",
        "bool(steps) and (steps[0].found.value <= steps[0].limit).all()",
    ),
    Fault(
        "invariance",
        "analysis/boundedness.py",
        "ultimately_bounded checks the sequence with attained values",
        "and all(step.holds.all() for step in steps)",
        "and all((step.found.value <= step.limit).all() for step in steps)",
    ),
    Fault(
        "invariance",
        "analysis/boundedness.py",
        "ultimately_bounded accepts sets that are not nested",
        "\n        and all(after.is_subset(before) for before, after in pairwise(sets))",
        "",
    ),
    # -- units
    Fault("units", "engines/units.py", "p keeps the units of the user", "p=times(mode.p, 1 / s)", "p=mode.p"),
    Fault("units", "engines/units.py", "D keeps the units of the user", "{D: D.in_units(s) for", "{D: D for"),
    Fault(
        "units",
        "engines/units.py",
        "the inputs of a witness keep the units of the loop",
        "Witness(states, found.inputs * self.inputs,",
        "Witness(states, found.inputs,",
    ),
    Fault(
        "units",
        "engines/units.py",
        "the disturbances of a witness keep the units of the loop",
        "found.disturbances * self.state",
        "found.disturbances",
    ),
    Fault(
        "units",
        "arithmetic/scaling.py",
        "power_of_two doubles a number that is a power of two",
        "exponent - (np.abs(mantissa) == 0.5)",
        "exponent",
    ),
    # -- systems and sets
    Fault(
        "system",
        "systems/partition.py",
        "a point on a row counts as beyond it",
        "-b, strict=True)",
        "-b, strict=False)",
    ),
    Fault(
        "system",
        "systems/pwa.py",
        "gaps are searched for along x only",
        "gap = uncovered_point(domain, scaled)",
        "gap = uncovered_point(domain, [Polytope(P.H * (np.arange(P.dimension) < n), P.h) for P in scaled])",
    ),
    Fault("rational", "arithmetic/rational.py", "below rounds up", "return -above(-value)", "return above(value)"),
    Fault(
        "rational",
        "arithmetic/rational.py",
        "above increases a number that is already a float",
        "binary(near) >= value)",
        "binary(near) > value)",
    ),
    Fault(
        "rational",
        "arithmetic/rational.py",
        "artificial variables that stay positive after phase 1 are ignored",
        "if any(row[-1] for row, j in zip(self.rows, self.basis) if j >= self.l):",
        "if False:",
    ),
    Fault(
        "polytope",
        "sets/convex_set.py",
        "bound is the nearest float, for certain vertices",
        "return np.minimum(bound, self.offsets(V))",
        "return np.minimum(self.support(V), self.offsets(V))",
    ),
    Fault(
        "polytope",
        "sets/convex_set.py",
        "bound is the nearest float, for exact optima",
        "return self._rounded(V, above)",
        "return self._rounded(V, nearest)",
    ),
    Fault(
        "polytope",
        "sets/convex_set.py",
        "for a row that occurs twice, the last offset is used",
        "own[row.tobytes()] = min(offset, own.get(row.tobytes(), np.inf))",
        "own[row.tobytes()] = offset",
    ),
    Fault(
        "polytope",
        "sets/convex_set.py",
        "a box is highest at its lower ends",
        "middle if not entry else high if entry > 0 else low",
        "middle if not entry else low if entry > 0 else high",
    ),
    Fault(
        "polytope",
        "solvers/linear_program.py",
        "HiGHS is given limits that it holds for infinite",
        "LARGEST = 1e19",
        "LARGEST = 1e30",
    ),
    # -- cells in space
    Fault(
        "space",
        "sets/cell_kernels.py",
        "a bound far above the value at a vertex is used",
        "if abs(bound - _with_error(on, j, k, attained)) > gap:",
        "if bound < attained - 1e9:",
    ),
    Fault(
        "space",
        "engines/space.py",
        "images that leave X count as a whole",
        "inside = np.all(tops[:, : len(X.h)] <= X.h, axis=1)",
        "inside = np.ones(len(part), bool)",
    ),
    Fault(
        "space",
        "engines/space.py",
        "exact optima of cells are used without D and the constant term",
        "bound = above(best.value + offset + dot(",
        "bound = above(best.value + dot(",
    ),
    # -- linear programs and the MILP
    Fault(
        "lp",
        "solvers/linear_program.py",
        "a ray is accepted without a check of its bound",
        "return bool(known) and self._rows().is_proven_empty(np.array(ray), lower, upper)",
        "return bool(known)",
    ),
    Fault(
        "lp",
        "solvers/weak_duality.py",
        "weak duality does not count its rounding",
        "total = float(rows.sum() + columns.sum() + rounding)",
        "total = float(rows.sum() + columns.sum())",
    ),
    Fault(
        "milp",
        "engines/milp/engine.py",
        "the bounds of boxes that are skipped are forgotten",
        "answer.bound = max(answer.bound, upper[index])\n                break\n            if self.problem.is_over",
        "break\n            if self.problem.is_over",
    ),
    Fault(
        "milp",
        "engines/milp/engine.py",
        "the bounds of boxes that simulation settles are forgotten",
        "np.maximum(self.settled, np.where(still, -np.inf, upper).max(axis=0, initial=-np.inf))",
        "np.maximum(self.settled, -np.inf)",
    ),
    # -- the plant, the checker, sets in the plane
    Fault(
        "approximation",
        "approximation/error_bound.py",
        "_shift rounds to the nearest float",
        "upper_float(ball(offset) - sum(ball(c) * s for c, s in zip(v, step)))",
        "float(offset - sum(float(c) * (b - a) for c, a, b in zip(v, before, after)))",
    ),
    Fault(
        "checker",
        "certificate/checker.py",
        "a loop is stable for alpha = 1",
        "stable = alpha is not None and alpha > 1",
        "stable = alpha is not None and alpha >= 1",
    ),
    Fault(
        "checker",
        "certificate/checker.py",
        "an error up to 1e-9 outside D is accepted",
        "        if bound <= 0:\n            continue",
        "        if bound <= Fraction(1, 10**9):\n            continue",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "clip forgets which corners touch the boundary",
        "    for x in touching:\n        kept[x] |= bit\n",
        "",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "clip uses a bit again that is set in a corner on the boundary",
        "        used |= mask\n        if value < 0:\n",
        "        if value < 0:\n            used |= mask\n",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "any two corners with enough limits in common share an edge",
        "if each & common == common]) == 2:",
        "if each & common == common]) >= 2:",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "two corners share an edge if one more limit is tight than there has to be",
        "if common.bit_count() >= least:",
        "if common.bit_count() > least:",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "the simplex around a set is too small",
        "r = factorial(n) * most ** (n - 1) * max",
        "r = most * max",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "limits of P and Q are the same limits in a product",
        "mask | other << shift",
        "mask | other",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "a form wins although an earlier one is larger",
        "for other, height in zip(channels, heights):",
        "for other, height in zip(channels[j:], heights[j:]):",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "of what a region leaves only the first part is kept",
        "bare = [part for part in following if part]",
        "bare = [part for part in following if part][:1]",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "parts of a set are taken for those of one that is larger along a row",
        "if before is None or any(b > old",
        "if before is None or all(b > old",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "a set lies in X and F_max if it has the same rows",
        "if a in own and own[a] <= b:",
        "if a in own:",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "a form is highest at the lower ends of a box",
        "sum(a * (high if a > 0 else low)",
        "sum(a * (low if a > 0 else high)",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "a box is rounded inward",
        "(floor(low * grid), ceil(high * grid))",
        "(ceil(low * grid), floor(high * grid))",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "rows with several entries cut the box",
        "if len(used) == 1:  # the row cuts the box",
        "if used:  # the row cuts the box",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "the chord is rounded inward",
        "high, low = -(-leads[1] // unit), -leads[0] // unit",
        "high, low = leads[1] // unit, -(leads[0] // unit)",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "an open neuron lies below each of its channels",
        "combine((-lead, grid, -grid)",
        "combine((0, grid, -grid)",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "an open neuron lies below the lowest of its upper ends",
        "high = max(highest(form, box) for form in neuron)",
        "high = min(highest(form, box) for form in neuron)",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "a case with one point is empty",
        "Fraction(-1) if rest < 0 else None",
        "Fraction(-1) if rest <= 0 else None",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "the last channel of a split is left out",
        "for j in reversed(range(hidden[layer][1])):",
        "for j in reversed(range(max(1, hidden[layer][1] - 1))):",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "the limit after the last one may have a weight",
        "any(i >= len(limits) for i in node[1::2])",
        "any(i > len(limits) for i in node[1::2])",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "trees may be missing",
        "if len(trees) != len(rows):",
        "if len(trees) > len(rows):",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "cases of a mode have the region of the first mode",
        "self.certificate.acting(self.certificate.modes[number])",
        "self.certificate.acting(self.certificate.modes[0])",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "cases of one set are kept for the next",
        "        self._known.clear()\n        ends =",
        "        ends =",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "regions that cover F_max and U are enough for successors",
        'if bare else self._missing("inputs")',
        "if bare else None",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "states outside the shrunk set attain the criterion",
        "if d and all(dot(a, x) <= b for a, b in S) else None",
        "if d else None",
    ),
    Fault(
        "proofs",
        "certificate/checker.py",
        "the disturbance of a step in the file may lie outside D",
        "if not beyond or any(dot(a, d) > b for a, b in self.certificate.modes[number].disturbance):",
        "if not beyond:",
    ),
    Fault(
        "maximal_set",
        "analysis/maximal_set.py",
        "the slack enlarges X instead of shrinking it",
        "limits = X.h - D.support(X.H) - slack * np.abs(X.H).sum(axis=1)",
        "limits = X.h - D.support(X.H) + slack * np.abs(X.H).sum(axis=1)",
    ),
    Fault(
        "maximal_set",
        "analysis/maximal_set.py",
        "the slack shrinks the lost sets",
        "b += slack * np.abs(A).sum(axis=2)",
        "b -= slack * np.abs(A).sum(axis=2)",
    ),
)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("rooms", nargs="*", metavar="ROOM", help=f"of {', '.join(TESTS)}; all of them if none is given")
    rooms = parser.parse_args().rooms or list(TESTS)
    if unknown := set(rooms) - set(TESTS):
        parser.error(f"there is no room {', '.join(sorted(unknown))}; choose from {', '.join(TESTS)}")
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        shutil.copytree(ROOT / "lib", folder / "lib", ignore=shutil.ignore_patterns("__pycache__"))
        (folder / "data").symlink_to(ROOT / "data")
        for room in rooms:
            begin = perf_counter()
            broken = failures(shlex.split(TESTS[room]), folder, folder / "compiled")
            report(room, "no fault", begin, f"FAILS: {', '.join(broken)}" if broken else "all tests pass")
            for fault in (fault for fault in FAULTS if fault.room == room):
                begin = perf_counter()
                caught = injected(fault, folder, broken)
                report(room, fault.name, begin, f"caught by {caught[0]}" if caught else "NOT CAUGHT")
                missed += not caught
    print(f"{missed} not caught")
    return 1 if missed else 0


def report(room, name, begin, outcome):
    print(f"{room:<13} {perf_counter() - begin:4.0f} s  {name}: {outcome}", flush=True)


def injected(fault, folder, broken):
    """The first test that fails with a fault, in a list; `broken` are those that fail anyway, and do not count."""
    path = folder / "lib" / "mireach" / fault.file
    text, found = path.read_text(), path.stat()
    if text.count(fault.old) != 1:
        raise ValueError(f"{fault.file} holds {text.count(fault.old)} times, and not once: {fault.old}")
    # numba keeps compiled code as long as kernels.py has the same date; with a fault it gets a folder of its own
    compiled = Path(tempfile.mkdtemp(dir=folder)) if fault.file == "sets/kernels.py" else folder / "compiled"
    try:
        path.write_text(text.replace(fault.old, fault.new))
        deselected = [f"--deselect={test}" for test in broken]
        return failures(["-x", *shlex.split(TESTS[fault.room]), *deselected], folder, compiled)
    except subprocess.TimeoutExpired:
        return []
    finally:
        path.write_text(text)
        os.utime(path, ns=(found.st_atime_ns, found.st_mtime_ns))


def failures(arguments, folder, compiled):
    """The tests that fail with the package in `folder`.

    Raises
    ------
    RuntimeError
        If pytest ends without an answer, such as where the package cannot be imported.
    subprocess.TimeoutExpired
        If that takes longer than `SECONDS`.
    """
    own = {"PYTHONPATH": str(folder / "lib"), "NUMBA_CACHE_DIR": str(compiled), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-rf", "-p", "no:cacheprovider", *arguments]
    run = subprocess.run(
        command, cwd=ROOT, env=os.environ | own, capture_output=True, text=True, timeout=SECONDS, check=False
    )
    found = FAILED.findall(run.stdout)
    if run.returncode not in (0, 1) or (run.returncode == 1) != bool(found):
        raise RuntimeError(f"pytest ended with {run.returncode}:\n{run.stdout}\n{run.stderr}")
    return found


if __name__ == "__main__":
    sys.exit(main())
