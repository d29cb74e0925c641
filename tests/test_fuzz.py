"""Cells, exact arithmetic, MILP and sampling on 200 random loops; `benchmarks/fuzz.py` asks about thousands."""

import pytest
from fuzz import disagreements


@pytest.mark.parametrize("first", range(0, 200, 10))
def test_engines_and_sampling_agree(first):
    assert not [text for seed in range(first, first + 10) for text in disagreements(seed, milp_sets=1)[0]]
