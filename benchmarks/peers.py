"""The MILP against other solvers, side by side, as a Markdown table: python benchmarks/peers.py, or run.py bench

HiGHS, Gurobi and SCIP solve the paper's formulation (`milp.build(..., formulation="paper")`), the same matrix for all,
OMLT its own one of ReLUs (`omlt_peer`), with gaps and tolerances like this package's. Peers are installed here and
nowhere else, into a folder of their own; one that cannot be had is named, and so is what the time limit stopped. Where
a peer's full run would take too long, a sample of sets and directions stands for it, drawn evenly from the whole
sequence of sets; the same sample is timed for all.
"""

import argparse
import importlib
import subprocess
import sys
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import highspy
import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

import mireach as mr
from mireach.engines.milp import engine as milp
from mireach.tolerances import INTEGRALITY, MIP_GAP

FOLDER = Path(__file__).resolve().parent / ".peers"
PACKAGES = {
    "gurobipy": ["gurobipy==13.0.*"],
    "pyscipopt": ["pyscipopt==6.*"],
    "relucent": ["relucent==1.0.0", "gurobipy==13.0.*", "networkx==3.*", "plotly==6.*", "narwhals"],
    "omlt": ["omlt==1.2.*", "pyomo==6.10.*", "networkx==3.*"],
}
SAFE_SIDE = 1e-6  # what a bound may lie above the exact support function
LIMIT = 60.0  # seconds that a peer gets for one direction
MARK = "figure:"  # begins the lines of a script that belong in the table of targets
AIMS = (  # work, case, what against, how many times faster at least
    ("double_integrator, supports of F_max and the terminal set by the MILP", "double_integrator", "HiGHS, paper", 25),
    ("the same", "double_integrator", "Gurobi, paper", 3),
    ("pwa, the same", "pwa", "Gurobi, paper", 1),
    ("double_integrator, the same by cells", "double_integrator", "cells: Gurobi, paper", 5000),
)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--sets", type=int, default=5, help="sets of each sequence that stand for it")
    parser.add_argument("--directions", type=int, default=2, help="of the 8 directions over each set")
    options = parser.parse_args(arguments)
    solvers = {"HiGHS, paper": highs_paper, "Gurobi, paper": gurobi, "SCIP, paper": scip}
    peers = {name: partial(paper, solve) for name, solve in solvers.items()} | {"OMLT, HiGHS": omlt}
    for name, package in (("Gurobi, paper", "gurobipy"), ("SCIP, paper", "pyscipopt"), ("OMLT, HiGHS", "omlt")):
        if not available(package):
            del peers[name]
            print(f"{name} is missing: {package} could not be installed")
    print("| case | work | solver | seconds a direction, median | total, s | times this package's MILP |")
    print("| --- | --- | --- | ---: | ---: | ---: |")
    ratios = {name: compare(name, peers, options.sets, options.directions) for name in ("pwa", "double_integrator")}
    return [figure(ratios, *aim) for aim in AIMS]


def figure(ratios, work, case, key, least):
    """One row of the table of targets."""
    here = ratios[case].get(key)
    if here is None:
        found = "-", "not measured"
    else:
        found = f"{here:,.0f} times" if here >= 1000 else f"{here:.3g} times", "yes" if here >= least else "NO"
    return [work, key.removeprefix("cells: "), f"{least:g} times", *found]


def available(package):
    """Import a peer, after an attempt to install it into its own folder."""
    sys.path[:0] = [str(FOLDER)] if str(FOLDER) not in sys.path else []
    for attempt in (0, 1):
        try:
            importlib.import_module(package)
            return True
        except ImportError:
            if attempt:
                return False
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        command += ["--target", str(FOLDER), "--no-deps", *PACKAGES[package]]
        subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
        importlib.invalidate_caches()


