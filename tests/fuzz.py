"""Random loops and sets on which all engines and sampling have to agree: what `test_fuzz.py` and the benchmark run."""

import warnings
from collections import Counter
from fractions import Fraction

import numpy as np
from loops import disturbance, enclosing_inputs, exact_highest, random_images, random_loop, replays

import mireach as mr
from mireach import Cells, Exact, Milp, Polytope, SolverError, SolverStopped, box_directions, directions, support

CLOSE = 1e-9  # what bounds of the float cells may lie above the exact value, for rows of length 1
RESOLVED = 1e-6  # what bounds of the MILP may lie above it
FLOATS = {"exact": 0.0, "cells": CLOSE}  # engines that answer about every set, and these limits; None for a loose one
ROUNDED = 1e-12  # by which the images of samples may pass a bound, for the samples themselves are rounded
TOUCHING = {"cells": 1e-10, "milp": 1e-7, "samples": 1e-12}  # shares of X; sets that come this close may touch
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
    return np.abs(
        support(loop, loop.system.state_set, box_directions(loop.system.state_size), engine="exact").bound
    ).max()


def widened(F, by):
    """F with rows of length 1 moved outward."""
    return Polytope(F.H, F.h + by * np.linalg.norm(F.H, axis=1))


def space_loop(seed, n):
    """A smaller loop with n states, for n > 2: up to five modes, one or two inputs, up to two layers."""
    rng = np.random.default_rng([seed, n])
    return rng, random_loop(
        seed,
        n=n,
        m=int(rng.integers(1, 3)),
        cuts=int(rng.integers(0, 4)),
        with_input=bool(rng.integers(0, 2)),
        saturated=bool(rng.integers(0, 2)),
        layers=int(rng.integers(1, 3)),
        width=int(rng.integers(1, 4)),
        pool=int(rng.integers(1, 4)),
        gain=float(rng.choice([0.3, 0.6, 1.5])),
    )


def space_sets(loop, rng):
    """Pairs (kind, Polytope) as `some_sets`, for n > 2."""
    X, n = loop.system.state_set, loop.system.state_size
    x, v = X.sample(rng, n + 3), rng.normal(size=n)
    first, width = np.arange(n) == 0, 10.0 ** rng.uniform(-13, -2)
    low, high = np.minimum(x[0], x[1]), np.maximum(x[0], x[1])
    yield "X", X
    yield "beyond X", X.scale(1.5)
    yield "hull", Polytope.from_points(x)
    yield "box", Polytope.box(low, high)
    yield "flat box", Polytope.box(np.where(first, x[0], low), np.where(first, x[0], high))
    yield "point", Polytope.box(x[0], x[0])
    yield "sliver", X & Polytope([v, -v], [v @ x[0] + width, -v @ x[0] + width])
    tilted = v + 10.0 ** rng.uniform(-9, -2) * rng.normal(size=n)
    yield "needle", X & Polytope([v, -tilted], [v @ x[0], -tilted @ x[0]])
    rows = [row for mode in loop.system.modes for row in zip(mode.region.H, mode.region.h) if not row[0][n:].any()]
    if rows:
        a, b = rows[rng.integers(len(rows))]
        t = x[0] + (b - a[:n] @ x[0]) / (a[:n] @ a[:n]) * a[:n]
        yield "at a point", Polytope.box(t, t)
        yield "at a face", X & Polytope([a[:n], -a[:n]], [b, -b])
        yield "at one side", X & Polytope([a[:n]], [b])


