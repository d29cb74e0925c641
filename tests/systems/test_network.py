"""Maxout networks against a neuron-by-neuron evaluation and against torch."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import evaluate, random_network

from mireach import ClosedLoop, Layer, MaxoutNetwork, case_study
from mireach.errors import CorruptFileError


@st.composite
def networks(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    n, m, layers, width, pool = (draw(st.integers(1, 3)) for _ in range(5))
    return random_network(rng, n, m, layers - 1, width, pool), rng


# -- evaluation ---------------------------------------------------------------------------------------


@given(networks())
def test_network_is_what_the_definition_says(pair):
    net, rng = pair
    x = 3 * rng.normal(size=(20, net.input_size))
    expected = np.array([evaluate(net, row) for row in x])
    np.testing.assert_allclose(net(x), expected, atol=1e-12)
    np.testing.assert_allclose(net(x[0]), expected[0], atol=1e-12)
    assert net(x).shape == (20, net.output_size) and net(x[0]).shape == (net.output_size,)
    assert net.binaries == sum(len(layer.weight) for layer in net.hidden)


@given(networks())
def test_affine_piece_is_the_network_at_its_point_and_around_it(pair):
    net, rng = pair
    for x in 3 * rng.normal(size=(5, net.input_size)):
        K, g = net.affine_piece(x)
        near = x + 1e-9 * rng.normal(size=(5, net.input_size))
        np.testing.assert_allclose(near @ K.T + g, [evaluate(net, row) for row in near], atol=1e-7)
        np.testing.assert_allclose(K @ x + g, evaluate(net, x), atol=1e-11)


def test_affine_piece_of_a_tie_still_gives_the_value():
    net = MaxoutNetwork([Layer([[1.0, 0], [0, 1], [0.5, 0.5]], [0, 0, 0], 3)], [[2.0]], [1.0])
    K, g = net.affine_piece([0.25, 0.25])
    assert K @ [0.25, 0.25] + g == [1.5] and K.tolist() == [[2, 0]]


@given(networks(), st.floats(-1, 0.5), st.floats(0, 2))
def test_saturation_is_clip_and_no_rounding_leaves_the_box(pair, lower, width):
    net, rng = pair
    m, upper = net.output_size, lower + width
    x = 5 * rng.normal(size=(50, net.input_size))
    limited = net.saturate(lower, upper)
    y, z = limited(x), net(x)
    assert (y >= lower).all() and (y <= upper).all()
    assert (y[z > upper + 1e-9] == upper).all() and (y[z < lower - 1e-9] == lower).all()
    np.testing.assert_allclose(y, np.clip(z, lower, upper), rtol=0, atol=1e-12)
    assert limited.binaries == net.binaries + 4 * m
    np.testing.assert_array_equal(net.saturate(np.full(m, lower), np.full(m, upper))(x), limited(x))


# -- torch --------------------------------------------------------------------------------------------


def torch_cases():
    torch = pytest.importorskip("torch")
    from mireach.learning.training import Maxout

    def linear(a, b, **options):
        return torch.nn.Linear(a, b, dtype=torch.float64, **options)

    nn = torch.nn
    return torch, {
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
    torch, cases = torch_cases()
    module = cases[name].eval()
    net = MaxoutNetwork.from_torch(module)
    x = 3 * np.random.default_rng(0).normal(size=(200, net.input_size))
    with torch.no_grad():
        expected = module(torch.tensor(x)).numpy()
    np.testing.assert_allclose(net(x), expected, rtol=1e-12, atol=1e-12)


def test_modules_that_cannot_be_imported_are_named():
    torch = pytest.importorskip("torch")
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
    torch = pytest.importorskip("torch")
    from torch.nn.utils import prune

    from mireach.learning.training import Maxout as Ours

    nn = torch.nn

    class Linear(nn.Linear):
        def forward(self, z):
            return super().forward(2 * z)

    class ReLU(nn.Module):
        def forward(self, z):
            return -torch.relu(-z)

    class Maxout(Ours):
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
        "own Maxout": (nn.Sequential(nn.Linear(2, 2), Maxout(2)), "same name"),
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
    torch = pytest.importorskip("torch")
    try:
        made = torch.ao.quantization.quantize_dynamic(torch.nn.Sequential(torch.nn.Linear(2, 2)), dtype=torch.qint8)
    except RuntimeError:
        pytest.skip("this PyTorch has no engine for quantized layers")
    with pytest.raises(ValueError, match="quantization"):
        MaxoutNetwork.from_torch(made)


def test_a_difference_that_no_type_shows_is_found_by_comparison(monkeypatch):
    torch = pytest.importorskip("torch")
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
    torch = pytest.importorskip("torch")
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
    torch = pytest.importorskip("torch")
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


# -- files --------------------------------------------------------------------------------------------


@given(networks())
def test_network_reads_back_to_the_same_bits(tmp_path_factory, pair):
    net, _ = pair
    path = tmp_path_factory.mktemp("net") / "network.json"
    net.save(path)
    again = MaxoutNetwork.load(path)
    for first, second in zip((*net.hidden, net), (*again.hidden, again), strict=True):
        assert first.weight.tobytes() == second.weight.tobytes() and first.bias.tobytes() == second.bias.tobytes()
    assert [layer.pool for layer in again.hidden] == [layer.pool for layer in net.hidden]
    assert json.loads(path.read_text())["format"] == "mireach-network/1"


def damage(value, *keys, to):
    """The value with one entry replaced, or removed if `to` is None."""
    value = json.loads(json.dumps(value))
    part = value
    for key in keys[:-1]:
        part = part[key]
    if to is None:
        del part[keys[-1]]
    else:
        part[keys[-1]] = to
    return value


@pytest.mark.parametrize(
    ("keys", "to"),
    [
        (("format",), "mireach-network/2"),
        (("hidden",), None),
        (("hidden",), 5),
        (("hidden", 0), "layer"),
        (("hidden", 0, "pool"), 0),
        (("hidden", 0, "pool"), 3),
        (("hidden", 0, "pool"), "two"),
        (("hidden", 0, "pool"), 1.5),
        (("hidden", 0, "pool"), float("inf")),
        (("hidden", 0, "pool"), [2]),
        (("hidden", 0, "weight"), [[1.0, 2.0]]),
        (("hidden", 0, "weight", 0, 0), float("nan")),
        (("hidden", 0, "weight", 0), [1.0]),
        (("hidden", 0, "bias", 0), float("inf")),
        (("output", "bias"), None),
        (("output", "weight"), [[1.0] * 7]),
        (("output",), None),
    ],
)
def test_damaged_network_file_is_refused(tmp_path, keys, to):
    value = random_network(np.random.default_rng(0), 2, 1).to_dict()
    path = tmp_path / "network.json"
    path.write_text(json.dumps(damage(value, *keys, to=to)))
    with pytest.raises(CorruptFileError, match=r"network\.json"):
        MaxoutNetwork.load(path)


def test_truncated_network_file_is_refused_wherever_it_ends(tmp_path):
    path = tmp_path / "network.json"
    random_network(np.random.default_rng(0), 2, 1).save(path)
    content = path.read_bytes()
    for end in range(0, len(content) - 2, 37):
        path.write_bytes(content[:end])
        with pytest.raises(CorruptFileError, match=r"network\.json"):
            MaxoutNetwork.load(path)


# -- bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Layer([[1.0, 2], [3, 4]], [0.0], 1), ["weight has 2 rows", "bias has 1"]),
        (lambda: Layer([[1.0, 2], [3, 4]], [0.0, 0], 0), ["pool", "at least 1", "0"]),
        (lambda: Layer([[1.0, 2], [3, 4], [5, 6]], [0.0, 0, 0], 2), ["3 rows", "pool = 2"]),
        (lambda: Layer([[1.0, np.inf]], [0.0], 1), ["weight must be finite", "(0, 1)"]),
        (lambda: Layer([[1.0, 1]], [np.nan], 1), ["bias must be finite"]),
        (lambda: MaxoutNetwork([], [[1.0, 2]], [0.0, 1]), ["output weight has 1 rows", "2"]),
        (
            lambda: MaxoutNetwork([Layer(np.ones((4, 2)), np.ones(4), 2)], [[1.0]], [0.0]),
            ["output weight", "must be 2"],
        ),
        (
            lambda: MaxoutNetwork([Layer(np.ones((4, 2)), np.ones(4), 2)] * 2 + [Layer([[1.0]], [0], 1)], [[1]], [0]),
            ["hidden layer 3", "must be 2"],
        ),
        (lambda: random_network(np.random.default_rng(0), 2, 1)([1, 2, 3]), ["x has shape (3,)", "2"]),
        (lambda: random_network(np.random.default_rng(0), 2, 1).saturate(1, -1), ["lower must not exceed upper"]),
        (lambda: random_network(np.random.default_rng(0), 2, 1).saturate([0, 0, 0], 1), ["lower", "(3,)", "1 outputs"]),
        (lambda: random_network(np.random.default_rng(0), 2, 1).saturate(0, np.nan), ["upper must be finite"]),
    ],
)
def test_bad_arguments_are_named(make, words):
    with pytest.raises(ValueError) as error:
        make()
    assert all(word in str(error.value) for word in words), str(error.value)
