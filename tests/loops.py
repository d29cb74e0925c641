"""Random closed loops, and oracles that share no code with the package: they only read its data (H, h, weights)."""

import warnings
from fractions import Fraction
from itertools import combinations, product

import numpy as np
from scipy.optimize import linprog

from mireach import ClosedLoop, Layer, MaxoutNetwork, Mode, Polytope, PWASystem

INSIDE = 1e-7  # how far a witness may be from the sets that it claims to be in

# -- builders -----------------------------------------------------------------------------------------


def random_network(rng, n, m, layers=2, width=2, pool=2, gain=0.6):
    """A maxout network with normal weights."""
    hidden, size = [], n
    for _ in range(layers):
        hidden.append(Layer(gain * rng.normal(size=(width * pool, size)), rng.normal(size=width * pool), pool))
        size = width
    return MaxoutNetwork(hidden, gain * rng.normal(size=(m, size)), 0.5 * rng.normal(size=m))


def disturbance(kind, rng, n):
    """A disturbance set of R^n: "point", "origin", "segment", "box", or (in the plane) "triangle"."""
    middle, reach = 0.1 * rng.normal(size=n), rng.uniform(0.05, 0.3, n)
    if kind == "origin":
        return None
    if kind == "point":
        return Polytope.box(middle, middle)
    if kind == "segment":
        if n == 2:
            along = reach * rng.choice([-1, 1], n)
            return Polytope.from_points(np.array([middle - along, middle + along]))
        return Polytope.box(middle - reach * (np.arange(n) == 0), middle + reach * (np.arange(n) == 0))
    if kind == "triangle" and n == 2:
        return Polytope.from_points(middle + reach * np.array([[1.0, 0.3], [-1.0, 0.8], [0.2, -1.0]]))
    return Polytope.box(middle - reach, middle + reach)


KINDS = ("box", "segment", "point", "triangle", "origin")


def cut_regions(rng, n, m, cuts, with_input, limits):
    """Regions of R^(n+m): each cut halves every region that it is given to, and meets the middle of X x U."""
    whole = Polytope(np.vstack([np.eye(n + m), -np.eye(n + m)])[[0]], [100.0])
    regions = [whole]
    for _ in range(cuts):
        a = rng.normal(size=n + m)
        if not with_input:
            a[n:] = 0
        b = a[:n] @ rng.uniform(-0.4, 0.4, n) * limits
        chosen = regions.pop(0)
        regions += [chosen & Polytope(a[None], [b]), chosen & Polytope(-a[None], [-b])]
    return regions


def random_loop(seed, n=2, m=1, cuts=2, with_input=False, kinds=KINDS, limits=3.0, saturated=False, **network):
    """A loop whose regions are random, whose maps jump from region to region, and whose modes differ in D."""
    rng = np.random.default_rng(seed)
    net = random_network(rng, n, m, **network)
    X = Polytope.box(-limits * rng.uniform(0.7, 1, n), limits * rng.uniform(0.7, 1, n))
    if saturated:
        net = net.saturate(-np.ones(m), np.ones(m))
        U = Polytope.box(-np.ones(m), np.ones(m))
    else:
        U = Polytope.box(*enclosing_inputs(net, X))
    modes = [
        Mode(
            0.6 * rng.normal(size=(n, n)),
            0.6 * rng.normal(size=(n, m)),
            0.5 * rng.normal(size=n),
            region,
            disturbance(rng.choice(kinds), rng, n),
        )
        for region in cut_regions(rng, n, m, cuts, with_input, limits)
    ]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the region of mode")  # a cut may miss X x U
        return ClosedLoop(PWASystem(modes, X, U), net)


