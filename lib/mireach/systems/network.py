"""Maxout networks, eqs. (6), (8), NN, maxout of [Teichrib2025]; ReLU and leaky ReLU are special cases."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import real_array, require_columns, require_kind, whole_number
from ..errors import CorruptFileError
from ..files import read_json, write_json
from ..typing import Array, ArrayLike

FORMAT = "mireach-network/1"


@dataclass(frozen=True, eq=False, init=False)
class Layer:
    """One hidden layer q = g(W y + b): the l-th output is the largest of its `pool` channels, eq. (8), maxout.

    Parameters
    ----------
    weight : array (pool * w, w_previous)
        Rows pool * l, ..., pool * (l + 1) - 1 are the channels of neuron l (the paper's set A_l).
    bias : array (pool * w,)
    pool : int
        Channels per neuron, the paper's p_i.

    Raises
    ------
    ValueError
        If sizes do not match, an entry is not finite, or the rows do not divide into groups of `pool`.

    See Also
    --------
    MaxoutNetwork : Several layers and an affine output.

    Examples
    --------
    The absolute value max(x, -x) as one neuron:

    >>> from mireach import Layer
    >>> Layer([[1.0], [-1.0]], [0.0, 0.0], pool=2)
    Layer(1 -> 1x2)
    """

    weight: Array
    bias: Array
    pool: int

    def __init__(self, weight: ArrayLike, bias: ArrayLike, pool: int) -> None:
        weight, bias = real_array(weight, "weight", 2), real_array(bias, "bias", 1)
        if len(weight) != len(bias):
            raise ValueError(f"weight has {len(weight)} rows but bias has {len(bias)} entries")
        pool = whole_number(pool, "pool", 1)
        if not len(bias) or len(bias) % pool:
            raise ValueError(f"weight has {len(bias)} rows, which do not divide into groups of pool = {pool}")
        object.__setattr__(self, "weight", weight)
        object.__setattr__(self, "bias", bias)
        object.__setattr__(self, "pool", pool)

    def __repr__(self) -> str:
        return f"Layer({self.weight.shape[1]} -> {self.width}x{self.pool})"

    @property
    def width(self) -> int:
        """Neurons, the paper's w_i."""
        return len(self.bias) // self.pool

    def channels(self, y: Array) -> Array:
        """W y + b by neuron.

        Parameters
        ----------
        y : array (..., w_previous)
            Output of the layer before.

        Returns
        -------
        array (..., w, pool)
        """
        z = y @ self.weight.T + self.bias
        return z.reshape(*z.shape[:-1], self.width, self.pool)


@dataclass(frozen=True, eq=False, init=False)
class MaxoutNetwork:
    """Phi = f_(l+1) o g_l o f_l o ... o g_1 o f_1, eq. (6), NN.

    Parameters
    ----------
    hidden : sequence of Layer
        May be empty: an affine controller.
    weight : array (m, w_l)
    bias : array (m,)
        The affine output f_(l+1).

    Raises
    ------
    TypeError
        If `hidden` is not a sequence of Layer.
    ValueError
        If the sizes of consecutive layers do not match, or an entry is not finite.

    See Also
    --------
    MaxoutNetwork.from_torch : Imports a torch module.
    ClosedLoop : The network as the controller of a system.

    Examples
    --------
    Phi(x) = 1 - |x|:

    >>> from mireach import Layer, MaxoutNetwork
    >>> net = MaxoutNetwork([Layer([[1.0], [-1.0]], [0.0, 0.0], pool=2)], [[-1.0]], [1.0])
    >>> net
    MaxoutNetwork(1 -> [1x2] -> 1, 2 binaries)
    >>> net([[-2.0], [0.5]]).tolist()
    [[-1.0], [0.5]]
    """

    hidden: tuple[Layer, ...]
    weight: Array
    bias: Array

    def __init__(self, hidden: Sequence[Layer], weight: ArrayLike, bias: ArrayLike) -> None:
        require_kind(hidden, (list, tuple), "hidden")
        for number, layer in enumerate(hidden, start=1):
            require_kind(layer, Layer, f"hidden layer {number}")
        weight, bias = real_array(weight, "output weight", 2), real_array(bias, "output bias", 1)
        if len(weight) != len(bias):
            raise ValueError(f"output weight has {len(weight)} rows but output bias {len(bias)} entries")
        for number, (layer, after) in enumerate(pairwise(hidden), start=2):
            require_columns(after.weight, layer.width, f"weight of hidden layer {number}", "the neurons before it")
        if hidden:
            require_columns(weight, hidden[-1].width, "output weight", "the neurons before it")
        object.__setattr__(self, "hidden", tuple(hidden))
        object.__setattr__(self, "weight", weight)
        object.__setattr__(self, "bias", bias)

    def __repr__(self) -> str:
        shape = ", ".join(f"{layer.width}x{layer.pool}" for layer in self.hidden)
        return f"MaxoutNetwork({self.input_size} -> [{shape}] -> {self.output_size}, {self.binaries} binaries)"

    def __call__(self, x: ArrayLike) -> Array:
        """Phi(x).

        Parameters
        ----------
        x : array (n,) or (N, n)

        Returns
        -------
        array (m,) or (N, m)

        Raises
        ------
        ValueError
            If x does not have n columns.
        """
        y = np.asarray(x, float)
        require_columns(y, self.input_size, "x", "the network's inputs")
        for layer in self.hidden:
            y = layer.channels(y).max(axis=-1)
        return y @ self.weight.T + self.bias

    @property
    def input_size(self) -> int:
        """n, the number of inputs."""
        return (self.hidden[0].weight if self.hidden else self.weight).shape[1]

    @property
    def output_size(self) -> int:
        """m, the number of outputs."""
        return len(self.bias)

    @property
    def binaries(self) -> int:
        """Binary variables of eq. (9), MI_Constraints_NN: the sum of p_i w_i over the hidden layers."""
        return sum(len(layer.bias) for layer in self.hidden)

    def affine_piece(self, x: ArrayLike) -> tuple[Array, Array]:
        """K (m, n) and g (m,) with Phi = K x + g on the piece of x (the first winner where channels tie).

        Parameters
        ----------
        x : array (n,)

        Examples
        --------
        >>> from mireach import Layer, MaxoutNetwork
        >>> K, g = MaxoutNetwork([Layer([[1.0], [-1.0]], [0.0, 0.0], pool=2)], [[-1.0]], [1.0]).affine_piece([3.0])
        >>> K.tolist(), g.tolist()
        ([[-1.0]], [1.0])
        """
        K, g = np.eye(self.input_size), np.zeros(self.input_size)
        for layer in self.hidden:
            winner = layer.channels(K @ np.asarray(x, float) + g).argmax(axis=-1)
            rows = np.arange(layer.width) * layer.pool + winner
            K, g = layer.weight[rows] @ K, layer.weight[rows] @ g + layer.bias[rows]
        return self.weight @ K, self.weight @ g + self.bias

    # -- new networks -----------------------------------------------------------------------------

    def saturate(self, lower: ArrayLike, upper: ArrayLike) -> "MaxoutNetwork":
        """The network whose output is projected onto the box [lower, upper], exactly.

        Two maxout layers with two channels per neuron are added, v = max(z, lower) and
        y = max(-v, -upper), and the output is -y = min(max(z, lower), upper). Their weights are 0, 1
        and -1, so that no rounding moves an output out of the box.

        Parameters
        ----------
        lower, upper : array (m,) or float
            In units of u.

        Returns
        -------
        MaxoutNetwork

        Raises
        ------
        ValueError
            If sizes do not match or lower > upper somewhere.

        Examples
        --------
        >>> from mireach import MaxoutNetwork
        >>> MaxoutNetwork([], [[2.0]], [0.0]).saturate(-1, 1)([[0.25], [3.0]]).tolist()
        [[0.5], [1.0]]
        """
        m = self.output_size
        lower, upper = _per_output(lower, "lower", m), _per_output(upper, "upper", m)
        if (lower > upper).any():
            raise ValueError(f"lower must not exceed upper; got {lower} and {upper}")
        raise_up = Layer(
            np.stack([self.weight, np.zeros_like(self.weight)], axis=1).reshape(2 * m, -1),
            np.stack([self.bias, lower], axis=1).ravel(),
            pool=2,
        )
        cut_off = Layer(
            np.stack([-np.eye(m), np.zeros((m, m))], axis=1).reshape(2 * m, m) + 0.0,
            np.stack([np.zeros(m), -upper], axis=1).ravel() + 0.0,
            pool=2,
        )
        return MaxoutNetwork((*self.hidden, raise_up, cut_off), -np.eye(m) + 0.0, np.zeros(m))

    @staticmethod
    def from_torch(module: Any) -> "MaxoutNetwork":
        """Import a torch.nn.Sequential of Linear, ReLU, LeakyReLU and this package's Maxout.

        ReLU is the maxout of (z, 0), leaky ReLU that of (z, s z). Nested Sequentials, Identity, Dropout and several
        Linear in a row are understood. Dropout is skipped, as torch does in evaluation, also if the module is in
        training mode.

        Parameters
        ----------
        module : torch.nn.Module
            Weights are taken as they are, in double precision.

        Returns
        -------
        MaxoutNetwork

        Raises
        ------
        TypeError
            If the module is not a torch module.
        ValueError
            If a part is not exactly of one of these types (a subclass may compute
            something else), a part has hooks or its own forward, the sequence does not begin with Linear, or
            the network differs from the module at random inputs by more than rounding explains.

        Notes
        -----
        The comparison runs a copy of the module in double precision and evaluation mode, at inputs of several sizes.

        Examples
        --------
        >>> import torch
        >>> from mireach import MaxoutNetwork
        >>> MaxoutNetwork.from_torch(torch.nn.Sequential(torch.nn.Linear(2, 5), torch.nn.ReLU(), torch.nn.Linear(5, 1)))
        MaxoutNetwork(2 -> [5x2] -> 1, 10 binaries)
        """
        torch = sys.modules.get("torch")  # whoever has a torch module has imported torch
        if torch is None or not isinstance(module, torch.nn.Module):
            raise TypeError(
                f"the network must be a MaxoutNetwork or a torch module; got {type(module).__name__} {module!r:.60}. "
                "A function cannot be imported: give its weights, as MaxoutNetwork([Layer(weight, bias, pool), ...], "
                "weight, bias), or train a network on its values by mireach.learning.training.train"
            )
        from .torch_import import import_module

        return import_module(module)

    # -- files ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """The network as written to network.json (format mireach-network/1)."""
        return {
            "format": FORMAT,
            "hidden": [
                {"weight": layer.weight.tolist(), "bias": layer.bias.tolist(), "pool": layer.pool}
                for layer in self.hidden
            ],
            "output": {"weight": self.weight.tolist(), "bias": self.bias.tolist()},
        }

    @staticmethod
    def from_dict(value: Mapping[str, Any]) -> "MaxoutNetwork":
        """Inverse of `to_dict`.

        Raises
        ------
        ValueError
            If a key is missing, or the sizes or numbers are not those of a network.

        Examples
        --------
        >>> from mireach import MaxoutNetwork
        >>> MaxoutNetwork.from_dict(MaxoutNetwork([], [[2.0, 0.1]], [0.0]).to_dict()).weight.tolist()
        [[2.0, 0.1]]
        """
        try:
            hidden = [Layer(part["weight"], part["bias"], part["pool"]) for part in value["hidden"]]
            return MaxoutNetwork(hidden, value["output"]["weight"], value["output"]["bias"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"{type(error).__name__}: {error}") from error

    def save(self, path: str | Path) -> None:
        """Write the network as JSON that reads back to the same floats."""
        write_json(path, self.to_dict())

    @staticmethod
    def load(path: str | Path) -> "MaxoutNetwork":
        """Read a network that `save` wrote.

        Raises
        ------
        CorruptFileError
            If the file is truncated, of another format, or holds sizes or numbers that no network has.
        """
        value = read_json(path, FORMAT)
        try:
            return MaxoutNetwork.from_dict(value)
        except ValueError as error:
            raise CorruptFileError(f"{path} holds no network: {error}") from error


def _per_output(limit: ArrayLike, name: str, count: int) -> Array:
    """A number, or an array of one number per output, as an array (count,)."""
    limit = real_array(limit, name, np.ndim(limit))
    if limit.shape not in ((), (count,)):
        raise ValueError(f"{name} has shape {limit.shape}, but the network has {count} outputs; give one number each")
    return np.broadcast_to(limit, count)
