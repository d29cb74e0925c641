"""Training of maxout networks on the solutions of an optimal control problem (Sec. IV of [Teichrib2025])."""

import math
from dataclasses import dataclass

import numpy as np
from tqdm.auto import trange

from ..checks import real_array
from ..errors import MissingExtraError
from ..systems.network import Layer, MaxoutNetwork

try:
    import torch
except ImportError as missing:
    raise MissingExtraError("training", "torch", "train") from missing

from ..systems.torch_import import Maxout

LEAK = 0.01  # slope of the loss's clipping outside U: keeps a gradient where the output is cut off
BETAS = (0.9, 0.99)  # Adam's; a shorter memory of squares than its default fits these small networks better
LOSS_EVERY = 100  # steps between two entries of the history


def maxout_module(inputs, outputs, layers, width, pool, generator=None):
    """A maxout network as torch modules, in double precision.

    Parameters
    ----------
    inputs, outputs : int
        n and m.
    layers, width, pool : int
        l, w_i and p_i of Sec. II.B.
    generator : torch.Generator or None
        Draws the weights; None is torch's own.

    Returns
    -------
    torch.nn.Sequential
        Linear and Maxout in turn, and a last Linear.
    """
    parts, size = [], inputs
    for _ in range(layers):
        parts += [_linear(size, width * pool, generator), Maxout(pool)]
        size = width
    return torch.nn.Sequential(*parts, _linear(size, outputs, generator))


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """Answer of `train`.

    Attributes
    ----------
    network : MaxoutNetwork
        Saturated to the box, in the units of the data.
    loss : float
        Mean squared error of the saturated network on the data, in units of u^2.
    history : array (h, 2)
        Step, and the mean squared error of the clipped output before that step.
    """

    network: MaxoutNetwork
    loss: float
    history: np.ndarray


def train(states, inputs, *, layers, width, pool, lower, upper, seed=0, steps=6000, learning_rate=0.01, progress=True):
    """Fit a maxout network to states and inputs.

    Parameters
    ----------
    states : array (N, n)
    inputs : array (N, m)
    layers, width, pool : int
        l, w_i and p_i of Sec. II.B.
    lower, upper : array (m,) or float
        The input box U to which the network is saturated.
    seed : int
        Decides the initial weights; the same seed gives the same network on the same machine with the
        same number of threads.
    steps : int
    learning_rate : float
        At the start; it falls to 0 along a cosine.
    progress : bool
        Show a progress bar.

    Returns
    -------
    TrainingResult

    Raises
    ------
    ValueError
        If sizes do not match.

    Notes
    -----
    Adam on all data at once. The loss is taken of the output clipped to U with a small slope outside,
    so that a state at which the output is cut off on the wrong side still pulls it back. States are
    scaled to [-1, 1] for the training, and the scaling is folded into the first layer. The caller's
    random numbers are left alone.
    """
    states, inputs = real_array(states, "states", 2), real_array(inputs, "inputs", 2)
    if len(states) != len(inputs) or not len(states):
        raise ValueError(f"states has {len(states)} rows and inputs has {len(inputs)}; one input a state is needed")
    m = inputs.shape[1]
    lower = real_array(np.broadcast_to(lower, m), "lower", 1)
    upper = real_array(np.broadcast_to(upper, m), "upper", 1)
    centre, scale = _scaling(states)
    module = maxout_module(states.shape[1], m, layers, width, pool, generator=torch.Generator().manual_seed(seed))
    data = [torch.tensor(value) for value in ((states - centre) / scale, inputs, lower, upper)]
    history = _descend(module, *data, steps, learning_rate, progress)
    network = _unscale(MaxoutNetwork.from_torch(module), centre, scale).saturate(lower, upper)
    return TrainingResult(network, float(((network(states) - inputs) ** 2).mean()), np.array(history).reshape(-1, 2))


def _linear(inputs, outputs, generator):
    """A Linear in double precision whose weights and biases are drawn from `generator` alone."""
    part = torch.nn.utils.skip_init(torch.nn.Linear, inputs, outputs, dtype=torch.float64)
    limit = 1 / math.sqrt(inputs)
    with torch.no_grad():
        part.weight.uniform_(-limit, limit, generator=generator)
        part.bias.uniform_(-limit, limit, generator=generator)
    return part


def _descend(module, x, u, lower, upper, steps, learning_rate, progress):
    """Adam on the leaky clipped loss; returns the history."""
    optimizer = torch.optim.Adam(module.parameters(), lr=learning_rate, betas=BETAS, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, T_max=max(steps, 1))
    history = []
    for step in trange(steps, desc="training", unit="step", disable=not progress):
        optimizer.zero_grad()
        output = module(x)
        clipped = output.clamp(lower, upper)
        if step % LOSS_EVERY == 0:
            history.append((step, float(((clipped.detach() - u) ** 2).mean())))
        loss = ((clipped + LEAK * (output - clipped) - u) ** 2).mean()
        loss.backward()
        optimizer.step()
        schedule.step()
    return history


def _scaling(states):
    """Middle and half width of the data along each axis; 1 in place of a width of 0."""
    lower, upper = states.min(axis=0), states.max(axis=0)
    half = (upper - lower) / 2
    return (lower + upper) / 2, np.where(half > 0, half, 1.0)


def _unscale(network, centre, scale):
    """The network x -> network((x - centre) / scale)."""
    first = network.hidden[0] if network.hidden else network
    weight = first.weight / scale
    bias = first.bias - weight @ centre
    if not network.hidden:
        return MaxoutNetwork((), weight, bias)
    return MaxoutNetwork((Layer(weight, bias, first.pool), *network.hidden[1:]), network.weight, network.bias)