def compare(name, peers, count, across):
    """One case: cells and MILP on all sets of the safe set's and the terminal set's sequences, peers on a sample.

    How many times as long each peer takes: dict by its name, and with "cells: " before it against the cells.
    """
    case = mr.case_study(name)
    safe = mr.safe_set(case.loop, case.safe_directions)
    terminal = mr.terminal_set(case.loop, safe, case.directions, case.epsilon)
    sets = [*safe.history, *terminal.history[1:]]
    sample = [sets[i] for i in np.unique(np.linspace(0, len(sets) - 1, count).round().astype(int))]
    V = case.directions
    chosen = np.unique(np.linspace(0, len(V) - 1, across + 1).round().astype(int))[:across]
    every = [(F, V) for F in sets]
    drawn = [(F, V[[row]]) for F in sample for row in chosen]
    whole = [(F, V) for F in sample]
    print(f"<!-- {name}: {len(sets)} sets; sample: {len(sample)} sets x {len(chosen)} directions -->")

    def row(label, solver, seconds, total, reference=None):
        middle, ratio = median(seconds), "" if reference is None else f"{total / reference:.3g}"
        print(f"| {name} | {label} | {solver} | {middle:.3g} | {total:.3g} | {ratio} |", flush=True)

    full, ours = timed(lambda F, V: mr.support(case.loop, F, V, engine="milp").bound, every)
    check(name, "milp", case.loop, every, ours)
    row(f"all {len(sets)} sets x 8", "this package, MILP", [s / len(V) for s in full], sum(full))
    told, bounds = timed(warm_started(case.loop), every)
    check(name, "milp, told of the last set,", case.loop, every, bounds)
    row("the same, told of the last set", "this package, MILP", [s / len(V) for s in told], sum(told))
    mr.support(case.loop, sets[0], V)  # builds the cells
    fast, by_cells = timed(lambda F, V: mr.support(case.loop, F, V).bound, every)
    check(name, "cells", case.loop, every, by_cells)
    row(f"all {len(sets)} sets x 8", "this package, cells", [s / len(V) for s in fast], sum(fast))

    # Ours answers 8 directions at once, so that its share is taken: seconds of a set of the sample by len(chosen) / 8.
    part, _ = timed(lambda F, V: mr.support(case.loop, F, V, engine="milp").bound, whole)
    ours_total = sum(part) * len(chosen) / len(V)
    cells_total = sum(fast[i] for i in range(len(sets)) if any(sets[i] is F for F in sample)) * len(chosen) / len(V)
    row("sample", "this package, MILP", [s / len(V) for s in part], ours_total, ours_total)
    ratios = {}
    for solver, solve in peers.items():
        seconds, bounds = timed(partial(solve, case.loop), drawn)
        stopped = np.array(seconds) >= LIMIT
        check(name, solver, case.loop, drawn, bounds, SAFE_SIDE, stopped)
        row("sample", solver, seconds, sum(seconds), ours_total)
        ratios[solver], ratios[f"cells: {solver}"] = sum(seconds) / ours_total, sum(seconds) / cells_total
        print(f"<!-- {name}: {solver} against the cells: {sum(seconds) / cells_total:.3g} times -->", flush=True)
    return ratios


def warm_started(loop):
    """Bounds by the MILP as a function of F and V, for one set after another, each in the last one."""
    last = []

    def bounds(F, V):
        last[:] = [mr.support(loop, F, V, engine="milp", warm_start=last[0] if last else None)]
        return last[0].bound

    return bounds


def timed(work, tasks):
    """Seconds and answers of work(F, V) for each task."""
    seconds, answers = [], []
    for F, V in tasks:
        begin = perf_counter()
        answers.append(work(F, V))
        seconds.append(perf_counter() - begin)
    return seconds, answers


def check(name, solver, loop, tasks, bounds, below=0.0, stopped=False):
    """Say whether bounds are at most `below` under the exact support function and, unless stopped, SAFE_SIDE above."""
    apart = [bound - mr.support(loop, F, V, engine="exact").value for (F, V), bound in zip(tasks, bounds)]
    low, high = (np.array([end(one) for one in apart]) for end in (np.min, np.max))
    stopped = np.broadcast_to(stopped, len(tasks))
    agrees = (low >= -below).all() and (stopped | (high <= SAFE_SIDE)).all()
    verdict = "agrees with" if agrees else "DIFFERS from"
    late = f"; {stopped.sum()} of {len(tasks)} stopped after {LIMIT:g} s" if stopped.any() else ""
    print(
        f"<!-- {name}: {solver} {verdict} the exact engine: "
        f"bound - exact from {low.min():.2g} to {high.max():.2g}{late} -->",
        flush=True,
    )