def disagreements(seed, milp_sets=2, n=2, most_sets=99):
    """What is wrong with the answers about one random loop with n states: list of str, and a Counter of the questions.

    For every set F and direction v, with h = h of R_1(F) along v by the exact engine: no sampled image passes a bound;
    h <= bound of the float cells <= h + CLOSE; h <= bound of the MILP <= h + RESOLVED. Where F touches a boundary of
    regions, whatever has tolerances may count what exact arithmetic finds apart by rounding, and a MILP solver
    moves the tip of a needle: there the upper limit is taken from F widened by TOUCHING. No value passes h, or
    this limit, by more than CLOSE.
    """
    if n == 2:
        rng, loop = some_loop(seed)
        V, sets = np.vstack([directions(5), rng.normal(size=(1, 2)) * 30]), some_sets
    else:
        rng, loop = space_loop(seed, n)
        V, sets = (
            np.vstack([box_directions(n)[[0, n]], rng.normal(size=(3, n)), rng.normal(size=(1, n)) * 30]),
            space_sets,
        )
    length, found, asked = np.maximum(1, np.linalg.norm(V, axis=1)), [], Counter()
    size, sets = size_of(loop), list(sets(loop, rng))
    extent = max(1.0, np.abs(loop.system.state_set.bounding_box()).max())
    if len(sets) > most_sets:
        sets = [sets[i] for i in rng.choice(len(sets), most_sets, replace=False)]
    for_milp = set(rng.choice(len(sets), milp_sets, replace=False).tolist())
    for number, (kind, F) in enumerate(sets):
        h = support(loop, F, V, engine="exact").bound
        answers = {name: (support(loop, F, V, engine=name), above) for name, above in FLOATS.items()}
        if number in for_milp:
            try:
                answers["milp"] = (support(loop, F, V, engine="milp"), RESOLVED)
            except SolverError:
                asked["milp without an answer"] += len(V)
        at = {who: support(loop, widened(F, by * extent), V, engine="exact").bound for who, by in TOUCHING.items()}
        images = np.zeros((0, len(V))) if F.is_empty else random_images(loop, F, rng, SAMPLES) @ V.T
        asked["sampled images"] += len(images)
        for engine, (answer, above) in answers.items():
            bound, value = answer.bound, answer.value
            asked[engine] += len(V)
            tolerant = kind.startswith("at") or (kind == "needle" and engine == "milp")
            limit = at.get(engine, h) if tolerant else h
            most = np.inf if above is None else limit + above * length
            for k in np.flatnonzero((bound < h) | (bound > most)):
                found.append(f"seed {seed}, {kind}, direction {k}: {engine} {bound[k]!r}, exact {h[k]!r}")
            for k in np.flatnonzero(value > limit + CLOSE * length * max(1, size)):
                found.append(f"seed {seed}, {kind}, direction {k}: {engine} attains {value[k]!r}, exact {h[k]!r}")
            reached = np.maximum(bound, at["samples"]) if kind.startswith("at") else bound
            for k in np.flatnonzero((images > reached + ROUNDED * length * max(1, size)).any(axis=0)):
                found.append(f"seed {seed}, {kind}, direction {k}: a sampled image passes the bound of {engine}")
    return found, asked


# -- badly conditioned loops --------------------------------------------------------------------------


def hard_loop(seed):
    """A small loop with weights of 1e-4 to 1e7, gains to 1e6, up to three inputs, in units of 1e-9 to 1e9."""
    rng = np.random.default_rng([seed, 14])
    n, m, hidden, width = int(rng.integers(2, 4)), int(rng.integers(1, 4)), [], 0
    unit, speed = 10.0 ** rng.uniform(-9, 9, 2)
    size = n
    for number in range(int(rng.integers(1, 3))):
        width, pool = int(rng.integers(1, 3)), int(rng.integers(1, 3))
        weight = 10.0 ** rng.uniform(-4, 7) * rng.normal(size=(width * pool, size)) / (unit if not number else 1)
        if rng.random() < 0.3 and number:  # what the layer before says nearly cancels
            weight[:, -1] = -weight[:, 0] * (1 + 2.0**-30)
        hidden.append(
            mr.Layer(weight, np.abs(weight).max() * unit ** (not number) * rng.normal(size=width * pool), pool)
        )
        size = width
    net = mr.MaxoutNetwork(hidden, rng.normal(size=(m, size)), rng.normal(size=m))
    X = Polytope.box(-unit * rng.uniform(0.5, 1, n), unit * rng.uniform(0.5, 1, n))
    if rng.random() < 0.5:
        net = net.saturate(np.full(m, -speed), np.full(m, speed))
        U = Polytope.box(np.full(m, -speed), np.full(m, speed))
    else:
        low, high = enclosing_inputs(net, X)
        U = Polytope.box(low - 0.1 * np.abs(low), high + 0.1 * np.abs(high))
    reach = np.abs(U.bounding_box()).max(axis=0)
    calm = rng.random() < 0.4  # a loop of which X may be RPI
    gain, cut = 0.2 if calm else 10.0 ** rng.choice([rng.uniform(-1, 0), rng.uniform(0, 6)]), rng.normal(size=n + m)
    cut[n:] *= rng.integers(0, 2) * unit / reach
    offset = cut[:n] @ X.sample(rng, 1)[0]
    sides = [Polytope(sign * cut[None], [sign * offset]) for sign in (1.0, -1.0)][: int(rng.integers(1, 3))]
    sides = sides if len(sides) == 2 else [Polytope(np.zeros((1, n + m)), [1.0])]
    modes = []
    for side in sides:
        A = gain * rng.normal(size=(n, n)) * rng.integers(0, 2, (n, n))
        D = disturbance(rng.choice(["box", "segment", "point", "origin"]), rng, n)
        D = None if D is None else Polytope(D.H, D.h * (0.1 if calm else 0.3) * unit)
        B = (0.05 if calm else 0.3) * unit * rng.normal(size=(n, m)) / reach
        modes.append(mr.Mode(A, B, (0.05 if calm else 0.1) * unit * rng.normal(size=n), side, D))
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the region of mode")
        return rng, mr.ClosedLoop(mr.PWASystem(modes, X, U), net)


