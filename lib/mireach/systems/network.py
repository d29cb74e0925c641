"""Maxout networks (eqs. NN and maxout of [Teichrib2025]); ReLU and leaky ReLU are special cases."""

import sys
from copy import deepcopy
from dataclasses import dataclass

import numpy as np

from ..checks import real_array, require_columns, require_kind, whole_number
from ..errors import CorruptFileError
from ..files import read_json, write_json

FORMAT = "mireach-network/1"
COMPARED_SIZES = (1e-3, 1.0, 1e3, 1e6)  # of the inputs at which an imported network is compared with its module
COMPARED_POINTS = 50  # inputs of each size
UNDERFLOW = 1e-290  # times the machine epsilon, more than the smallest normal number: what underflow may cut off


@dataclass(frozen=True, eq=False)
class Layer:
    """One hidden layer q = g(W y + b): the l-th output is the largest of its `pool` channels (eq. maxout).

    Parameters
    ----------
    weight : array (pool * w, w_previous)
        Rows pool * l, ..., pool * (l + 1) - 1 are the channels of neuron l (the paper's set A_l).
    bias : array (pool * w,)
    pool : int
        Channels a neuron, the paper's p_i.
    """

    weight: np.ndarray
    bias: np.ndarray
    pool: int

    def __post_init__(self):
        object.__setattr__(self, "weight", real_array(self.weight, "weight", 2))
        object.__setattr__(self, "bias", real_array(self.bias, "bias", 1))
        if len(self.weight) != len(self.bias):
            raise ValueError(f"weight has {len(self.weight)} rows but bias has {len(self.bias)} entries")
        object.__setattr__(self, "pool", whole_number(self.pool, "pool", 1))
        if not len(self.bias) or len(self.bias) % self.pool:
            raise ValueError(f"weight has {len(self.bias)} rows, which do not divide into groups of pool = {self.pool}")

    @property
    def width(self):
        """Neurons, the paper's w_i."""
        return len(self.bias) // self.pool

    def channels(self, y):
        """W y + b by neuron: (..., w_previous) -> (..., w, pool)."""
        z = y @ self.weight.T + self.bias
        return z.reshape(*z.shape[:-1], self.width, self.pool)


