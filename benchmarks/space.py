"""Cells of loops with three to six states: their number, the time to build them, and that of a step.

    python benchmarks/space.py

Random ReLU networks control two modes, which meet in x_1 = 0; two case studies follow. A step is the support function
of R_1(X) and of R_1(X / 2) along all 2 n axes. Build times are from one run (the kernels are compiled before), steps
are medians of five.
"""

from statistics import median
from time import perf_counter

import numpy as np

import mireach as mr
from mireach.engines import space
from mireach.engines.units import own_units

NETWORKS = [(3, (32, 32)), (3, (32, 32, 32)), (4, (16, 16, 16)), (4, (32, 32)), (5, (16, 16)), (6, (12, 12))]
CASES = ["aircraft_pitch", "quadrotor"]


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


def row_of(name, loop):
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
    return f"| {name} | {n} | {count:,} | {build:.2f} s | {whole:.1f} ms | {half:.1f} ms |"


def main():
    small = two_modes(np.random.default_rng(0), 3, (4,))
    mr.support(small, mr.Polytope.box(-np.ones(3) / 2, np.ones(3) / 2), np.eye(3), engine="cells")
    print("| network | n | cells | build | step over X | step over X / 2 |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for n, widths in NETWORKS:
        print(row_of(f"ReLU {' x '.join(map(str, widths))}", two_modes(np.random.default_rng(1), n, widths)))
    for name in CASES:
        print(row_of(name, mr.case_study(name).loop))


if __name__ == "__main__":
    main()