def hard_sets(loop, rng):
    """Sets in X: all of it, boxes down to 1e-9 of its size, rows of any length, flat sets (with offsets of 0 too)."""
    X, n = loop.system.state_set, loop.system.state_size
    x, reach = X.sample(rng, 1)[0], np.abs(X.bounding_box()).max(axis=0)
    yield X
    width = reach * 10.0 ** rng.uniform(-9, 0, n)
    box = Polytope.box(np.maximum(x - width, -X.h[n:]), np.minimum(x + width, X.h[:n]))
    yield box
    rows = 10.0 ** rng.uniform(-12, 12, len(box.h))
    yield Polytope(box.H * rows[:, None], box.h * rows)
    yield Polytope.box(*(np.where(np.arange(n) == 0, x, end) for end in box.bounding_box()))
    normal = rng.normal(size=n) / reach
    yield X & Polytope([normal, -normal], [normal @ x + 1e-9, -(normal @ x)])
    yield X & flat_with_zeros(rng, reach)


def flat_with_zeros(rng, reach):
    """A flat set in which most rows have offset 0: part of a hyperplane in one orthant, with whole numbers as rows."""
    n = len(reach)
    a, unit = rng.integers(-9, 10, n).astype(float), 2.0 ** np.floor(np.log2(reach))
    equality = a / unit
    offset = rng.integers(0, 2) * (equality @ (unit * rng.integers(0, 8, n) / 8))
    orthant = -np.diag(rng.choice([1.0, 3.0, 7.0], n))
    return Polytope(np.vstack([equality, -equality, orthant]), np.concatenate([[offset, -offset], np.zeros(n)]))


OPTIONS = [
    {"formulation": formulation, "bounds": bounds}
    for formulation in ("split", "whole", "paper")
    for bounds in ("interval", "lp", "tight")
]


def wrong_verdicts(seed, time_limit=0.5):
    """What is wrong with the answers about one badly conditioned loop: list of str, and a Counter of the questions.

    No bound lies below what a step attains in fractions; "proven" is not left by such a step (by more than 1e-6 of the
    size of X where the proof says so), and "refuted" comes with a step that replays in fractions.
    """
    rng, loop = hard_loop(seed)
    n, found, asked, X = loop.system.state_size, [], Counter(), loop.system.state_set
    V = np.vstack([box_directions(n)[rng.integers(2 * n)], rng.normal(size=n)])
    size, options = np.abs(X.bounding_box()).max(axis=0), OPTIONS[seed % len(OPTIONS)]
    chosen = rng.permutation(6)[:1].tolist()
    for number, F in enumerate(hard_sets(loop, rng)):
        truth, where = exact_highest(loop, F, V), f"seed {seed}, set {number}"
        asked["supports in fractions"] += sum(value is not None for value in truth)
        engines = [Cells(), Exact()]
        engines += [Milp(**options, time_limit=time_limit)] if number in chosen else []
        for engine in engines:
            asked[f"bounds by {engine.name}"] += len(V)
            try:
                bound = support(loop, F, V, engine=engine).bound
            except SolverStopped as stop:
                bound = stop.support.bound
                asked["stopped by the time limit"] += 1
            except SolverError:
                asked["without an answer"] += 1
                continue
            for k, value in enumerate(truth):
                if (
                    value is not None and Fraction(bound[k]) < value
                    if np.isfinite(bound[k])
                    else bound[k] < 0 and value is not None
                ):
                    found.append(f"{where}, {engine}: {bound[k]!r} < {float(value)!r} along {k}")
        if number in chosen or n == 2:
            found += [f"{where}: {text}" for text in _wrong_check(loop, F, size, asked, time_limit)]
    return found, asked


def _wrong_check(loop, F, size, asked, time_limit):
    """What is wrong with `check_rpi` of F, and whether its "proven" and "refuted" are right."""
    if F.is_empty:
        return []
    engine = Cells() if loop.system.state_size == 2 else Milp(time_limit=time_limit)
    try:
        check = mr.check_rpi(loop, F, engine)
    except SolverError:
        asked["without an answer"] += 1
        return []
    asked[f"{check.verdict} in {loop.system.state_size} states"] += 1
    if check.verdict == "refuted":
        return [] if replays(loop, F, check.escape) else ["refuted by a step that does not replay"]
    if check.verdict == "proven":
        slack = 1e-6 * np.abs(F.H) @ size if "to within" in check.settled else 0.0
        for value, limit in zip(exact_highest(loop, F, F.H), (F.h + slack).tolist()):
            if value is not None and value > Fraction(limit):
                return [f"proven, but a step passes {limit!r} by {float(value - Fraction(limit)):.3g}"]
    return []
