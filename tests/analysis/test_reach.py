"""Outer steps and outer sequences: they enclose what is reached, and are the smallest of their shape."""

from dataclasses import dataclass

import numpy as np
import pytest
from loops import affine_loop, jump_loop, random_images, random_loop

import mireach as mr
from mireach import Cells, Engine, Polytope, box_directions, directions
from mireach.analysis.reach import outer_reach, outer_step, support
from mireach.engines import registry

UNIT = Polytope.box([-1, -1], [1, 1])


@pytest.mark.parametrize("seed", range(5))
def test_outer_step_holds_every_sampled_image_and_touches_the_image(seed):
    loop = random_loop(seed, cuts=2, with_input=seed % 2 == 0)
    R = outer_step(loop, UNIT, directions(8))
    images = random_images(loop, UNIT, np.random.default_rng(seed), 300)
    assert R.contains(images).all()
    np.testing.assert_allclose(R.support(directions(8)), support(loop, UNIT, directions(8)).value, atol=1e-9)


def test_outer_sequence_by_hand_for_a_contraction():
    loop = affine_loop(np.diag([0.5, 0.25]), Polytope.box([-0.1, 0], [0.1, 0.2]))
    sets = outer_reach(loop, UNIT, box_directions(2), 3)
    low, high = -np.ones(2), np.ones(2)
    assert len(sets) == 4 and sets[0] is UNIT
    for R in sets[1:]:
        low, high = low * [0.5, 0.25] + [-0.1, 0], high * [0.5, 0.25] + [0.1, 0.2]
        np.testing.assert_allclose(R.h, np.concatenate([high, -low]), atol=1e-10)


@pytest.mark.parametrize("seed", range(4))
def test_outer_sequence_encloses_the_exact_reachable_sets(seed):
    loop = random_loop(seed, cuts=1, layers=1)
    C = directions(6)
    with pytest.warns(UserWarning, match="leaves the state set"):
        sets = outer_reach(loop, loop.system.state_set.scale(1.1), C, 3)
    for k in (1, 2, 3):
        exact = support(loop, sets[0], C, steps=k)
        assert (exact.value <= sets[k].h + 1e-9).all()
        assert sets[k].contains(random_images(loop, loop.system.state_set, np.random.default_rng(k), 200, k)).all()


@pytest.mark.parametrize("engine", ["cells", "milp"])
def test_engines_answer_by_name(engine):
    found = support(jump_loop([2, 0], [-3, 1]), UNIT, directions(4), engine=engine)
    np.testing.assert_allclose(found.value, [2, 1, 3, 0], atol=1e-8)


@pytest.mark.parametrize(("n", "few", "name"), [(2, 0, "cells"), (3, 1000, "cells"), (3, 1, "milp"), (7, 1000, "milp")])
def test_default_engine_is_the_cells_where_they_are_few(n, few, name, monkeypatch):
    monkeypatch.setattr(registry, "FEW_CELLS", few)
    loop = random_loop(0, n)
    found = support(loop, Polytope.box(-np.ones(n) / 8, np.ones(n) / 8), box_directions(n)[:1])
    assert found.engine == name == registry.engine_for(loop).name
    assert registry.engine_for(loop, None, 2).name == ("cells" if n == 2 else "milp")


def test_an_engine_of_ones_own_is_asked_in_the_units_of_the_loop():
    """The bounds of a box around sampled images, widened: in kilometres as in micrometres."""

    @dataclass(frozen=True)
    class Widened(Engine):
        name = "widened"
        wider: float = 0.1

        def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None):
            images = random_images(loop, F, np.random.default_rng(0), 200) @ V.T
            nothing = np.full(len(V), -np.inf)
            return mr.Support(nothing, images.max(axis=0) + self.wider, (None,) * len(V))

    loop = mr.case_study("pwa").loop
    F = loop.system.state_set.scale(0.2)
    found, cells = (support(loop, F, directions(8), engine=engine) for engine in (Widened(), Cells()))
    assert (found.bound >= cells.bound).all() and (found.bound <= cells.bound + 2.0).all()
    inner, outer = (mr.outer_step(loop, F, directions(8), engine) for engine in (Cells(), Widened(0.3)))
    assert inner.is_subset(outer)


