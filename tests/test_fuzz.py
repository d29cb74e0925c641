"""All engines on 200 random loops and 300 badly conditioned ones; `benchmarks/fuzz.py` asks about thousands."""

import pytest
from fuzz import disagreements, wrong_verdicts


@pytest.mark.parametrize("first", range(0, 200, 10))
def test_engines_and_sampling_agree(first):
    assert not [text for seed in range(first, first + 10) for text in disagreements(seed, milp_sets=1)[0]]


@pytest.mark.parametrize(("n", "first"), [(3, 0), (3, 25), (3, 50), (3, 75), (3, 100), (4, 0), (4, 25), (4, 50)])
def test_engines_and_sampling_agree_on_more_than_two_states(n, first):
    asked = range(first, first + 25)
    assert not [text for seed in asked for text in disagreements(seed, milp_sets=0, n=n, most_sets=3)[0]]


@pytest.mark.parametrize("n", [1, 3, 4, 5])
def test_all_engines_agree_on_other_numbers_of_states(n):
    assert not [text for seed in (2, 7) for text in disagreements(seed, milp_sets=1, n=n, most_sets=2)[0]]


@pytest.mark.parametrize("seed", [1280, 3287, 3485, 3507, 3637, 3756, 4334, 4603, 4715, 5033, 5036, 5213, 5327, 5389])
def test_loops_on_which_they_once_did_not(seed):
    """Steep networks, large sets, slivers, a big-M that amplified tolerances, a presolve that lost the optimum."""
    assert disagreements(seed, milp_sets=9)[0] == []


@pytest.mark.parametrize("seed", [1194, 1395])
def test_needles_in_space_on_which_they_once_did_not(seed):
    """Only exact arithmetic finds the tip of the needle; a MILP solver moves it."""
    assert disagreements(seed, milp_sets=1, n=4, most_sets=3)[0] == []


@pytest.mark.parametrize("first", range(0, 300, 10))
def test_no_verdict_about_a_badly_conditioned_loop_is_wrong(first):
    assert not [text for seed in range(first, first + 10) for text in wrong_verdicts(seed)[0]]
