"""More than two states: safe set and terminal set by the MILP alone.  python benchmarks/dimensions.py [--growth]

The first table is of the two case studies with n = 3 and n = 4; with --growth there are two more, of one support call
against n and against the number of steps. Times are of one run; nothing is asserted.
"""

import argparse
from statistics import median
from time import perf_counter

import numpy as np

import mireach as mr
from mireach.studies.case_studies import load_sets

CASES = ("three_tanks", "four_tanks")
SAMPLES = 100_000


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--growth", action="store_true", help="one support call against n and against the steps")
    growth = parser.parse_args().growth
    print(
        "| case | n | modes | binaries | rows | iterations | seconds | k-bar | alpha - 1 | seconds |",
        end="",
    )
    print(" volume of F_max, terminal set / X | largest sampled excess |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name in CASES:
        print(row_of(mr.case_study(name)), flush=True)
    if growth:
        against_n()
        against_steps()


def row_of(case):
    """The sets of one case, found anew."""
    loop, X = case.loop, case.system.state_set
    C, modes = case.directions, len(case.system.modes)
    safe, safe_seconds = timed(mr.safe_set, loop, case.safe_directions, engine="milp")
    terminal, seconds = timed(mr.terminal_set, loop, safe, C, case.epsilon, engine="milp")
    shares = ", ".join(f"{share(F, X):.2g}" for F in (safe.set, terminal.set))
    excess = max(sampled_excess(loop, F, C) for F in (X, safe.set, terminal.set))
    return (
        f"| {case.name} | {case.system.state_size} | {modes} | {case.network.binaries + modes} | {len(C)} "
        f"| {safe.iterations} | {safe_seconds:.1f} | {terminal.steps}{'' if terminal.criterion else ' (stopped)'} "
        f"| {terminal.alpha - 1:.2g} | {seconds:.1f} | {shares} | {excess:.2g} |"
    )


def sampled_excess(loop, F, V):
    """By how much images of random states and of vertices of F pass the MILP's bounds along V; sound if at most 0."""
    rng = np.random.default_rng(0)
    images = loop.step(np.vstack([F.sample(rng, SAMPLES), F.vertices()]))
    worst = (images @ V.T).max(axis=0) + loop.system.modes[0].disturbance.support(V)  # D is the same in all modes
    return float((worst - mr.support(loop, F, V, engine="milp").bound).max())


def share(F, X):
    """The volume of F within X, as a share of that of X."""
    return F.contains(X.sample(np.random.default_rng(0), SAMPLES)).mean()


def against_n():
    """One support call along (1, ..., 1) over a box, for n = 2, ..., 5 and random networks of one shape."""
    print("\nOne direction, random stable A and saturated network of 2 layers x 6 neurons x 3 channels, 15 draws:\n")
    print("| n | median seconds | largest |\n| ---: | ---: | ---: |")
    for n in range(2, 6):
        loops = [random_loop(n, seed) for seed in range(15)]
        seconds = [timed(mr.support, loop, loop.system.state_set, np.ones((1, n)), engine="milp")[1] for loop in loops]
        print(f"| {n} | {median(seconds):.2f} | {max(seconds):.2f} |", flush=True)


def random_loop(n, seed):
    """A loop with one mode, n states, one input, and random weights."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    layers, size = [], n
    for _ in range(2):
        layers.append(mr.Layer(rng.normal(size=(18, size)) / np.sqrt(size), rng.normal(size=18), 3))
        size = 6
    network = mr.MaxoutNetwork(layers, rng.normal(size=(1, 6)), np.zeros(1)).saturate(-1, 1)
    everywhere = mr.Polytope(np.zeros((1, n + 1)), [1.0])
    D = mr.Polytope.box(np.full(n, -0.1), np.full(n, 0.1))
    mode = mr.Mode(A, rng.normal(size=(n, 1)), np.zeros(n), everywhere, D)
    X = mr.Polytope.box(np.full(n, -5.0), np.full(n, 5.0))
    return mr.ClosedLoop(mr.PWASystem([mode], X, mr.Polytope.box([-1], [1])), network)


def against_steps():
    """One support call of k steps along e_1, over the terminal set of each case."""
    print("\nOne direction, k exact steps from the terminal set, seconds:\n")
    print("| case | k = 1 | 2 | 3 | 4 | 5 |\n| --- | ---: | ---: | ---: | ---: | ---: |")
    for name in CASES:
        loop, terminal = mr.case_study(name).loop, load_sets(name)[-1]
        v = np.eye(loop.system.state_size)[:1]
        seconds = [timed(mr.support, loop, terminal, v, steps=k, engine="milp")[1] for k in range(1, 6)]
        print(f"| {name} | {' | '.join(f'{value:.2f}' for value in seconds)} |", flush=True)


def timed(work, *arguments, **options):
    """What `work` returns, and the seconds it took."""
    begin = perf_counter()
    return work(*arguments, **options), perf_counter() - begin


if __name__ == "__main__":
    main()