def enclosing_inputs(net, X):
    """Limits that Phi keeps on the box X, by interval arithmetic."""
    n = X.dimension
    high, low = X.h[:n], -X.h[n:]
    for layer in net.hidden:
        up = np.maximum(layer.weight, 0) @ high + np.minimum(layer.weight, 0) @ low + layer.bias
        down = np.maximum(layer.weight, 0) @ low + np.minimum(layer.weight, 0) @ high + layer.bias
        high, low = up.reshape(-1, layer.pool).max(axis=1), down.reshape(-1, layer.pool).max(axis=1)
    W = net.weight
    up = np.maximum(W, 0) @ high + np.minimum(W, 0) @ low + net.bias
    down = np.maximum(W, 0) @ low + np.minimum(W, 0) @ high + net.bias
    return down - 0.1, up + 0.1


def affine_loop(A, D=None, limits=1.0, p=None, u=0.0):
    """x+ = A x + p + d with one mode, X = [-limits, limits]^n, and a network that says u without effect."""
    A = np.atleast_2d(np.asarray(A, float))
    n = len(A)
    p = np.zeros(n) if p is None else np.asarray(p, float)
    everywhere = Polytope(np.eye(n + 1)[:1], [max(1e3, 2 * limits)])
    net = MaxoutNetwork((), np.zeros((1, n)), [u])
    X = Polytope.box(-limits * np.ones(n), limits * np.ones(n))
    return ClosedLoop(PWASystem([Mode(A, np.zeros((n, 1)), p, everywhere, D)], X, Polytope.box([-1], [1])), net)


def jump_loop(left, right, D=None, limits=4.0):
    """x+ = left where x1 <= 1 and x+ = right where x1 >= 1: constant maps that jump at the line x1 = 1."""
    zero, column = np.zeros((2, 2)), np.zeros((2, 1))
    below, above = Polytope([[1.0, 0, 0]], [1.0]), Polytope([[-1.0, 0, 0]], [-1.0])
    sets = [None, None] if D is None else D
    modes = [Mode(zero, column, left, below, sets[0]), Mode(zero, column, right, above, sets[1])]
    net = MaxoutNetwork([Layer([[1, 0], [0, 1.0]], [0, 0], 2)], [[0.1]], [0.0])
    X = Polytope.box(-limits * np.ones(2), limits * np.ones(2))
    return ClosedLoop(PWASystem(modes, X, Polytope.box([-1], [1])), net)


def narrow_spike(width=1e-3):
    """A loop whose network leaves U only within `width` of x1 = 0.7123: sampling misses that."""
    ramp = 2.0 / width
    hidden = Layer(
        [[ramp, 0], [0, 0], [-ramp, 0], [0, 0]], [-ramp * 0.7123 + 2, 0, ramp * 0.7123 + 2, 0], 2
    )  # max(2 + r (x - c), 0) and max(2 - r (x - c), 0): their smallest is a spike of height 2 at c
    lowest = Layer([[-1.0, 0], [0, -1.0]], [0, 0], 2)
    net = MaxoutNetwork([hidden, lowest], [[-1.0]], [0.0])
    return ClosedLoop(affine_loop(0.5 * np.eye(2)).system, net)


# -- oracles ------------------------------------------------------------------------------------------


def evaluate(net, x):
    """Phi(x) for one state, neuron by neuron."""
    y = np.asarray(x, float)
    for layer in net.hidden:
        z = [row @ y + b for row, b in zip(layer.weight, layer.bias)]
        y = np.array([max(z[i : i + layer.pool]) for i in range(0, len(z), layer.pool)])
    return np.array([row @ y + b for row, b in zip(net.weight, net.bias)])


def largest(c, A, b):
    """max c w subject to A w <= b by scipy; -inf if nothing satisfies it."""
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10, "presolve": False}
    found = linprog(-np.asarray(c, float), A, b, bounds=(None, None), method="highs-ds", options=options)
    if found.status == 2:
        return -np.inf
    assert found.status in (0, 3), found.message
    return np.inf if found.status == 3 else -found.fun


