"""Import of torch modules as maxout networks, and the maxout activation as a torch module.

`MaxoutNetwork.from_torch` loads this file when it is given a torch module; nothing else of the package needs torch,
but for `learning.training`.
"""

from collections.abc import Iterable
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from torch import nn

from ..checks import real_array, require_columns
from ..tolerances import SMALL_PRODUCTS
from ..typing import Array
from .network import Layer, MaxoutNetwork

COMPARED_SIZES = (1e-3, 1.0, 1e3, 1e6)  # of the inputs at which an imported network is compared with its module
COMPARED_POINTS = 50  # inputs of each size


class Maxout(nn.Module):
    """The largest of each group of `pool` consecutive values, eq. (8), maxout; follows a Linear.

    Parameters
    ----------
    pool : int
        Values per group, the paper's p_i.

    Examples
    --------
    >>> import torch
    >>> from mireach.learning.training import Maxout
    >>> Maxout(2)(torch.tensor([1.0, 3.0, -2.0, -5.0])).tolist()
    [3.0, -2.0]
    """

    def __init__(self, pool: int) -> None:
        super().__init__()
        self.pool = pool

    def forward(self, z: torch.Tensor) -> torch.Tensor:
        """(..., w pool) -> (..., w)."""
        return z.unflatten(-1, (-1, self.pool)).amax(dim=-1)

    def extra_repr(self) -> str:
        """What torch prints between the brackets."""
        return f"pool={self.pool}"


KINDS = (nn.Linear, nn.ReLU, nn.LeakyReLU, Maxout, nn.Identity, nn.Dropout)  # the parts that can be imported


def import_module(module: nn.Module) -> MaxoutNetwork:
    """The network that a torch module computes; see `MaxoutNetwork.from_torch`."""
    parts = _flatten(module)
    hidden: list[Layer] = []
    weight: Array | None = None
    bias = np.zeros(0)
    for part in parts:
        if isinstance(part, (nn.Identity, nn.Dropout)):
            continue
        if isinstance(part, nn.Linear):
            W, b = _linear(part)
            if weight is None:
                weight, bias = W, b
            else:
                require_columns(W, len(weight), f"weight of {part}", "the values before it")
                with np.errstate(over="ignore", invalid="ignore"):  # Layer refuses what is not finite
                    weight, bias = W @ weight, W @ bias + b
            continue
        if weight is None:
            raise ValueError(f"{type(part).__name__} comes before the first Linear; begin with torch.nn.Linear")
        hidden.append(_activation(part, weight, bias))
        weight, bias = np.eye(hidden[-1].width), np.zeros(hidden[-1].width)
    if weight is None:
        raise ValueError("the module holds no Linear layer, so it has no weights to import")
    network = MaxoutNetwork(hidden, weight, bias)
    _compare(network, module, parts)
    return network


def _activation(part: Any, weight: Array, bias: Array) -> Layer:
    """The maxout layer of an affine map and a Maxout, ReLU or LeakyReLU after it."""
    if isinstance(part, Maxout):
        return Layer(weight, bias, part.pool)
    slope = 0.0 if isinstance(part, nn.ReLU) else float(part.negative_slope)
    if not 0 <= slope <= 1:
        raise ValueError(f"LeakyReLU has negative_slope {slope}; only 0 to 1 is a maximum of (z, s z)")
    pair = np.stack([weight, slope * weight], axis=1).reshape(-1, weight.shape[1])
    return Layer(pair, np.stack([bias, slope * bias], axis=1).ravel(), pool=2)


def _flatten(module: nn.Module) -> list[nn.Module]:
    """The parts of nested Sequentials, in order, each exactly of one of `KINDS` and as its class made it.

    Raises
    ------
    ValueError
        If a part is of another type, or has hooks or a forward of its own, which may change what it computes.
    """
    kind = type(module)
    if kind not in (nn.Sequential, *KINDS):
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
    if not isinstance(module, nn.Sequential):
        return [module]
    return [part for child in module for part in _flatten(child)]


def _linear(part: nn.Linear) -> tuple[Array, Array]:
    """Weight and bias of a torch Linear as float64 arrays."""
    weight = _plain(part, "weight", 2)
    return weight, np.zeros(len(weight)) if part.bias is None else _plain(part, "bias", 1)


def _plain(part: nn.Linear, name: str, ndim: int) -> Array:
    """A parameter of a torch Linear as a float64 array; ValueError if it is not dense or not of floats."""
    value = getattr(part, name)
    plain = type(value) is nn.Parameter and value.layout is torch.strided and not value.is_meta
    if not plain or not value.is_floating_point():
        what = f"{type(value).__name__} of {getattr(value, 'dtype', 'no dtype')}"
        raise ValueError(
            f"{name} of {part} must be a dense torch.nn.Parameter of floating-point numbers; got a {what}. Give it "
            "the plain values (dequantized, dense, real, not on the meta device)"
        )
    return real_array(value.detach().cpu().double().numpy(), f"{name} of {part}", ndim)


def _compare(network: MaxoutNetwork, module: nn.Module, parts: Iterable[nn.Module]) -> None:
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
        here, limit = network(x), _rounding(parts, x)
        wrong = ~(np.abs(here - there) <= limit) & np.isfinite(limit)
    if wrong.any():
        point = np.flatnonzero(wrong.any(axis=-1))[0]
        raise ValueError(
            f"the imported network gives {here[point].tolist()} at x = {x[point].tolist()}, but the module gives "
            f"{there[point].tolist()}; rounding explains {limit[point].max():.2g}. Something changes what the module "
            "computes, such as a global hook or a replaced class method; remove it"
        )


def _rounding(parts: Iterable[nn.Module], x: Array) -> Array:
    """How far two evaluations of the parts at x (N, n) may differ by rounding: array (N, m).

    Either has an error of at most about (operations) eps |W_k| (... (|W_1| |x| + |b_1|) ...) + |b_k|.
    """
    size, operations = np.abs(x), 8
    for part in parts:
        if isinstance(part, nn.Linear):
            W, b = _linear(part)
            size = (size + SMALL_PRODUCTS) @ np.abs(W).T + np.abs(b)
            operations += 2 * (W.shape[1] + 2)
        elif isinstance(part, Maxout):
            size = size.reshape(len(size), -1, part.pool).max(axis=-1)
    return operations * np.finfo(float).eps * (size + SMALL_PRODUCTS)