@dataclass(frozen=True, eq=False)
class MaxoutNetwork:
    """Phi = f_(l+1) o g_l o f_l o ... o g_1 o f_1 (eq. NN).

    Parameters
    ----------
    hidden : sequence of Layer
        May be empty: an affine controller.
    weight : array (m, w_l)
    bias : array (m,)
        The affine output f_(l+1).

    Raises
    ------
    ValueError
        If the sizes of consecutive layers do not match, or an entry is not finite.
    """

    hidden: tuple
    weight: np.ndarray
    bias: np.ndarray

    def __post_init__(self):
        require_kind(self.hidden, (list, tuple), "hidden")
        for number, layer in enumerate(self.hidden, start=1):
            require_kind(layer, Layer, f"hidden layer {number}")
        object.__setattr__(self, "hidden", tuple(self.hidden))
        object.__setattr__(self, "weight", real_array(self.weight, "output weight", 2))
        object.__setattr__(self, "bias", real_array(self.bias, "output bias", 1))
        if len(self.weight) != len(self.bias):
            raise ValueError(f"output weight has {len(self.weight)} rows but output bias {len(self.bias)} entries")
        for number, (layer, after) in enumerate(zip(self.hidden, self.hidden[1:]), start=2):
            require_columns(after.weight, layer.width, f"weight of hidden layer {number}", "the neurons before it")
        if self.hidden:
            require_columns(self.weight, self.hidden[-1].width, "output weight", "the neurons before it")

    def __repr__(self):
        shape = ", ".join(f"{layer.width}x{layer.pool}" for layer in self.hidden)
        return f"MaxoutNetwork({self.input_size} -> [{shape}] -> {self.output_size}, {self.binaries} binaries)"

    def __call__(self, x):
        """Phi(x).

        Parameters
        ----------
        x : array (n,) or (N, n)

        Returns
        -------
        array (m,) or (N, m)
        """
        y = np.asarray(x, float)
        require_columns(y, self.input_size, "x", "the network's inputs")
        for layer in self.hidden:
            y = layer.channels(y).max(axis=-1)
        return y @ self.weight.T + self.bias

    @property
    def input_size(self):
        """n, the number of inputs."""
        return (self.hidden[0].weight if self.hidden else self.weight).shape[1]

    @property
    def output_size(self):
        """m, the number of outputs."""
        return len(self.bias)

    @property
    def binaries(self):
        """Binary variables of eq. MI_Constraints_NN: the sum of p_i w_i over the hidden layers."""
        return sum(len(layer.bias) for layer in self.hidden)

    def affine_piece(self, x):
        """K (m, n) and g (m,) with Phi = K x + g on the piece of x (the first winner where channels tie)."""
        K, g = np.eye(self.input_size), np.zeros(self.input_size)
        for layer in self.hidden:
            winner = layer.channels(K @ np.asarray(x, float) + g).argmax(axis=-1)
            rows = np.arange(layer.width) * layer.pool + winner
            K, g = layer.weight[rows] @ K, layer.weight[rows] @ g + layer.bias[rows]
        return self.weight @ K, self.weight @ g + self.bias

    # -- new networks -----------------------------------------------------------------------------

    def saturate(self, lower, upper):
        """The network whose output is projected onto the box [lower, upper], exactly.

        Two maxout layers with two channels a neuron are added, v = max(z, lower) and
        y = max(-v, -upper), and the output is -y = min(max(z, lower), upper). Their weights are 0, 1
        and -1, so that no rounding moves an output out of the box.

        Parameters
        ----------
        lower, upper : array (m,) or float

        Raises
        ------
        ValueError
            If lower > upper somewhere.
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
    def from_torch(module):
        """Import a torch.nn.Sequential of Linear, ReLU, LeakyReLU and this package's Maxout.

        ReLU is the maxout of (z, 0), leaky ReLU that of (z, s z). Nested Sequentials, Identity, Dropout and several
        Linear in a row are understood. Dropout is skipped, as torch does in evaluation, also if the module is in
        training mode.

        Parameters
        ----------
        module : torch.nn.Module
            Weights are taken as they are, in double precision.

        Raises
        ------
        ValueError
            If the module is not a torch module, a part is not exactly of one of these types (a subclass may compute
            something else), a part has hooks or its own forward, the sequence does not begin with Linear, or
            the network differs from the module at random inputs by more than rounding explains.

        Notes
        -----
        The comparison runs a copy of the module in double precision and evaluation mode, at inputs of several sizes.
        """
        torch = sys.modules.get("torch")  # whoever has a torch module has imported torch
        if torch is None or not isinstance(module, torch.nn.Module):
            raise ValueError(
                f"the network must be a MaxoutNetwork or a torch module; got {type(module).__name__} {module!r:.60}. "
                "A function cannot be imported: give its weights, as MaxoutNetwork([Layer(weight, bias, pool), ...], "
                "weight, bias), or train a network on its values by mireach.learning.training.train"
            )
        from ..learning.training import Maxout

        nn = torch.nn
        parts = _flatten(module, nn.Sequential, (nn.Linear, nn.ReLU, nn.LeakyReLU, Maxout, nn.Identity, nn.Dropout))
        hidden, weight, bias = [], None, None
        for part in parts:
            kind = type(part)
            if kind in (nn.Identity, nn.Dropout):
                continue
            if kind is nn.Linear:
                W, b = _linear(part, torch)
                if weight is None:
                    weight, bias = W, b
                else:
                    require_columns(W, len(weight), f"weight of {part}", "the values before it")
                    with np.errstate(over="ignore", invalid="ignore"):  # Layer refuses what is not finite
                        weight, bias = W @ weight, W @ bias + b
                continue
            if weight is None:
                raise ValueError(f"{kind.__name__} comes before the first Linear; begin with torch.nn.Linear")
            if kind is Maxout:
                hidden.append(Layer(weight, bias, part.pool))
            else:
                slope = 0.0 if kind is nn.ReLU else float(part.negative_slope)
                if not 0 <= slope <= 1:
                    raise ValueError(f"LeakyReLU has negative_slope {slope}; only 0 to 1 is a maximum of (z, s z)")
                pair = np.stack([weight, slope * weight], axis=1).reshape(-1, weight.shape[1])
                hidden.append(Layer(pair, np.stack([bias, slope * bias], axis=1).ravel(), pool=2))
            weight, bias = np.eye(hidden[-1].width), np.zeros(hidden[-1].width)
        if weight is None:
            raise ValueError("the module holds no Linear layer, so it has no weights to import")
        network = MaxoutNetwork(hidden, weight, bias)
        _compare(network, module, parts, torch)
        return network

    # -- files ------------------------------------------------------------------------------------

    def to_dict(self):
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
    def from_dict(value):
        """Inverse of `to_dict`.

        Raises
        ------
        ValueError
            If the dict holds sizes or numbers that no network has, or lacks a key.
        """
        try:
            hidden = [Layer(part["weight"], part["bias"], part["pool"]) for part in value["hidden"]]
            return MaxoutNetwork(hidden, value["output"]["weight"], value["output"]["bias"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"{type(error).__name__}: {error}") from error

    def save(self, path):
        """Write the network as JSON that reads back to the same floats."""
        write_json(path, self.to_dict())

    @staticmethod
    def load(path):
        """Read a network that `save` wrote.

        Raises
        ------
        CorruptFileError
            If the file is truncated, of another format, or holds sizes or numbers no network has.
        """
        value = read_json(path, FORMAT)
        try:
            return MaxoutNetwork.from_dict(value)
        except ValueError as error:
            raise CorruptFileError(f"{path} holds no network: {error}") from error


def _per_output(limit, name, count):
    """A number, or an array of one number an output, as an array (count,)."""
    limit = real_array(limit, name, np.ndim(limit))
    if limit.shape not in ((), (count,)):
        raise ValueError(f"{name} has shape {limit.shape}, but the network has {count} outputs; give one number each")
    return np.broadcast_to(limit, count)


def _flatten(module, sequential, kinds):
    """The parts of nested Sequentials, in order, each exactly of one of `kinds` and as its class made it.

    Raises
    ------
    ValueError
        If a part is of another type, or has hooks or a forward of its own, which may change what it computes.
    """
    kind = type(module)
    if kind not in (sequential, *kinds):
        raise ValueError(
            f"cannot import {kind.__name__} ({kind.__module__}.{kind.__qualname__}): use Linear, ReLU, LeakyReLU, "
            "Dropout or Identity of torch.nn and mireach.learning.training.Maxout in a torch.nn.Sequential. A subclass "
            "or a class of the same name may compute something else. Remove parametrizations, quantization and "
            "wrappers such as torch.compile first, and pass the Sequential instead of a module that holds it"
        )
    if module._forward_hooks or module._forward_pre_hooks:
        raise ValueError(
            f"{kind.__name__} has forward hooks, which may change its output; remove them (a weight norm by "
            "torch.nn.utils.remove_weight_norm, pruning by torch.nn.utils.prune.remove) and import it again"
        )
    if "forward" in vars(module):
        raise ValueError(f"forward of {kind.__name__} was replaced; import a module with the forward of its class")
    if kind is not sequential:
        return [module]
    return [part for child in module for part in _flatten(child, sequential, kinds)]


def _linear(part, torch):
    """Weight and bias of a torch Linear as float64 arrays."""
    arrays = []
    for name, ndim in (("weight", 2), ("bias", 1)):
        value = getattr(part, name)
        if name == "bias" and value is None:
            arrays.append(np.zeros(len(arrays[0])))
            continue
        plain = type(value) is torch.nn.Parameter and value.layout is torch.strided and not value.is_meta
        if not plain or not value.is_floating_point():
            what = f"{type(value).__name__} of {getattr(value, 'dtype', 'no dtype')}"
            raise ValueError(
                f"{name} of {part} must be a dense torch.nn.Parameter of floating-point numbers; got a {what}. Give it "
                "the plain values (dequantized, dense, real, not on the meta device)"
            )
        arrays.append(real_array(value.detach().cpu().double().numpy(), f"{name} of {part}", ndim))
    return arrays


def _compare(network, module, parts, torch):
    """Raise ValueError if the network and the module differ at random inputs by more than rounding explains."""
    copy = deepcopy(module).cpu().double().eval()
    rng = np.random.default_rng(0)
    sizes = np.repeat([0.0, *COMPARED_SIZES], COMPARED_POINTS)
    x = sizes[:, None] * rng.normal(size=(len(sizes), network.input_size))
    with torch.no_grad():
        there = copy(torch.tensor(x)).numpy()
    if there.shape != (len(x), network.output_size):
        raise ValueError(
            f"the module gives shape {there.shape} for {len(x)} inputs, not {network.output_size} numbers each"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        here, limit = network(x), _rounding(parts, x, torch)
        wrong = ~(np.abs(here - there) <= limit) & np.isfinite(limit)
    if wrong.any():
        point = np.flatnonzero(wrong.any(axis=-1))[0]
        raise ValueError(
            f"the imported network gives {here[point].tolist()} at x = {x[point].tolist()}, but the module gives "
            f"{there[point].tolist()}; rounding explains {limit[point].max():.2g}. Something changes what the module "
            "computes, such as a global hook or a replaced class method; remove it"
        )


def _rounding(parts, x, torch):
    """How far two evaluations of the parts at x (N, n) may differ by rounding: array (N, m).

    Either has an error of at most about (operations) eps |W_k| (... (|W_1| |x| + |b_1|) ...) + |b_k|.
    """
    from ..learning.training import Maxout

    size, operations = np.abs(x), 8
    for part in parts:
        if type(part) is torch.nn.Linear:
            W, b = _linear(part, torch)
            size = (size + UNDERFLOW) @ np.abs(W).T + np.abs(b)
            operations += 2 * (W.shape[1] + 2)
        elif type(part) is Maxout:
            size = size.reshape(len(size), -1, part.pool).max(axis=-1)
    return operations * np.finfo(float).eps * (size + UNDERFLOW)
