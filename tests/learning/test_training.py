"""Training: the module, its import, and what a seed promises."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from mireach import MaxoutNetwork  # noqa: E402
from mireach.learning.training import Maxout, maxout_module, train  # noqa: E402


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def data():
    states = np.random.default_rng(0).uniform([-4, 1], [4, 9], (200, 2))
    return states, np.clip(-0.7 * states[:, :1] + 0.5 * np.abs(states[:, 1:] - 5), -1, 1.5)


def fit(data, **options):
    settings = {"layers": 2, "width": 3, "pool": 2, "lower": -1, "upper": 1.5, "steps": 60, "progress": False}
    return train(*data, **{**settings, **options})


def test_maxout_by_hand():
    z = torch.tensor([[1.0, 5.0, 2.0, -1.0, -3.0, -2.0]])
    assert Maxout(3)(z).tolist() == [[5.0, -1.0]]
    assert Maxout(2)(z).tolist() == [[5.0, 2.0, -2.0]]
    assert Maxout(2).pool == 2


@pytest.mark.parametrize(("layers", "width", "pool"), [(3, 3, 3), (5, 5, 5), (1, 4, 2), (0, 1, 1), (2, 6, None)])
def test_module_equals_imported_network(layers, width, pool):
    module = maxout_module(2, 3, layers=layers, width=width, pool=pool, rng=3)
    x = np.random.default_rng(4).uniform(-10, 10, (500, 2))
    with torch.no_grad():
        expected = module(torch.tensor(x)).numpy()
    network = MaxoutNetwork.from_torch(module)
    assert network.binaries == layers * width * (pool or 2)
    np.testing.assert_allclose(network(x), expected, atol=1e-12)


def test_a_relu_network_is_learnt_and_keeps_its_zero_channels(data):
    result = fit(data, width=8, pool=None, steps=150)
    assert result.loss < 0.05 * data[1].var()
    for layer in result.network.hidden[:2]:
        assert layer.pool == 2 and not layer.weight[1::2].any() and not layer.bias[1::2].any()


def test_seed_decides_the_network(data):
    first, second, other = fit(data, rng=5), fit(data, rng=5), fit(data, rng=6)
    assert first.network.to_dict() == second.network.to_dict() and first.loss == second.loss
    assert first.network.to_dict() != other.network.to_dict()


def test_random_numbers_of_the_caller_are_left_alone(data):
    torch.manual_seed(11)
    np.random.seed(11)  # noqa: NPY002
    before = torch.get_rng_state().clone(), np.random.get_state()[1].copy()  # noqa: NPY002
    fit(data)
    assert torch.equal(before[0], torch.get_rng_state())
    assert (before[1] == np.random.get_state()[1]).all()  # noqa: NPY002


def test_training_lowers_the_loss(data):
    result = fit(data, steps=400)
    assert result.history[0, 0] == 0 and result.loss < 0.2 * result.history[0, 1]
    assert fit(data, steps=0).loss == pytest.approx(result.history[0, 1], rel=1e-9)


def test_loss_is_that_of_the_saturated_network(data):
    result, (states, inputs) = fit(data), data
    errors = [(float(result.network(x)[0]) - u[0]) ** 2 for x, u in zip(states, inputs)]
    assert result.loss == pytest.approx(np.mean(errors), rel=1e-12)


def test_output_stays_in_the_box(data):
    network = fit(data, lower=-0.3, upper=0.1).network
    outputs = network(np.random.default_rng(7).uniform(-1e3, 1e3, (20000, 2)))
    assert outputs.min() == -0.3 and outputs.max() == 0.1


def test_gradient_survives_where_the_output_is_cut_off():
    # Every output begins above the box, and all targets are below it: plain clipping has no gradient at all.
    states = np.linspace(-1, 1, 50)[:, None]
    inputs = np.full((50, 1), -1.0)
    start = fit((states, inputs), lower=-1, upper=-0.999, steps=0)
    assert fit((states, inputs), lower=-1, upper=-0.999, steps=300).loss < 0.1 * start.loss


def test_a_generator_decides_the_network_too(data):
    first, second = (fit(data, rng=np.random.default_rng(5), steps=5) for _ in range(2))
    assert first.network.to_dict() == second.network.to_dict()
    rng = np.random.default_rng(5)
    assert fit(data, rng=rng, steps=5).network.to_dict() != fit(data, rng=rng, steps=5).network.to_dict()


def test_a_result_is_shown_in_one_line(data):
    result = fit(data, steps=1)
    assert str(result) == f"TrainingResult({result.network}, loss {result.loss:.6g})"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 0}, "width must be a whole number of at least 1; got 0"),
        ({"layers": 1.5}, "layers must be a whole number"),
        ({"steps": -1}, "steps must be a whole number of at least 0"),
        ({"learning_rate": 0.0}, "learning_rate must be positive"),
        ({"lower": np.nan}, "lower must be finite"),
    ],
)
def test_wrong_numbers_are_named(data, options, message):
    with pytest.raises(ValueError, match=message):
        fit(data, **options)


def test_wrong_sizes(data):
    with pytest.raises(ValueError, match="200 rows and inputs has 199"):
        train(data[0], data[1][:-1], layers=1, width=1, pool=1, lower=-1, upper=1)
