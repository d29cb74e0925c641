"""Cells of loops with three to six states: their number, the time to build them, and that of a step.

    python benchmarks/space.py [--peers]

Random ReLU networks control two modes, which meet in x_1 = 0; two case studies follow. A step is the support function
of R_1(X) and of R_1(X / 2) along all 2 n axes. Build times are from one run (the kernels are compiled before), steps
are medians of five. With --peers, Gurobi solves the paper's MILP along the same axes over X / 2, and relucent counts
the cells of small networks over all of R^n.
"""

import argparse
from statistics import median
from time import perf_counter

import numpy as np
import peers

import mireach as mr
from mireach.engines import space
from mireach.engines.units import own_units

NETWORKS = [(3, (32, 32)), (3, (32, 32, 32)), (4, (16, 16, 16)), (4, (32, 32)), (5, (16, 16)), (6, (12, 12))]
CASES = ["aircraft_pitch", "quadrotor"]
COUNTED = [(3, (8, 8)), (3, (12, 12)), (4, (8, 8))]


def relu_network(rng, n, widths):
    """A ReLU network with one output and weights of size 1 / sqrt(inputs), as maxout neurons max(z, 0)."""
    hidden, size = [], n
    for width in widths:
        weight, bias = np.zeros((2 * width, size)), np.zeros(2 * width)
        weight[::2], bias[::2] = rng.normal(size=(width, size)) / np.sqrt(size), 0.3 * rng.normal(size=width)
        hidden.append(mr.Layer(weight, bias, 2))
        size = width
    net = mr.MaxoutNetwork(hidden, rng.normal(size=(1, size)) / np.sqrt(size), np.zeros(1))
    return net.saturate([-1.0], [1.0])


def two_modes(rng, n, widths):
    """A closed loop on the box |x|_inf <= 1 whose map jumps at x_1 = 0."""
    X, U = mr.Polytope.box(-np.ones(n), np.ones(n)), mr.Polytope.box([-1.0], [1.0])
    D = mr.Polytope.box(-0.01 * np.ones(n), 0.01 * np.ones(n))
    first = np.eye(n + 1)[:1]
    modes = [
        mr.Mode(
            0.5 * rng.normal(size=(n, n)), rng.normal(size=(n, 1)), np.zeros(n), mr.Polytope(sign * first, [0.0]), D
        )
        for sign in (1.0, -1.0)
    ]
    return mr.ClosedLoop(mr.PWASystem(modes, X, U), relu_network(rng, n, widths))


def seconds_of(call, *arguments, **settings):
    """The seconds that a call takes."""
    begin = perf_counter()
    call(*arguments, **settings)
    return perf_counter() - begin


def row_of(name, loop, others):
    """The row of the table for one loop."""
    n, engine = loop.system.state_size, mr.Cells()
    V = mr.box_directions(n)
    X, own = loop.system.state_set, own_units(loop).loop
    build = seconds_of(space.dynamics, own, engine.limit)
    mr.support(loop, X, V, engine=engine)
    whole, half = (
        1e3 * median(seconds_of(mr.support, loop, F, V, engine=engine) for _ in range(5)) for F in (X, X.scale(0.5))
    )
    count = len(space.dynamics(own, engine.limit).cells)
    row = f"| {name} | {n} | {count:,} | {build:.2f} s | {whole:.1f} ms | {half:.1f} ms |"
    return row + (f" {gurobi_of(loop, X.scale(0.5), V)} |" if others else "")


def gurobi_of(loop, F, V):
    """Seconds that Gurobi takes along all rows of V, as text; it says how many the time limit stopped."""
    bounds = mr.support(loop, F, V).bound
    seconds, found = peers.timed(lambda F, v: peers.paper(peers.gurobi, loop, F, v[None])[0], [(F, v) for v in V])
    late = sum(one >= peers.LIMIT for one in seconds)
    assert all(np.isclose(a, b, atol=1e-6) or t >= peers.LIMIT for a, b, t in zip(found, bounds, seconds))
    return f"{sum(seconds):.2f} s" + (f" ({late} of {len(V)} stopped after {peers.LIMIT:g} s)" if late else "")


def counted(n, widths):
    """A row of the table of cell counts: relucent explores R^n, the cells here are those of a large box."""
    import relucent
    import torch

    rng = np.random.default_rng(1)
    net = relu_network(rng, n, widths)
    parts = []
    for layer in net.hidden[: len(widths)]:
        linear = torch.nn.Linear(layer.weight.shape[1], layer.width).double()
        linear.weight.data, linear.bias.data = torch.tensor(layer.weight[::2]), torch.tensor(layer.bias[::2])
        parts += [linear, torch.nn.ReLU()]
    last = torch.nn.Linear(widths[-1], 1).double()
    begin = perf_counter()
    other = relucent.Complex(torch.nn.Sequential(*parts, last))
    other.bfs()
    theirs = perf_counter() - begin
    X, U = mr.Polytope.box(np.full(n, -1e5), np.full(n, 1e5)), mr.Polytope.box([-1e8], [1e8])
    D = mr.Polytope.box(np.zeros(n), np.zeros(n))
    mode = mr.Mode(np.eye(n), np.ones((n, 1)), np.zeros(n), mr.Polytope(np.zeros((1, n + 1)), [1.0]), D)
    without = mr.MaxoutNetwork(net.hidden[: len(widths)], np.ones((1, widths[-1])), np.zeros(1))
    loop = own_units(mr.ClosedLoop(mr.PWASystem([mode], X, U), without)).loop
    ours = seconds_of(space.dynamics, loop, mr.Cells().limit)
    count = len(space.dynamics(loop, mr.Cells().limit).cells)
    name, faster = " x ".join(map(str, widths)), count / ours / (len(other) / theirs)
    return f"| ReLU {name} | {n} | {count:,} | {len(other):,} | {ours:.4f} s | {theirs:.1f} s | {faster:,.0f} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__.split(":")[0])
    parser.add_argument("--peers", action="store_true", help="Gurobi and relucent, too")
    others = parser.parse_args().peers
    gurobi = others and peers.available("gurobipy")
    small = two_modes(np.random.default_rng(0), 3, (4,))
    mr.support(small, mr.Polytope.box(-np.ones(3) / 2, np.ones(3) / 2), np.eye(3), engine="cells")
    print("| network | n | cells | build | step over X | step over X / 2 |" + " the same, Gurobi |" * gurobi)
    print("| --- | ---: | ---: | ---: | ---: | ---: |" + " ---: |" * gurobi)
    for n, widths in NETWORKS:
        print(row_of(f"ReLU {' x '.join(map(str, widths))}", two_modes(np.random.default_rng(1), n, widths), gurobi))
    for name in CASES:
        print(row_of(name, mr.case_study(name).loop, gurobi), flush=True)
    if others and peers.available("relucent"):
        print("\n| network | n | cells | relucent | build | relucent | cells per second, times relucent |")
        print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
        for n, widths in COUNTED:
            print(counted(n, widths), flush=True)


if __name__ == "__main__":
    main()
