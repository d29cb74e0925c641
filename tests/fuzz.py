"""Random loops and sets on which all engines and sampling have to agree: what `test_fuzz.py` and the benchmark run."""

from collections import Counter

import numpy as np
from loops import random_images, random_loop

from mireach import Polytope, SolverError, box_directions, directions
from mireach.engines import cells, exact, milp

CLOSE = 1e-9  # what bounds of the float cells may lie above the exact value, for rows of length 1
RESOLVED = 1e-6  # what bounds of the MILP may lie above it
ROUNDED = 1e-12  # by which the images of samples may pass a bound, for the samples themselves are rounded
TOUCHING = {"cells": 1e-10, "milp": 1e-7, "samples": 1e-12}  # sets that come this close may count as touching
SAMPLES = 20


def some_loop(seed):
    """A loop of random shape: up to six modes, regions of x or of (x, u), up to three layers of up to four neurons."""
    rng = np.random.default_rng(seed)
    return rng, random_loop(
        seed,
        cuts=int(rng.integers(0, 6)),
        with_input=bool(rng.integers(0, 2)),
        saturated=bool(rng.integers(0, 2)),
        layers=int(rng.integers(1, 4)),
        width=int(rng.integers(1, 5)),
        pool=int(rng.integers(1, 5)),
        gain=float(rng.choice([0.3, 0.6, 1.5])),
    )


def on_boundaries(loop, x):
    """For every row of a region that does not involve u, the point nearest to x on its boundary: array (k, 2)."""
    rows = [row for mode in loop.system.modes for row in zip(mode.region.H, mode.region.h) if not row[0][2:].any()]
    return np.array([x + (b - a[:2] @ x) / (a[:2] @ a[:2]) * a[:2] for a, b in rows]).reshape(-1, 2)


def needle(rng, x):
    """A triangle whose tip is the meeting of two nearly parallel rows, at about x."""
    angle, width = rng.uniform(0, 2 * np.pi), 10.0 ** rng.uniform(-9, -2)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    H = np.array([across + width * along, -across + width * along, -along])
    return Polytope(H, H @ x + [0, 0, rng.uniform(0.1, 3)])


def some_sets(loop, rng):
    """Pairs (kind, Polytope); those whose kind begins with "at" touch boundaries of regions, up to rounding."""
    X = loop.system.state_set
    x = X.sample(rng, 6)
    direction = directions(16)[rng.integers(16)]
    across, width = np.array([-direction[1], direction[0]]), 10.0 ** rng.uniform(-13, -2)
    yield "X", X
    yield "beyond X", X.scale(1.5)
    yield "hull", Polytope.from_points(x)
    yield "box", Polytope.box(np.minimum(x[0], x[1]), np.maximum(x[0], x[1]))
    yield "point", Polytope.box(x[0], x[0])
    yield "segment", Polytope.from_points(x[:2])
    ends = np.array([x[0] - direction, x[0] + direction])
    yield "sliver", Polytope.from_points(np.vstack([ends - width * across, ends + width * across]))
    yield "needle", needle(rng, x[0])
    touching = on_boundaries(loop, x[0])
    if len(touching):
        t = touching[rng.integers(len(touching))]
        yield "at a point", Polytope.box(t, t)
        yield "at an edge", Polytope.from_points(np.array([t, x[1], x[2]]))
        yield "at a segment", Polytope.from_points(np.array([t, x[1]]))


def size_of(loop):
    """Largest coordinate of R_1(X)."""
    return np.abs(exact.support(loop, loop.system.state_set, box_directions(2)).bound).max()


def widened(F, by):
    """F with rows of length 1 moved outward."""
    return Polytope(F.H, F.h + by * np.linalg.norm(F.H, axis=1))


def disagreements(seed, milp_sets=2):
    """What is wrong with the answers about one random loop: list of str, and a Counter of the questions asked.

    For every set F and direction v, with h = h of R_1(F) along v by the exact engine: no sampled image passes a bound;
    h <= bound of the float cells <= h + CLOSE; h <= bound of the MILP <= h + RESOLVED. Where F touches a boundary of
    regions, whatever has tolerances may count what exact arithmetic finds apart by rounding, and a MILP solver
    moves the tip of a needle: there the upper limit is taken from F widened by TOUCHING.
    """
    rng, loop = some_loop(seed)
    V = np.vstack([directions(5), rng.normal(size=(1, 2)) * 30])
    length, found, asked = np.maximum(1, np.linalg.norm(V, axis=1)), [], Counter()
    size, sets = size_of(loop), list(some_sets(loop, rng))
    for_milp = set(rng.choice(len(sets), milp_sets, replace=False).tolist())
    for number, (kind, F) in enumerate(sets):
        h = exact.support(loop, F, V).bound
        bounds = {"exact": (h, 0.0), "cells": (cells.support(loop, F, V).bound, CLOSE)}
        if number in for_milp:
            try:
                bounds["milp"] = (milp.support(loop, F, V).bound, RESOLVED)
            except SolverError:
                asked["milp without an answer"] += len(V)
        at = {who: exact.support(loop, widened(F, by), V).bound for who, by in TOUCHING.items()}
        images = random_images(loop, F, rng, SAMPLES) @ V.T
        asked["sampled images"] += len(images)
        for engine, (bound, above) in bounds.items():
            asked[engine] += len(V)
            tolerant = kind.startswith("at") or (kind == "needle" and engine == "milp")
            limit = at.get(engine, h) if tolerant else h
            for k in np.flatnonzero((bound < h) | (bound > limit + above * length)):
                found.append(f"seed {seed}, {kind}, direction {k}: {engine} {bound[k]!r}, exact {h[k]!r}")
            reached = np.maximum(bound, at["samples"]) if kind.startswith("at") else bound
            for k in np.flatnonzero((images > reached + ROUNDED * length * max(1, size)).any(axis=0)):
                found.append(f"seed {seed}, {kind}, direction {k}: a sampled image passes the bound of {engine}")
    return found, asked