def test_a_warm_start_that_answers_another_question_is_refused():
    loop, V = mr.case_study("pwa").loop, directions(8)
    F = loop.system.state_set
    found = support(loop, F, V)
    half = F.scale(0.5)
    np.testing.assert_array_equal(support(loop, half, V, warm_start=found).bound, support(loop, half, V).bound)
    for ask in (
        lambda: support(random_loop(0), UNIT, V, warm_start=found),
        lambda: support(loop, F, V[:4], warm_start=found),
        lambda: support(loop, F, V, 2, warm_start=found),
        lambda: support(loop, F.scale(2), V, warm_start=found),
        lambda: support(loop, F, V, warm_start=found.source),
    ):
        with pytest.raises(ValueError, match="warm_start answers another question"):
            ask()


def test_no_steps_give_the_set_itself():
    assert outer_reach(random_loop(0), UNIT, directions(4), 0) == [UNIT]


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (
            lambda loop: support(loop, UNIT, directions(4), engine="magic"),
            ["engine must be one of", "cells", "'magic'"],
        ),
        (lambda loop: outer_step(loop, UNIT, np.eye(3)), ["C has shape (3, 3)", "2"]),
        (lambda loop: outer_step(loop, Polytope.box([8, 8], [9, 9]), np.eye(2)), ["F does not meet the state set"]),
        (lambda loop: outer_step(loop, UNIT, [[np.nan, 0]]), ["C must be finite"]),
        (lambda loop: support(loop, UNIT, directions(5), cutoff=[1.0]), ["cutoff has shape (1,)", "5 rows"]),
    ],
)
def test_bad_arguments_are_named(ask, words):
    with pytest.raises(ValueError) as error:
        ask(random_loop(0))
    assert all(word in str(error.value) for word in words), str(error.value)


def test_every_engine_refuses_a_network_that_leaves_the_input_set_in_a_corner():
    box = mr.Polytope.box
    mode = mr.Mode(0.5 * np.eye(2), [[0.3], [0.3]], [0, 0], box([-9] * 3, [9] * 3))
    system = mr.PWASystem([mode], box([-2, -2], [2, 2]), box([-1], [1]))
    loop = mr.ClosedLoop(system, mr.MaxoutNetwork([mr.Layer([[1, 1], [0, 0]], [-3.9, 0], 2)], [[15.0]], [0]))
    for engine in ("cells", "milp", "cvxpy"):
        with pytest.raises(ValueError, match="leaves the input set"):
            mr.support(loop, system.state_set, np.eye(2), engine=engine)


def test_wrong_settings_and_kinds_are_named():
    loop, F = mr.case_study("pwa").loop, mr.Polytope.box([-1, -1], [1, 1])
    for kind, wrong in (
        (TypeError, lambda: mr.support(loop, F, np.eye(2), engine="cells", time_limit=1)),
        (TypeError, lambda: mr.safe_set(loop, max_iteration=3)),
        (TypeError, lambda: mr.support(loop, F, np.eye(2), engine=["milp"])),
        (ValueError, lambda: mr.Milp(time_limit=-1)),
        (ValueError, lambda: mr.Milp(gap=np.nan)),
        (TypeError, lambda: mr.support(loop, None, np.eye(2))),
        (TypeError, lambda: mr.support(loop.system, F, np.eye(2))),
        (TypeError, lambda: mr.support(loop, F, np.eye(2), warm_start=[1.0, 2.0])),
        (ValueError, lambda: mr.support(loop, F, np.eye(2), np.inf)),
        (ValueError, lambda: mr.outer_reach(loop, F, np.eye(2), -1)),
        (ValueError, lambda: loop.simulate([0, 0], -1)),
    ):
        with pytest.raises(kind):
            wrong()
    assert mr.support(loop, F, np.eye(2), 2.0).bound.shape == (2,)
