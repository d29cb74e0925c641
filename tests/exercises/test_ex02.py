"""Exercise 02: plausible wrong answers are caught, with a hint that names what is violated."""

import numpy as np
from helpers import expect, run_source

from mireach.exercises import ex02


def test_forgotten_saturation_and_one_binary_a_neuron_are_caught():
    expect(ex02.check_t1, (128, 2.0**66), "off by 4", "saturate")
    expect(ex02.check_t1, (132, 2.0**132), "each neuron follows one of its channels")
    expect(ex02.check_t1, run_source(2, {"ex02_t1": "counts = (66, 2.0**66)"})["counts"], "off by 66")


def interval_M(W, b, lower, upper):
    centre, radius = (lower + upper) / 2, (upper - lower) / 2
    z, reach = W @ centre + b, np.abs(W) @ radius
    return (z + reach).max() - (z - reach)


def test_interval_bounds_are_sound_but_not_smallest():
    expect(ex02.check_t2, interval_M, "is sound, but not the smallest", "need not be smallest")


def test_middle_of_the_box_cuts_states_off():
    def at_centre(W, b, lower, upper):
        z = W @ (lower + upper) / 2 + b
        return z.max() - z

    expect(ex02.check_t2, at_centre, "too small", "at x =", "cuts this state off")
    expect(ex02.check_t2, lambda W, b, lower, upper: at_centre(W, b, lower, upper)[:1], "must have shape")


def test_breaking_needs_a_feasible_model_that_is_wrong_at_the_state_named(solved):
    right = solved["broken"]
    expect(ex02.check_t3, right | {"M": 1.0}, "no state is left, and the solver says so")
    expect(ex02.check_t3, right | {"M": 100.0}, "the model claims Phi <=", "does not contradict")
    expect(ex02.check_t3, right | {"x": [0, 0]}, "Phi(x) =", "does not contradict")
    expect(ex02.check_t3, right | {"x": [5, 0]}, "is not in F")
    expect(ex02.check_t3, right | {"neuron": 4}, "neuron must be a whole number from 1 to 3; got 4")
    expect(ex02.check_t3, {"M": 1.0}, "keys")


def test_the_row_named_must_be_the_one_that_forbids_the_state(solved):
    right = solved["broken"]
    net, _ = ex02.example()
    layer = net.hidden[right["layer"] - 1]
    y = right["x"] if right["layer"] == 1 else net.hidden[0].channels(right["x"]).max(axis=1)
    winner = int(np.argmax(layer.channels(y)[right["neuron"] - 1])) + 1
    expect(ex02.check_t3, right | {"channel": winner}, "indeed lost", "0.000 behind its winner", "allows")


def test_success_says_why_the_model_is_unsound(solved, capsys):
    ex02.check_t3(solved["broken"])
    text = capsys.readouterr().out
    assert "the model claims Phi <=" in text and "Unsound" in text and "behind its winner" in text


def test_tried_states_are_no_bound():
    def tried(net, lower, upper):
        y, found = np.random.default_rng(0).uniform(lower, upper, (200, 2)), []
        for layer in net.hidden:
            z = layer.channels(y)
            y = z.max(axis=-1)
            found.append((y[..., None] - z).max(axis=0))
        return found

    expect(ex02.check_t4, tried, "cuts states off: at x =", "tried or not")


def test_generous_numbers_and_wrong_layers_are_caught(solved):
    right = solved["network_M"]
    expect(ex02.check_t4, lambda *given: [10 * M for M in right(*given)], "sound, but", "interval arithmetic")
    expect(ex02.check_t4, lambda *given: right(*given)[:1], "one array per layer")
    half = lambda *given: [right(*given)[0], 0.1 * right(*given)[1]]  # noqa: E731
    expect(ex02.check_t4, half, "in layer 2", "behind its winner")


def test_honest_points_and_crude_fractions_do_not_cheat():
    def honest(z, M):
        return z.max(), np.eye(len(z))[np.argmax(z)]

    def half(z, M):
        return z.max() + 1e-3, np.full(len(z), 1 / len(z))

    def greedy(z, M):
        return z.max() + 1.0, np.eye(len(z))[np.argmax(z)]

    expect(ex02.check_t5, honest, "the tolerance permits far more")
    expect(ex02.check_t5, half, "further than 1e-06 from 0 and 1")
    expect(ex02.check_t5, greedy, "is violated by 1")
    expect(ex02.check_t5, lambda z, M: (z.max(), np.zeros(len(z))), "not to 1")
    expect(ex02.check_t5, lambda z, M: 3.0, "the pair (q, delta)")


def test_largest_output_is_the_networks():
    net, F = ex02.example()
    tried = net(F.sample(np.random.default_rng(1), 50000)).max()
    claimed = ex02.largest_output(net, F, 100.0)
    assert tried <= claimed + 1e-6 and claimed - tried < 0.1
