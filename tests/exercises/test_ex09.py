"""Exercise 09: plausible wrong answers are caught, with a hint that names what is violated."""

import numpy as np
import pytest

import mireach as mr
from mireach.exercises import Wrong, ex09


def expect(check, *answer_and_words, arguments=1):
    """The check raises Wrong, and its hint says all the words."""
    with pytest.raises(Wrong) as error:
        check(*answer_and_words[:arguments])
    for word in answer_and_words[arguments:]:
        assert word in str(error.value)


def test_counts_that_are_off_by_one_are_caught(solved):
    count = solved["count_iterations"]

    def shifted(by):
        return lambda loop, C, limit: None if (k := count(loop, C, limit)) is None else k + by

    expect(ex09.check_t1, shifted(1), "lies in X already")
    expect(ex09.check_t1, shifted(-1), "leaves X by")
    expect(ex09.check_t1, lambda loop, C, limit: count(loop, C, limit - 1), "is allowed, too")
    expect(ex09.check_t1, lambda loop, C, limit: count(loop, C, limit + 1), "with limit =", "None")


def test_counts_that_never_or_always_end_are_caught(solved):
    count = solved["count_iterations"]
    expect(ex09.check_t1, lambda loop, C, limit: None, "the sequence ends before")
    expect(ex09.check_t1, lambda loop, C, limit: count(loop, C, limit) or limit, "leaves X for all k")


def test_bounds_of_the_other_template_are_caught(solved):
    largest = solved["largest"]
    expect(ex09.check_t2, {8: largest[16], 16: largest[16]}, "largest[8]", "too large")
    expect(ex09.check_t2, {8: largest[8], 16: largest[8]}, "largest[16]", "still found")
    expect(ex09.check_t2, {8: 0.1186, 16: 0.1186}, "not the largest")
    expect(ex09.check_t2, largest[8], "dict")


def test_no_search_is_caught():
    expect(ex09.check_t3, lambda G: None, "you return None", "% of its states")


def test_false_alarms_are_caught():
    expect(ex09.check_t3, lambda G: G.chebyshev()[0], "the plant goes to", "which is in G")
    expect(ex09.check_t3, lambda G: G.vertices()[0] + 10, "is not in G")


def test_disturbed_steps_are_no_witness_for_the_plant(solved):
    def of_the_loop(G):  # the disturbed loop leaves sets that the plant does not leave
        return mr.support(solved["loop"], G, G.H[:1]).witness[0].states[0]

    expect(ex09.check_t3, of_the_loop, "which is in G")


def test_steps_of_the_pwa_model_are_no_steps_of_the_plant(solved):
    def of_the_model(G):
        states = np.vstack([G.vertices(), G.sample(np.random.default_rng(0), 2000)])
        beyond = (solved["loop"].step(states) @ G.H.T - G.h).max(axis=1)
        return states[beyond.argmax()] if beyond.max() > 1e-9 else None

    expect(ex09.check_t3, of_the_model, "equilibrium of the PWA loop", "you return None")


def test_rules_that_scale_wrongly_are_caught():
    def rule(factor, about=lambda c: c, turned=False):
        def holds(loop, R, C, epsilon, centre):
            S = R.scale(factor(epsilon), about(centre))
            image = mr.outer_step(loop, S, C)
            return image.is_subset(S) if turned else S.is_subset(image)

        return holds

    expect(ex09.check_t4, rule(lambda e: 1 / (1 + e), about=np.zeros_like), "you say that the rule fails", "to spare")
    expect(ex09.check_t4, rule(lambda e: 1 + e), "you say that the rule")
    expect(ex09.check_t4, rule(lambda e: 1 / (1 + e), turned=True), "you say that the rule")
    expect(ex09.check_t4, lambda *question: True, "S sticks out", "along C_")


def test_points_with_a_small_error_are_caught():
    expect(ex09.check_t5, [0, 0], 0.0, "is only 0.0", arguments=2)
    expect(ex09.check_t5, [7, 7], 0.0, "outside X", arguments=2)
    expect(ex09.check_t5, [2, 2], 5.0, "outside U", arguments=2)
