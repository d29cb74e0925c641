"""Import of torch modules: what is computed, what is refused, and what is left alone."""

import sys

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from torch.nn.utils import prune  # noqa: E402

from mireach import ClosedLoop, MaxoutNetwork, case_study  # noqa: E402
from mireach.learning.training import Maxout  # noqa: E402


def torch_cases():
    def linear(a, b, **options):
        return torch.nn.Linear(a, b, dtype=torch.float64, **options)

    nn = torch.nn
    return {
        "relu": nn.Sequential(linear(2, 5), nn.ReLU(), linear(5, 4), nn.ReLU(), linear(4, 2)),
        "leaky relu": nn.Sequential(linear(2, 5), nn.LeakyReLU(0.2), linear(5, 1)),
        "maxout": nn.Sequential(linear(3, 6), Maxout(3), linear(2, 4), Maxout(2), linear(2, 1)),
        "mixed": nn.Sequential(linear(2, 6), Maxout(2), linear(3, 3), nn.LeakyReLU(), linear(3, 2), nn.ReLU()),
        "nested": nn.Sequential(
            nn.Sequential(linear(2, 3), nn.Identity(), linear(3, 3, bias=False)), nn.Dropout(0.5), nn.ReLU()
        ),
        "ends with relu": nn.Sequential(linear(2, 3), nn.ReLU()),
        "two relus in a row": nn.Sequential(linear(2, 3), nn.ReLU(), nn.LeakyReLU(0.5), linear(3, 1)),
        "linear": linear(2, 3),
    }


@pytest.mark.parametrize(
    "name", ["relu", "leaky relu", "maxout", "mixed", "nested", "ends with relu", "two relus in a row", "linear"]
)
def test_imported_module_gives_what_torch_gives(name):
    module = torch_cases()[name].eval()
    net = MaxoutNetwork.from_torch(module)
    x = 3 * np.random.default_rng(0).normal(size=(200, net.input_size))
    with torch.no_grad():
        expected = module(torch.tensor(x)).numpy()
    np.testing.assert_allclose(net(x), expected, rtol=1e-12, atol=1e-12)


def test_modules_that_cannot_be_imported_are_named():
    nn = torch.nn
    with pytest.raises(ValueError, match="cannot import Tanh"):
        MaxoutNetwork.from_torch(nn.Sequential(nn.Linear(2, 2), nn.Tanh()))
    with pytest.raises(ValueError, match="ReLU comes before the first Linear"):
        MaxoutNetwork.from_torch(nn.Sequential(nn.ReLU(), nn.Linear(2, 2)))
    with pytest.raises(ValueError, match=r"negative_slope 1.5"):
        MaxoutNetwork.from_torch(nn.Sequential(nn.Linear(2, 2), nn.LeakyReLU(1.5)))
    with pytest.raises(ValueError, match="no Linear"):
        MaxoutNetwork.from_torch(nn.Sequential())
    with pytest.raises(ValueError, match="last size must be 3"):
        MaxoutNetwork.from_torch(nn.Sequential(nn.Linear(2, 3), nn.ReLU(), nn.Linear(4, 1)))
    broken = nn.Linear(2, 2)
    broken.weight.data[0, 1] = np.nan
    with pytest.raises(ValueError, match="must be finite"):
        MaxoutNetwork.from_torch(nn.Sequential(broken))


def strangers():
    """Modules that are not what the names of their classes say, and a word of the message that each must give."""
    nn = torch.nn

    class Linear(nn.Linear):
        def forward(self, z):
            return super().forward(2 * z)

    class ReLU(nn.Module):
        def forward(self, z):
            return -torch.relu(-z)

    class Own(Maxout):
        def forward(self, z):
            return -super().forward(-z)

    class Sequential(nn.Sequential):
        def forward(self, z):
            return super().forward(z) + 1

    class Net(nn.Module):
        def __init__(self):
            super().__init__()
            self.parts = nn.Sequential(nn.Linear(2, 2))

    def hooked(register):
        part = nn.Linear(2, 2)
        getattr(part, register)(lambda *given: 2 * given[-1] if register == "register_forward_hook" else None)
        return part

    replaced = nn.Linear(2, 2)
    replaced.forward = lambda z: 2 * z
    pruned, normed = nn.Linear(2, 2), nn.Linear(2, 2)
    prune.l1_unstructured(pruned, "weight", amount=1)
    torch.nn.utils.parametrizations.weight_norm(normed)
    complex_one = nn.Linear(2, 2, dtype=torch.complex64)
    tensor = nn.Linear(2, 2)
    del tensor.weight
    tensor.weight = torch.ones(2, 2)
    return nn, {
        "own Linear": (Linear(2, 2), "same name"),
        "own ReLU": (nn.Sequential(nn.Linear(2, 2), ReLU()), "same name"),
        "own Maxout": (nn.Sequential(nn.Linear(2, 2), Own(2)), "same name"),
        "own Sequential": (Sequential(nn.Linear(2, 2)), "same name"),
        "module around a Sequential": (Net(), "pass the Sequential"),
        "forward hook": (hooked("register_forward_hook"), "forward hooks"),
        "forward pre-hook": (hooked("register_forward_pre_hook"), "forward hooks"),
        "hook of the Sequential": (nn.Sequential(nn.Sequential(hooked("register_forward_hook"))), "forward hooks"),
        "own forward of one object": (replaced, "forward of Linear was replaced"),
        "pruned": (pruned, "prune.remove"),
        "weight norm": (normed, "parametrizations"),
        "complex": (complex_one, "complex64"),
        "weight that is no parameter": (tensor, "torch.nn.Parameter"),
        "meta": (nn.Linear(2, 2, device="meta"), "meta"),
        "compiled": (torch.compile(nn.Linear(2, 2)), "torch.compile"),
        "lazy": (nn.LazyLinear(2), "cannot import LazyLinear"),
        "relu6": (nn.Sequential(nn.Linear(2, 2), nn.ReLU6()), "cannot import ReLU6"),
        "flatten": (nn.Sequential(nn.Flatten(), nn.Linear(2, 2)), "cannot import Flatten"),
    }


