"""OMLT as a peer of the MILP: the network by its big-M formulation of ReLUs, the plant beside it, solved by HiGHS.

OMLT knows no maxout, so that a neuron is a tree of ReLUs: max(a, b) = b + relu(a - b). Its dense layers have one
predecessor each; what a ReLU layer has to hand on goes through it as relu(b - l), with a lower bound l of b.
"""

import numpy as np
import pyomo.environ as pyo
from omlt import OmltBlock
from omlt.neuralnet import FullSpaceNNFormulation, NetworkDefinition
from omlt.neuralnet.layer import DenseLayer, InputLayer
from pyomo.contrib.solver.solvers.highs import Highs

from mireach.engines.boxes import disturbance_box
from mireach.tolerances import FEASIBILITY, INTEGRALITY, MIP_GAP

OPTIONS = {
    "mip_feasibility_tolerance": INTEGRALITY,
    "primal_feasibility_tolerance": FEASIBILITY,
    "dual_feasibility_tolerance": FEASIBILITY,
}


def support(loop, F, V, limit):
    """Bounds (k,) of h of R_1(F) along the rows of V (k, n): dual bounds of HiGHS, at most `limit` seconds each."""
    return np.array([_maximum(_model(loop, F & loop.system.state_set, v), limit) for v in V])


def _maximum(model, limit):
    """Dual bound of a model; inf if HiGHS ends without one."""
    found = Highs().solve(
        model,
        time_limit=limit,
        rel_gap=MIP_GAP,
        abs_gap=MIP_GAP,
        solver_options=OPTIONS,
        load_solutions=False,
        raise_exception_on_nonoptimal_result=False,
    )
    return np.inf if found.objective_bound is None else found.objective_bound


def _model(loop, F, v):
    """max v x+ over x in F as a Pyomo model: the network from OMLT, the plant's modes as in the paper."""
    modes, n = loop.system.modes, loop.system.state_size
    low, high = F.bounding_box()
    model = pyo.ConcreteModel()
    model.net = OmltBlock()
    model.net.build_formulation(FullSpaceNNFormulation(_definition(loop.network, low, high)))
    x, u = list(model.net.inputs.values()), list(model.net.outputs.values())
    model.rows = pyo.ConstraintList()
    _add_rows(model, F, x)
    model.gamma = pyo.Var(range(len(modes)), domain=pyo.Binary)
    model.rows.add(pyo.quicksum(model.gamma.values()) == 1)
    model.d = pyo.Var(range(n))
    model.parts = pyo.Var(range(len(modes)), range(n))
    d = list(model.d.values())
    M = _big_m(loop.system, low, high)
    for i, mode in enumerate(modes):
        off = M * (1 - model.gamma[i])
        _add_rows(model, mode.region, [*x, *u], off)  # eq. gammaForR
        _add_rows(model, mode.disturbance, d, off)  # eq. MI_PWA_Hd
        for c in range(n):
            part = model.parts[i, c]
            image = _dot(mode.A[c], x) + _dot(mode.B[c], u) + float(mode.p[c]) + d[c]
            for one in (part, -part):  # eq. MI_PWA_xTilde
                model.rows.add(one <= M * model.gamma[i])
            for one in (part - image, image - part):  # eq. MI_PWA_ABpd
                model.rows.add(one <= off)
    parts = [pyo.quicksum(model.parts[i, c] for i in range(len(modes))) for c in range(n)]  # eq. MI_PWA_sumXTilde
    model.best = pyo.Objective(expr=_dot(v, parts), sense=pyo.maximize)
    return model


def _add_rows(model, P, x, off=0.0):
    """H x <= h + off."""
    for row, offset in zip(P.H, P.h):
        model.rows.add(_dot(row, x) <= float(offset) + off)


def _dot(row, x):
    return pyo.quicksum(float(a) * one for a, one in zip(row, x) if a)


def _big_m(system, low, high):
    """The paper's big-M of the plant, from the boxes of x, of U and of D."""
    d_box, u_box = disturbance_box(system.modes), system.input_set.bounding_box()
    xu, xud = ([np.concatenate(ends) for ends in zip((low, high), u_box, *more)] for more in ((), (d_box,)))
    M = 0.0
    for mode in system.modes:
        image = _interval(np.hstack([mode.A, mode.B, np.eye(len(low))]), mode.p, *xud)
        inside = _interval(mode.region.H, -mode.region.h, *xu)
        within = _interval(mode.disturbance.H, -mode.disturbance.h, *d_box)
        M = max(M, np.abs(image).max(), inside[1].max(), within[1].max())
    return M


def _interval(W, b, low, high):
    """The range of W x + b over a box, as lower and upper ends."""
    middle, reach = W @ ((low + high) / 2) + b, np.abs(W) @ ((high - low) / 2)
    return middle - reach, middle + reach


# -- maxout by ReLUs ----------------------------------------------------------------------------------


def _definition(network, low, high):
    """OMLT's definition of the network over a box."""
    definition = NetworkDefinition(scaled_input_bounds=dict(enumerate(zip(low.tolist(), high.tolist()))))
    last = InputLayer([len(low)])
    definition.add_layer(last)
    for W, b, activation in _dense_layers(network, low, high):
        layer = DenseLayer([W.shape[1]], [len(W)], activation=activation, weights=W.T, biases=b)
        definition.add_layer(layer)
        definition.add_edge(last, layer)
        last = layer
    return definition


def _dense_layers(network, low, high):
    """The network as layers (W, b, activation); low, high are the box of its input."""
    T, t = np.eye(len(low)), np.zeros(len(low))  # q = T y + t, of the last layer's outputs y
    for layer in network.hidden:
        shape = (layer.width, layer.pool)
        low, high = (end.reshape(shape) for end in _interval(layer.weight, layer.bias, low, high))
        T, t = (layer.weight @ T).reshape(*shape, -1), (layer.weight @ t + layer.bias).reshape(shape)
        while t.shape[1] > 1:
            T, t, relus, low, high = _pairwise(T, t, low, high)
            yield *relus, "relu"
        T, t, low, high = T[:, 0], t[:, 0], low[:, 0], high[:, 0]
    yield network.weight @ T, network.weight @ t + network.bias, "linear"


def _pairwise(T, t, low, high):
    """One level of the tree: p channels T y + t of each neuron, (w, p, r) and (w, p), become half as many.

    Returns their T, t in terms of a layer of ReLUs, that layer's W and b, and their bounds (w, p - p // 2).
    """
    width, p = t.shape
    first, second, rest = slice(p // 2), slice(p // 2, p // 2 * 2), slice(p // 2, p)
    W = np.concatenate([T[:, first] - T[:, second], T[:, rest]], axis=1)  # relu(a - b), then relu(b - low)
    b = np.concatenate([t[:, first] - t[:, second], t[:, rest] - low[:, rest]], axis=1)
    add = np.hstack([np.eye(p - p // 2, p // 2), np.eye(p - p // 2)])
    ends = [end[:, rest].copy() for end in (low, high)]
    for end, before in zip(ends, (low, high)):
        end[:, : p // 2] = np.maximum(end[:, : p // 2], before[:, first])
    after = np.kron(np.eye(width), add).reshape(width, p - p // 2, width * p)
    return after, low[:, rest], (W.reshape(width * p, -1), b.ravel()), *ends
