"""Maxout networks against a neuron-by-neuron evaluation; files; bad input."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from loops import evaluate, random_network

from mireach import Layer, MaxoutNetwork
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


def test_wrong_types_raise_type_errors():
    with pytest.raises(TypeError, match="hidden must be of the kind list or tuple"):
        MaxoutNetwork(Layer([[1.0]], [0.0], 1), [[1.0]], [0.0])
    with pytest.raises(TypeError, match="hidden layer 1 must be of the kind Layer"):
        MaxoutNetwork([[[1.0]]], [[1.0]], [0.0])


def test_networks_and_layers_are_shown_by_their_sizes():
    layer = Layer(np.ones((6, 2)), np.ones(6), 3)
    assert str(layer) == "Layer(2 -> 2x3)"
    assert str(MaxoutNetwork([layer], np.ones((1, 2)), [0.0])) == "MaxoutNetwork(2 -> [2x3] -> 1, 6 binaries)"
