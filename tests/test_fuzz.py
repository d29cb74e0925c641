"""All engines on 200 random loops and 300 badly conditioned ones; `benchmarks/fuzz.py` asks about thousands."""

import pytest
from fuzz import disagreements, wrong_verdicts


@pytest.mark.parametrize("first", range(0, 200, 10))
def test_engines_and_sampling_agree(first):
    assert not [text for seed in range(first, first + 10) for text in disagreements(seed, milp_sets=1)[0]]


@pytest.mark.parametrize("seed", [1280, 3287, 3485, 3507, 3637, 3756, 4334, 4603, 4715, 5033, 5036, 5213, 5327, 5389])
def test_loops_on_which_they_once_did_not(seed):
    """Steep networks, large sets, slivers, a big-M that amplified tolerances, a presolve that lost the optimum."""
    assert disagreements(seed, milp_sets=9)[0] == []


@pytest.mark.parametrize("first", range(0, 300, 10))
def test_no_verdict_about_a_badly_conditioned_loop_is_wrong(first):
    assert not [text for seed in range(first, first + 10) for text in wrong_verdicts(seed)[0]]
