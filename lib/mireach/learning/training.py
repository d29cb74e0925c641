"""Training of maxout networks on the solutions of an optimal control problem (Sec. V of [Teichrib2025])."""

import math
from dataclasses import dataclass

import numpy as np
from tqdm.auto import trange

from ..checks import positive_number, real_array, require_bools, whole_number
from ..errors import MissingExtraError
from ..systems.network import Layer, MaxoutNetwork
from ..typing import Array, ArrayLike

try:
    import torch
except ImportError as missing:
    raise MissingExtraError("training", "torch", "train") from missing

from ..systems.torch_import import Maxout

__all__ = ["LEAK", "Maxout", "TrainingResult", "maxout_module", "torch", "train"]

LEAK = 0.01  # slope of the loss's clipping outside U: keeps a gradient where the output is cut off
BETAS = (0.9, 0.99)  # Adam's; a shorter memory of squares than its default fits these small networks better
LOSS_EVERY = 100  # steps between two entries of the history


def maxout_module(
    inputs: int,
    outputs: int,
    *,
    layers: int,
    width: int,
    pool: int | None,
    rng: np.random.Generator | int = 0,
) -> torch.nn.Sequential:
    """A maxout or ReLU network as torch modules, in double precision.

    Parameters
    ----------
    inputs, outputs : int
        n and m.
    layers, width : int
        l and w_i of Sec. II.A.
    pool : int or None
        p_i of Sec. II.A; None is a plain ReLU network, whose neurons are max(z, 0).
    rng : numpy.random.Generator or int
        Draws the weights; an int is the seed of torch's generator.

    Returns
    -------
    torch.nn.Sequential
        Linear and Maxout (or ReLU) in turn, and a last Linear.

    Raises
    ------
    ValueError
        If a size is not a whole number of at least 1 (`layers`: 0).

    See Also
    --------
    MaxoutNetwork.from_torch : Imports the module.

    Examples
    --------
    >>> [type(part).__name__ for part in maxout_module(2, 1, layers=1, width=3, pool=2)]
    ['Linear', 'Maxout', 'Linear']
    >>> [type(part).__name__ for part in maxout_module(2, 1, layers=1, width=3, pool=None)]
    ['Linear', 'ReLU', 'Linear']
    """
    layers = whole_number(layers, "layers", 0)
    width = whole_number(width, "width", 1)
    channels = 1 if pool is None else whole_number(pool, "pool", 1)
    seed = int(rng.integers(2**63)) if isinstance(rng, np.random.Generator) else whole_number(rng, "rng", 0)
    generator = torch.Generator().manual_seed(seed)
    parts: list[torch.nn.Module] = []
    size = whole_number(inputs, "inputs", 1)
    for _ in range(layers):
        neurons = torch.nn.ReLU() if pool is None else Maxout(channels)
        parts += [_linear(size, width * channels, generator), neurons]
        size = width
    return torch.nn.Sequential(*parts, _linear(size, whole_number(outputs, "outputs", 1), generator))


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """Result of `train`.

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
    history: Array

    def __repr__(self) -> str:
        return f"TrainingResult({self.network}, loss {self.loss:.6g})"


def train(
    states: ArrayLike,
    inputs: ArrayLike,
    *,
    layers: int,
    width: int,
    pool: int | None,
    lower: ArrayLike,
    upper: ArrayLike,
    rng: np.random.Generator | int = 0,
    steps: int = 6000,
    learning_rate: float = 0.01,
    progress: bool = False,
) -> TrainingResult:
    """Fit a maxout or ReLU network to states and inputs, by the mean squared error of its output clipped to U.

    Parameters
    ----------
    states : array (N, n)
    inputs : array (N, m)
    layers, width : int
        l and w_i of Sec. II.A.
    pool : int or None
        p_i of Sec. II.A; None trains a plain ReLU network. In the result its neurons have the two channels z and 0.
    lower, upper : array (m,) or float
        The input box U to which the network is saturated, in units of u.
    rng : numpy.random.Generator or int
        Draws the initial weights. The same seed gives the same network on the same machine with the
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
        If sizes do not match, or a number is out of its range.

    See Also
    --------
    DataSet : States and inputs from an optimal control problem.

    Notes
    -----
    Adam on all data at once. The loss is taken of the output clipped to U with a small slope outside,
    so that a state at which the output is cut off on the wrong side still pulls it back. States are
    scaled to [-1, 1] for the training, and the scaling is folded into the first layer. The global random
    generators of numpy and torch are not used.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.linspace(-1, 1, 21)[:, None]
    >>> result = train(x, np.abs(x), layers=1, width=2, pool=2, lower=0, upper=1, steps=300)
    >>> result.network
    MaxoutNetwork(1 -> [2x2, 1x2, 1x2] -> 1, 8 binaries)
    >>> result.loss < 0.1
    True
    >>> train(x, np.abs(x), layers=1, width=4, pool=None, lower=0, upper=1, steps=1).network
    MaxoutNetwork(1 -> [4x2, 1x2, 1x2] -> 1, 12 binaries)
    """
    states, inputs = real_array(states, "states", 2), real_array(inputs, "inputs", 2)
    if len(states) != len(inputs) or not len(states):
        raise ValueError(f"states has {len(states)} rows and inputs has {len(inputs)}; one input per state is needed")
    n, m = states.shape[1], inputs.shape[1]
    lower = real_array(np.broadcast_to(lower, m), "lower", 1)
    upper = real_array(np.broadcast_to(upper, m), "upper", 1)
    require_bools(progress=progress)
    steps, learning_rate = whole_number(steps, "steps", 0), positive_number(learning_rate, "learning_rate")
    centre, scale = _scaling(states)
    module = maxout_module(n, m, layers=layers, width=width, pool=pool, rng=rng)
    data = _Data(*(torch.tensor(value) for value in ((states - centre) / scale, inputs, lower, upper)))
    history = _descend(module, data, steps, learning_rate, progress)
    network = _unscale(MaxoutNetwork.from_torch(module), centre, scale).saturate(lower, upper)
    return TrainingResult(network, float(((network(states) - inputs) ** 2).mean()), np.array(history).reshape(-1, 2))


@dataclass(frozen=True, eq=False)
class _Data:
    """What the loss depends on: scaled states x (N, n), inputs u (N, m), and the box (m,) that clips outputs."""

    x: torch.Tensor
    u: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor


def _linear(inputs: int, outputs: int, generator: torch.Generator) -> torch.nn.Linear:
    """A Linear in double precision whose weights and biases are drawn from `generator` alone."""
    part = torch.nn.utils.skip_init(torch.nn.Linear, inputs, outputs, dtype=torch.float64)
    limit = 1 / math.sqrt(inputs)
    with torch.no_grad():
        part.weight.uniform_(-limit, limit, generator=generator)
        part.bias.uniform_(-limit, limit, generator=generator)
    return part


def _descend(
    module: torch.nn.Module, data: _Data, steps: int, learning_rate: float, progress: bool
) -> list[tuple[int, float]]:
    """Adam on the leaky clipped loss; returns the history."""
    optimizer = torch.optim.Adam(module.parameters(), lr=learning_rate, betas=BETAS, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, T_max=max(steps, 1))
    history = []
    for step in trange(steps, desc="training", unit="step", disable=not progress):
        optimizer.zero_grad()
        output = module(data.x)
        clipped = output.clamp(data.lower, data.upper)
        if step % LOSS_EVERY == 0:
            history.append((step, float(((clipped.detach() - data.u) ** 2).mean())))
        loss = ((clipped + LEAK * (output - clipped) - data.u) ** 2).mean()
        loss.backward()
        optimizer.step()
        schedule.step()
    return history


def _scaling(states: Array) -> tuple[Array, Array]:
    """Middle and half-width of the data along each axis; 1 in place of a half-width of 0."""
    lower, upper = states.min(axis=0), states.max(axis=0)
    half_width = (upper - lower) / 2
    return (lower + upper) / 2, np.where(half_width > 0, half_width, 1.0)


def _unscale(network: MaxoutNetwork, centre: Array, scale: Array) -> MaxoutNetwork:
    """The network x -> network((x - centre) / scale)."""
    first = network.hidden[0] if network.hidden else network
    weight = first.weight / scale
    bias = first.bias - weight @ centre
    if isinstance(first, MaxoutNetwork):
        return MaxoutNetwork((), weight, bias)
    return MaxoutNetwork((Layer(weight, bias, first.pool), *network.hidden[1:]), network.weight, network.bias)