def highest_vertex(H, h, c):
    """max c x over the vertices of {x : H x <= h} in fractions, or None if there is no vertex."""
    best = None
    for chosen in combinations(range(len(h)), len(c)):
        x = solve_exactly([[*map(Fraction, H[i])] for i in chosen], [Fraction(h[i]) for i in chosen])
        if x is not None and all(sum(a * y for a, y in zip(row, x)) <= b for row, b in zip(H, h)):
            value = sum(a * y for a, y in zip(c, x))
            best = value if best is None else max(best, value)
    return best


def brute_support(loop, F, V, steps=1, within=None):
    """h of R_k(F) & `within` along V: one LP for every choice of modes and winning channels that is possible at all.

    The variables are w = (x(0), d(0), ..., d(k - 1)); every state of the trajectory is E w + e.
    """
    n = loop.system.state_size
    size = n * (steps + 1)
    E, e = np.eye(n, size), np.zeros(n)
    V = np.asarray(V, float)
    best = np.full(len(V), -np.inf)
    for E_end, e_end, A, b in _trajectories(loop, E, e, F.H @ E, F.h, steps, 0):
        if within is not None:
            A, b = np.vstack([A, within.H @ E_end]), np.concatenate([b, within.h - within.H @ e_end])
        best = np.maximum(best, [largest(v @ E_end, A, b) + v @ e_end for v in V])
    return best


def _trajectories(loop, E, e, A, b, steps, k):
    """E w + e of the last state, and the constraints on w, for every possible choice."""
    if k == steps:
        yield E, e, A, b
        return
    X, n = loop.system.state_set, loop.system.state_size
    A, b = np.vstack([A, X.H @ E]), np.concatenate([b, X.h - X.H @ e])
    for K, g, A_net, b_net in _choices(loop.network.hidden, E, e, A, b):
        U, c = loop.network.weight @ K, loop.network.weight @ g + loop.network.bias
        for mode in loop.system.modes:
            H, D = mode.region.H, mode.disturbance
            S = np.zeros((n, E.shape[1]))
            S[:, n * (k + 1) : n * (k + 2)] = np.eye(n)
            A_mode = np.vstack([A_net, H[:, :n] @ E + H[:, n:] @ U, D.H @ S])
            b_mode = np.concatenate([b_net, mode.region.h - H[:, :n] @ e - H[:, n:] @ c, D.h])
            if largest(np.zeros(E.shape[1]), A_mode, b_mode) == -np.inf:
                continue
            after = mode.A @ E + mode.B @ U + S, mode.A @ e + mode.B @ c + mode.p
            yield from _trajectories(loop, *after, A_mode, b_mode, steps, k + 1)


def _choices(hidden, K, g, A, b):
    """K w + g of the last hidden layer and the constraints, for every choice of winning channels."""
    if not hidden:
        yield K, g, A, b
        return
    layer, partial = hidden[0], [((), A, b)]
    Z, z = layer.weight @ K, layer.weight @ g + layer.bias
    for neuron in range(layer.width):
        rows = range(neuron * layer.pool, (neuron + 1) * layer.pool)
        following = []
        for winners, A_now, b_now in partial:
            for j in rows:
                A_new, b_new = np.vstack([A_now, Z[list(rows)] - Z[j]]), np.concatenate([b_now, z[j] - z[list(rows)]])
                if largest(np.zeros(A.shape[1]), A_new, b_new) > -np.inf:
                    following.append(((*winners, j), A_new, b_new))
        partial = following
    for winners, A_now, b_now in partial:
        yield from _choices(hidden[1:], Z[list(winners)], z[list(winners)], A_now, b_now)


def random_images(loop, F, rng, count, steps=1):
    """States of R_k(F): random starts in F, every closed mode, random extreme disturbances; those that stay in X."""
    x = F.sample(rng, count)
    for _ in range(steps):
        x = random_successors(loop, x, rng)
    return x


