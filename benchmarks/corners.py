"""What decides how many iterations F_max takes in case `double_integrator`?  python benchmarks/corners.py [SEEDS]

The optimal control problem has no solution in two corners of X, so the data say nothing there, and what a network
does in the upper right corner is extrapolation. Networks are trained here on the shipped data, and on the same data
with full braking filled in where there is no solution; each is analysed with several disturbance sets and templates.
"""

import sys
from statistics import median

import numpy as np
from joblib import Parallel, delayed

import mireach as mr
from mireach.learning.datasets import DataSet
from mireach.studies.case_studies import data_file
from mireach.studies.seed_study import train_case
from mireach.systems.plants import INTEGRATOR_INPUT_LIMIT

NAME = "double_integrator"


def main(seeds):
    data = DataSet.load(data_file(NAME, "samples.csv"))
    for label, set_ in (("shipped data", data), ("full braking where there is no solution", braking(data))):
        networks = Parallel(n_jobs=-1)(delayed(train_case)(NAME, seed, set_, progress=False) for seed in range(seeds))
        corner = median(float(network([5.5, 5.5])[0]) for network, _ in networks)
        print(f"{label}: {seeds} seeds, median Phi(5.5, 5.5) = {corner:.2f}")
        for variant, disturbance, directions in variants():
            print(f"  {variant}: {summary([network for network, _ in networks], disturbance, directions)}", flush=True)


def braking(data):
    """The data, and at states without a solution the input of largest size against x1 + x2."""
    limit = INTEGRATOR_INPUT_LIMIT
    inputs = -limit * np.sign(data.infeasible.sum(axis=1, keepdims=True))
    states = np.vstack([data.states, data.infeasible])
    costs = np.concatenate([data.costs, np.zeros(len(inputs))])
    return DataSet(states, np.vstack([data.inputs, inputs]), costs, data.infeasible[:0])


def variants():
    """Disturbance sets and templates that are compared."""
    fit = mr.case_study(NAME).fit
    yield "8 directions, |d| <= 0.1186", mr.Polytope.box([-0.1186] * 2, [0.1186] * 2), mr.directions(8)
    yield "16 directions, |d| <= 0.1186", mr.Polytope.box([-0.1186] * 2, [0.1186] * 2), mr.directions(16)
    yield (
        "8 directions, |d| <= 0.1 (size of the minimax error)",
        mr.Polytope.box([-0.1] * 2, [0.1] * 2),
        mr.directions(8),
    )
    yield "8 directions, proven error segment", fit.with_error("polytope").modes[0].disturbance, mr.directions(8)
    yield "8 directions, no disturbance", mr.Polytope.box([0, 0], [0, 0]), mr.directions(8)


def summary(networks, disturbance, directions):
    """Iterations to F_max over networks: smallest, median, largest, and how many have none."""
    counts = []
    for network in networks:
        case = mr.case_study(NAME, network)
        found = mr.safe_set(case.loop.with_disturbance(disturbance), directions)
        if found.verdict == "proven":
            counts.append(found.iterations)
    if not counts:
        return "no network has an F_max"
    spread = f"{min(counts)} to {max(counts)} iterations, median {median(counts):g}"
    return f"{spread}; {len(networks) - len(counts)} without F_max"


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10)
