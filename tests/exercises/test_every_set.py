"""Every set: its own check cells pass the solutions, and name an answer that was left as it is."""

from functools import cache

import pytest
from helpers import check_cells, numbers, placeholder, run_source

from mireach.exercises import Wrong

solved, untouched = cache(run_source), cache(placeholder)
EVERY = [pytest.param(number, task, id=task) for number in numbers() for task in check_cells(number)]


@pytest.mark.parametrize(("number", "task"), EVERY)
def test_the_solution_passes(number, task, capsys):
    answers = solved(number)
    capsys.readouterr()  # what the set's other cells print
    for _ in range(3):  # checks draw random data
        exec(check_cells(number)[task], dict(answers))
    assert capsys.readouterr().out.startswith("ok")


@pytest.mark.parametrize(("number", "task"), EVERY)
def test_an_untouched_answer_is_named(number, task):
    with pytest.raises(Wrong, match="not filled in yet"):
        exec(check_cells(number)[task], dict(untouched(number)))


@pytest.mark.parametrize("number", numbers())
def test_a_set_has_three_to_six_tasks(number):
    assert 3 <= len(check_cells(number)) <= 6