def random_successors(loop, x, rng):
    """Images of those x (N, n) that lie in X: one for each closed region, with a random extreme disturbance."""
    X, ends = loop.system.state_set, []
    corners = [mode.disturbance.vertices() for mode in loop.system.modes]
    for state in x[(x @ X.H.T <= X.h).all(axis=1)]:
        xu = np.concatenate([state, evaluate(loop.network, state)])
        for mode, d in zip(loop.system.modes, corners):
            if (mode.region.H @ xu <= mode.region.h).all():
                ends.append(mode.A @ state + mode.B @ xu[len(state) :] + mode.p + d[rng.integers(len(d))])
    return np.array(ends).reshape(-1, loop.system.state_size)


def assert_replays(loop, F, v, value, witness):
    """The witness is a trajectory of the loop from F that ends at the value along v."""
    X, x = loop.system.state_set, witness.states
    assert (F.H @ x[0] <= F.h + INSIDE).all()
    for k in range(len(x) - 1):
        mode, u, d = loop.system.modes[witness.modes[k]], witness.inputs[k], witness.disturbances[k]
        assert (X.H @ x[k] <= X.h + INSIDE).all()
        assert np.abs(u - evaluate(loop.network, x[k])).max() <= INSIDE
        assert (mode.region.H @ np.concatenate([x[k], u]) <= mode.region.h + INSIDE).all()
        assert (mode.disturbance.H @ d <= mode.disturbance.h + INSIDE).all()
        assert np.abs(mode.A @ x[k] + mode.B @ u + mode.p + d - x[k + 1]).max() <= INSIDE
    assert abs(np.asarray(v) @ x[-1] - value) <= INSIDE


# -- rational oracles ---------------------------------------------------------------------------------


def exact_input(net, x):
    """Phi(x) of a rational state, neuron by neuron, with the weights as the floats they are."""
    y = [Fraction(value) for value in x]
    for layer in net.hidden:
        z = [_exact_dot(row, y) + Fraction(b) for row, b in zip(layer.weight.tolist(), layer.bias.tolist())]
        y = [max(z[i : i + layer.pool]) for i in range(0, len(z), layer.pool)]
    return [_exact_dot(row, y) + Fraction(b) for row, b in zip(net.weight.tolist(), net.bias.tolist())]


def exactly_inside(P, x):
    """Whether a rational point is in a Polytope, without rounding."""
    return all(_exact_dot(row, x) <= Fraction(b) for row, b in zip(P.H.tolist(), P.h.tolist()))


def exact_maximum(H, h, c, scale=None):
    """max c x over H x <= h as a Fraction, attained by a rational point: (value, x); None if none is found.

    scipy finds which rows are tight, for x in units of `scale`; that their meeting lies in all rows and that c is a
    nonnegative combination of them is then checked without rounding, for other choices of nearly tight rows too.
    """
    H, c = [[Fraction(a) for a in row] for row in H], [Fraction(a) for a in c]
    h, n = [Fraction(b) for b in h], len(c)
    A, b = _rows_for_floats(H, h, scale)
    top = max(map(abs, c)) or Fraction(1)
    found = linprog(-np.array([float(a / top) for a in c]), A, b, bounds=(None, None), method="highs-ds")
    if found.status:
        return None
    if not any(c):  # where x1 is largest there is a point, if floats are right that the set is not empty
        best = exact_maximum(H, h, [int(i == 0) for i in range(n)], scale)
        return best and (Fraction(0), best[1])
    nearly = np.argsort(b - A @ found.x, kind="stable")[: n + 4].tolist()
    for chosen in combinations(nearly, n):
        rows = [H[i] for i in chosen]
        x, y = solve_exactly(rows, [h[i] for i in chosen]), solve_exactly(list(zip(*rows)), c)
        if x is None or y is None or min(y) < 0:
            continue
        if all(_exact_dot(row, x) <= limit for row, limit in zip(H, h)):
            return _exact_dot(c, x), x
    return None


def solve_exactly(A, b):
    """The solution of a square system in Fractions, or None if it is singular (Gauss)."""
    rows, n = [[*a, right] for a, right in zip(A, b)], len(b)
    for i in range(n):
        pivot = next((k for k in range(i, n) if rows[k][i]), None)
        if pivot is None:
            return None
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [entry / rows[i][i] for entry in rows[i]]
        for k in range(n):
            if k != i and rows[k][i]:
                rows[k] = [e - rows[k][i] * f for e, f in zip(rows[k], rows[i])]
    return [row[-1] for row in rows]


