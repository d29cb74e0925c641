"""How the work grows with the network and the number of steps: python benchmarks/growth.py [--wide]

Prints Markdown tables, and draws docs/figures/growth.{svg,png}. Medians of several runs in one process. With --wide
only the largest network is looked at, and how much memory that takes.
"""

import argparse
import sys
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter

import memory
import numpy as np
from matplotlib.figure import Figure
from peers import MARK

import mireach as mr
from mireach import plotting
from mireach.engines import cells
from mireach.errors import SolverStopped

ROOT = Path(__file__).resolve().parents[1]
SHAPES = [  # kind, layers, width, channels a neuron
    ("ReLU", 1, 16, 2),
    ("ReLU", 2, 16, 2),
    ("ReLU", 2, 32, 2),
    ("ReLU", 2, 64, 2),
    ("ReLU", 3, 16, 2),
    ("ReLU", 3, 32, 2),
    ("ReLU", 3, 64, 2),
    ("maxout", 3, 3, 3),
    ("maxout", 5, 5, 5),
    ("maxout", 5, 10, 5),
]
TIME_LIMIT = 30.0  # seconds of a MILP for one direction
STEPS = {"pwa": 5, "double_integrator": 3}


def random_network(kind, layers, width, pool, seed=0):
    """A random network of two inputs, its output of about the size of the inputs and saturated to [-2, 2]."""
    rng, hidden, size = np.random.default_rng(seed), [], 2
    for _ in range(layers):
        weight = rng.normal(size=(width, pool, size)) * np.sqrt(2 / size) / (1 if kind == "ReLU" else 2)
        bias = rng.normal(size=(width, pool))
        if kind == "ReLU":
            weight[:, 1], bias[:, 1] = 0, 0
        hidden.append(mr.Layer(weight.reshape(-1, size), bias.ravel(), pool))
        size = width
    return mr.MaxoutNetwork(hidden, rng.normal(size=(1, size)) / np.sqrt(size), [0.0]).saturate(-2, 2)


def seconds(work, runs):
    """Median time of `work`, after one run that is not counted."""
    work()
    found = []
    for _ in range(runs):
        begin = perf_counter()
        work()
        found.append(perf_counter() - begin)
    return median(found)


def networks():
    """The cells of random networks over nine modes, and one support by the MILP: rows for the table and the plot."""
    system, V = mr.case_study("double_integrator").system, mr.directions(8)
    print(
        "| random network, 9 modes | binaries | cells | building them, s | one step in 8 directions over X, ms |",
        end="",
    )
    print(" MILP over 0.1 X, one direction, s |\n| --- | ---: | ---: | ---: | ---: | ---: |")
    found = []
    for kind, layers, width, pool in SHAPES:
        network = random_network(kind, layers, width, pool)
        build = seconds(partial(build_anew, system, network), 3)
        loop = mr.ClosedLoop(system, network)
        step = seconds(partial(mr.support, loop, system.state_set, V), 20)
        by_milp, _ = ask_milp(loop, system.state_set.scale(0.1), V[:1])
        count = len(cells.cells(loop))
        name = f"{kind} {layers} x {width}" + (f", pool {pool}" if kind == "maxout" else "")
        took = f"{by_milp:.3g}" if by_milp < TIME_LIMIT else f"> {TIME_LIMIT:g}"
        print(f"| {name} | {network.binaries} | {count} | {build:.3g} | {step * 1e3:.3g} | {took} |", flush=True)
        found.append((kind, layers * width, count, build, step, by_milp))
    return found


def build_anew(system, network):
    """The cells under a copy of the network, so that nothing is cached."""
    return cells.cells(mr.ClosedLoop(system, mr.MaxoutNetwork(network.hidden, network.weight, network.bias)))


def ask_milp(loop, F, V, steps=1):
    """Seconds of one support by the MILP, inf if the time limit came first, and its bound."""
    begin = perf_counter()
    try:
        bound = mr.support(loop, F, V, steps, engine=mr.Milp(time_limit=TIME_LIMIT)).bound
    except SolverStopped as stop:
        return np.inf, stop.support.bound
    return perf_counter() - begin, bound


def steps():
    """Lemma 2: h of R_k(F_max) along one direction by both engines: rows (case, k, cells, MILP)."""
    print("| case | k | cells, s | MILP, s | difference of the bounds |\n| --- | ---: | ---: | ---: | ---: |")
    found = []
    for name, most in STEPS.items():
        case = mr.case_study(name)
        F, V = mr.safe_set(case.loop, case.safe_directions).set, case.directions[:1]
        for k in range(1, most + 1):
            by_cells = seconds(partial(mr.support, case.loop, F, V, k), 1)
            by_milp, bound = ask_milp(case.loop, F, V, k)
            apart = bound[0] - mr.support(case.loop, F, V, k).bound[0]
            took = f"{by_milp:.3g}" if np.isfinite(by_milp) else f"> {TIME_LIMIT:g}"
            print(f"| {name} | {k} | {by_cells:.3g} | {took} | {apart:.2g} |", flush=True)
            found.append((name, k, by_cells, by_milp))
    return found


def wide():
    """The cells of a ReLU network of 3 x 64 neurons over nine modes: seconds, milliseconds, peak of this process."""
    system, network = mr.case_study("double_integrator").system, random_network("ReLU", 3, 64, 2)
    build = seconds(partial(build_anew, system, network), 5)
    loop = mr.ClosedLoop(system, network)
    step = seconds(partial(mr.support, loop, system.state_set, mr.directions(8)), 50)
    work = f"a random ReLU network 3 x 64, 9 modes, {len(cells.cells(loop))} cells"
    report(f"{work}: building them", "2 s", f"{build:.2f} s", build <= 2)
    report("the same: one step, 8 directions over X", "10 ms", f"{step * 1e3:.2f} ms", step <= 0.01)
    needed = memory.peak()
    if needed is not None:
        report("the same: peak memory of the process", "1 GB", f"{needed:.0f} MiB", needed <= 1000)


def report(work, limit, here, holds):
    """One row of the table of targets."""
    print("\t".join([MARK, work, "fixed limit", f"at most {limit}", here, "yes" if holds else "NO"]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--wide", action="store_true", help="only the largest network, and its memory")
    if parser.parse_args().wide:
        wide()
        return
    rows, longer = networks(), steps()
    figure = Figure(figsize=(9.6, 3.6), layout="constrained")
    plotting.plot_growth(figure.subplots(1, 3), rows, longer)
    for form, options in (("svg", {}), ("png", {"dpi": 150})):
        path = ROOT / "docs" / "figures" / f"growth.{form}"
        plotting.save_figure(figure, path, bbox_inches="tight", **options)


if __name__ == "__main__":
    sys.exit(main())