def test_a_part_is_known_by_its_type_and_not_by_its_name():
    _, cases = strangers()
    for name, (module, word) in cases.items():
        with pytest.raises(ValueError) as error:
            MaxoutNetwork.from_torch(module)
        assert word in str(error.value), (name, str(error.value))


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_quantized_layers_are_refused():
    try:
        made = torch.ao.quantization.quantize_dynamic(torch.nn.Sequential(torch.nn.Linear(2, 2)), dtype=torch.qint8)
    except RuntimeError:
        pytest.skip("this PyTorch has no engine for quantized layers")
    with pytest.raises(ValueError, match="quantization"):
        MaxoutNetwork.from_torch(made)


def test_a_difference_that_no_type_shows_is_found_by_comparison(monkeypatch):
    torch.manual_seed(0)
    module = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.ReLU(), torch.nn.Linear(3, 1))
    assert MaxoutNetwork.from_torch(module).output_size == 1
    with monkeypatch.context() as patch:
        patch.setattr(torch.nn.ReLU, "forward", lambda self, z: torch.relu(z) + 1e-9)
        with pytest.raises(ValueError, match=r"but the module gives .* rounding explains"):
            MaxoutNetwork.from_torch(module)
    handle = torch.nn.modules.module.register_module_forward_hook(lambda part, given, output: output * (1 + 1e-12))
    try:
        with pytest.raises(ValueError, match="global hook"):
            MaxoutNetwork.from_torch(module)
    finally:
        handle.remove()


@pytest.mark.parametrize("size", [1e-300, 1e-150, 1e-8, 1.0, 1e8, 1e150, 1e300])
def test_comparison_allows_for_rounding_whatever_the_size_of_the_weights(size):
    nn, rng = torch.nn, np.random.default_rng(0)
    for dtype in (torch.float64, torch.float32):
        module = nn.Sequential(
            nn.Linear(3, 40), nn.Linear(40, 20), nn.LeakyReLU(0.3), nn.Linear(20, 30), nn.Linear(30, 1)
        )
        module = module.to(dtype)
        for part in module:
            if isinstance(part, nn.Linear):
                clipped = np.clip(size, *((1e-37, 1e37) if dtype is torch.float32 else (0, np.inf)))
                part.weight.data = torch.tensor(clipped * rng.normal(size=part.weight.shape), dtype=dtype)
        if size > 1:  # two Linear in a row whose product nearly cancels
            module[4].weight.data[0, 1] = -module[4].weight.data[0, 0] * (1 + 2**-20)
            module[3].weight.data[1] = module[3].weight.data[0] * (1 - 2**-20)
        try:
            MaxoutNetwork.from_torch(module)
        except ValueError as error:
            assert "must be finite" in str(error)  # products of weights overflow


def test_importing_leaves_the_module_and_the_random_numbers_alone():
    module = torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Dropout(0.5), torch.nn.ReLU()).train()
    before, state = {k: v.clone() for k, v in module.state_dict().items()}, torch.get_rng_state()
    np.random.seed(3)  # noqa: NPY002 - the old generator is what must be left alone
    old = np.random.get_state()[1].copy()  # noqa: NPY002
    MaxoutNetwork.from_torch(module)
    assert module.training and module[1].training and module[0].weight.dtype is torch.float32
    assert all(torch.equal(value, before[name]) for name, value in module.state_dict().items())
    assert torch.equal(torch.get_rng_state(), state) and (np.random.get_state()[1] == old).all()  # noqa: NPY002


@pytest.mark.parametrize("controller", [lambda x: -x, np.eye(2), "network.json", None])
def test_what_is_no_module_is_refused_with_what_to_give(controller):
    with pytest.raises(TypeError, match=r"(?s)a MaxoutNetwork or a torch module; got .* MaxoutNetwork\(\[Layer"):
        MaxoutNetwork.from_torch(controller)
    case = case_study("pwa")
    with pytest.raises(TypeError, match="a MaxoutNetwork or a torch module"):
        ClosedLoop(case.system, controller)


def test_without_torch_the_error_is_the_same(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(TypeError, match="a MaxoutNetwork or a torch module"):
        MaxoutNetwork.from_torch(np.tanh)