def exact_highest(loop, F, V):
    """What R_1(F) reaches along the rows of V, in Fractions: one exact maximum for every mode and winning channels.

    Each number is attained by a step. Where scipy overlooks a choice, it may lie below h of R_1(F).
    """
    n, X = loop.system.state_size, loop.system.state_set
    rows = [(list(map(Fraction, a)), Fraction(b)) for P in (F, X) for a, b in zip(P.H.tolist(), P.h.tolist())]
    identity = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
    best, V = [None] * len(V), V.tolist()
    scale = list(map(Fraction, np.abs(X.bounding_box()).max(axis=0).tolist()))
    pushed = [
        [exact_maximum(D.H.tolist(), D.h.tolist(), v, scale)[0] for v in V]
        for D in (mode.disturbance for mode in loop.system.modes)
    ]
    for K, g, inside in _exact_choices(loop.network.hidden, identity, [Fraction(0)] * n, rows, scale):
        K, g = _exact_affine(loop.network.weight, loop.network.bias, K, g)
        for mode, farthest in zip(loop.system.modes, pushed):
            H, h = [row for row, _ in inside], [limit for _, limit in inside]
            of_region, of_h = _exact_affine(mode.region.H[:, n:], -mode.region.h, K, g)
            H += [[Fraction(a) + b for a, b in zip(row, of_u)] for row, of_u in zip(mode.region.H.tolist(), of_region)]
            h += [-value for value in of_h]
            if exact_maximum(H, h, [0] * n, scale) is None:
                continue
            M, c = _exact_affine(mode.B, mode.p, K, g)
            M = [[Fraction(a) + b for a, b in zip(row, of_u)] for row, of_u in zip(mode.A.tolist(), M)]
            for k, v in enumerate(V):
                top = exact_maximum(H, h, [_exact_dot(v, column) for column in zip(*M)], scale)
                if top is not None:
                    value = top[0] + _exact_dot(v, c) + farthest[k]
                    best[k] = value if best[k] is None else max(best[k], value)
    return best


def _floats_find_none(rows, scale):
    """Whether scipy calls rows (a, b) of Fractions contradictory."""
    A, b = _rows_for_floats(*zip(*rows), scale)
    return linprog(np.zeros(A.shape[1]), A, b, bounds=(None, None), method="highs-ds").status == 2


def _rows_for_floats(H, h, scale):
    """Rows of Fractions as floats: x in units of `scale`, each row divided by its largest entry."""
    scale = [Fraction(1)] * len(H[0]) if scale is None else scale
    H = [[a * s for a, s in zip(row, scale)] for row in H]
    size = [max(map(abs, row)) or Fraction(1) for row in H]
    A = np.array([[float(a / k) for a in row] for row, k in zip(H, size)])
    return A, np.array([float(b / k) for b, k in zip(h, size)])


def _exact_affine(W, b, K, g):
    """W (K x + g) + b in Fractions: the matrix and the constant."""
    W, columns = np.asarray(W).tolist(), list(zip(*K))
    matrix = [[_exact_dot(row, column) for column in columns] for row in W]
    return matrix, [_exact_dot(row, g) + Fraction(c) for row, c in zip(W, np.asarray(b).tolist())]


def _exact_choices(hidden, K, g, rows, scale):
    """K x + g of the last hidden layer and the rows (a, b), for every choice of winning channels."""
    if not hidden:
        yield K, g, rows
        return
    layer = hidden[0]
    Z, z = _exact_affine(layer.weight, layer.bias, K, g)
    groups = [range(i, i + layer.pool) for i in range(0, len(z), layer.pool)]
    for won in product(*groups):
        beaten = [(i, j) for group, j in zip(groups, won) for i in group if i != j]
        more = [([a - b for a, b in zip(Z[i], Z[j])], z[j] - z[i]) for i, j in beaten]
        if _floats_find_none([*rows, *more], scale):
            continue
        yield from _exact_choices(hidden[1:], [Z[j] for j in won], [z[j] for j in won], rows + more, scale)