# -- the peers ------------------------------------------------------------------------------------------


def paper(solve, loop, F, V):
    """Dual bounds along V of the paper's formulation, its building included."""
    model = milp.build(loop, F, 1, formulation="paper")
    return np.array([solve(model, v) for v in V])


def omlt(loop, F, V):
    """OMLT's formulation of the network as ReLUs, by HiGHS."""
    from omlt_peer import support

    return support(loop, F, V, LIMIT)


def highs_paper(model, v):
    """HiGHS, with its presolve, as it comes."""
    return model.program.maximize_integer(model.states[-1], v, time_limit=LIMIT, presolve=True).bound


def parts(model, v):
    """The model as cost, A, row and column limits, and which columns are binary."""
    lp = model.program.highs.getLp()
    matrix = lp.a_matrix_
    kind = csr_matrix if matrix.format_ == highspy.MatrixFormat.kRowwise else csc_matrix
    A = kind((matrix.value_, matrix.index_, matrix.start_), (lp.num_row_, lp.num_col_))
    cost = np.zeros(lp.num_col_)
    cost[model.states[-1]] = v
    limits = (np.array(part) for part in (lp.row_lower_, lp.row_upper_, lp.col_lower_, lp.col_upper_))
    binary = np.zeros(lp.num_col_, bool)
    binary[model.binaries] = True
    return cost, A.tocsr(), *limits, binary


def gurobi(model, v):
    """Gurobi, through its matrix interface."""
    import gurobipy as gp

    cost, A, row_low, row_high, low, high, binary = parts(model, v)
    with gp.Env(params={"OutputFlag": 0}) as env, gp.Model(env=env) as m:
        for name, setting in {
            "MIPGap": MIP_GAP,
            "MIPGapAbs": MIP_GAP,
            "FeasibilityTol": INTEGRALITY,
            "IntFeasTol": INTEGRALITY,
            "OptimalityTol": INTEGRALITY,
            "TimeLimit": LIMIT,
        }.items():
            m.setParam(name, setting)
        x = m.addMVar(len(cost), lb=low, ub=high, vtype=np.where(binary, "B", "C"), obj=cost)
        m.ModelSense = gp.GRB.MAXIMIZE
        equal = row_low == row_high
        for rows, sense, limit in (
            (equal, "=", row_high),
            (~equal & np.isfinite(row_high), "<", row_high),
            (~equal & np.isfinite(row_low), ">", row_low),
        ):
            m.addMConstr(A[np.flatnonzero(rows)], x, sense, limit[rows])
        m.optimize()
        return m.ObjBound


def scip(model, v):
    """SCIP, row by row."""
    import pyscipopt

    cost, A, row_low, row_high, low, high, binary = parts(model, v)
    m = pyscipopt.Model()
    m.hideOutput()
    m.setParams({"limits/gap": MIP_GAP, "limits/time": LIMIT, "numerics/feastol": INTEGRALITY})
    x = [
        m.addVar(vtype="B" if b else "C", lb=None if lo == -np.inf else lo, ub=None if hi == np.inf else hi)
        for b, lo, hi in zip(binary, low, high)
    ]
    for r in range(len(row_low)):
        entries = slice(A.indptr[r], A.indptr[r + 1])
        row = pyscipopt.quicksum(a * x[j] for j, a in zip(A.indices[entries], A.data[entries]))
        if row_low[r] == row_high[r]:
            m.addCons(row == row_high[r])
            continue
        if np.isfinite(row_high[r]):
            m.addCons(row <= row_high[r])
        if np.isfinite(row_low[r]):
            m.addCons(row >= row_low[r])
    m.setObjective(pyscipopt.quicksum(c * one for c, one in zip(cost, x) if c), "maximize")
    m.optimize()
    return m.getDualbound()


if __name__ == "__main__":
    main()