def exactly_in_triangle(corners, x):
    """Whether a rational point is in the closed triangle with float corners (3, 2)."""
    corners = [[Fraction(value) for value in corner] for corner in corners.tolist()]
    turns = [
        (q[0] - p[0]) * (x[1] - p[1]) - (q[1] - p[1]) * (x[0] - p[0])
        for p, q in zip(corners, corners[1:] + corners[:1])
    ]
    return all(turn >= 0 for turn in turns) or all(turn <= 0 for turn in turns)


def replays(loop, F, escape):
    """Whether a step leads out of the Polytope F without rounding, or its state lies in F and outside X."""
    x, n = list(map(Fraction, escape.state)), loop.system.state_size
    if not exactly_inside(F, x):
        return False
    if escape.after is None:
        return not exactly_inside(loop.system.state_set, x)
    mode, u, d = loop.system.modes[escape.mode], exact_input(loop.network, x), list(map(Fraction, escape.disturbance))
    rows = zip(mode.A.tolist(), mode.B.tolist(), mode.p.tolist(), d)
    after = [_exact_dot([*a, *b], [*x, *u]) + Fraction(p) + shift for a, b, p, shift in rows]
    inside = exactly_inside(loop.system.state_set, x) and exactly_inside(mode.region, [*x, *u])
    return inside and exactly_inside(mode.disturbance, d) and not exactly_inside(F, after) and len(after) == n


def assert_escapes(loop, pieces, escape):
    """A step from a state of the triangles to one outside of them, or a state of theirs outside X: exactly."""
    x = escape.state
    assert any(exactly_in_triangle(piece, x) for piece in pieces)
    if escape.after is None:
        assert not exactly_inside(loop.system.state_set, x)
        return
    mode, u = loop.system.modes[escape.mode], exact_input(loop.network, x)
    assert exactly_inside(mode.region, [*x, *u]) and exactly_inside(mode.disturbance, escape.disturbance)
    for i in range(2):
        after = _exact_dot([*mode.A[i].tolist(), *mode.B[i].tolist()], [*x, *u]) + Fraction(mode.p.tolist()[i])
        assert after + escape.disturbance[i] == escape.after[i]
    assert not any(exactly_in_triangle(piece, escape.after) for piece in pieces)


def _exact_dot(row, values):
    return sum((Fraction(a) * value for a, value in zip(row, values)), Fraction(0))


# -- units --------------------------------------------------------------------------------------------


def in_other_units(loop, s, t):
    """The same loop for x' = s x and u' = t u, powers of two (n,) and (m,): every number is scaled without rounding."""
    net, system, both = loop.network, loop.system, np.concatenate([s, t])
    hidden = list(net.hidden)
    if hidden:
        hidden[0] = Layer(hidden[0].weight / s, hidden[0].bias, hidden[0].pool)
    weight = net.weight if hidden else net.weight / s
    network = MaxoutNetwork(hidden, weight * t[:, None], net.bias * t)
    modes = [
        Mode(
            mode.A * s[:, None] / s,
            mode.B * s[:, None] / t,
            mode.p * s,
            set_in_other_units(mode.region, both),
            set_in_other_units(mode.disturbance, s),
        )
        for mode in system.modes
    ]
    X, U = set_in_other_units(system.state_set, s), set_in_other_units(system.input_set, t)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the region of mode")
        return ClosedLoop(PWASystem(modes, X, U), network)


def set_in_other_units(P, s):
    """{s x : x in P}, each row multiplied by a power of two of its own."""
    rows = 2.0 ** np.arange(-3, 4)[np.arange(len(P.h)) % 7]
    return Polytope(P.H / s * rows[:, None], P.h * rows)
