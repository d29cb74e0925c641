"""No engine leads to a false verdict: neither loose or infinite bounds, nor a wrong word of a solver."""

from dataclasses import dataclass
from doctest import DocTestParser

import numpy as np
import pytest
from loops import affine_loop, assert_replays, brute_support, random_loop, replays

import mireach as mr
from mireach import Engine, Exact, Polytope, box_directions, check_rpi, contraction, outer_step, safe_set, terminal_set
from mireach.engines import base
from mireach.engines.base import COUNTED, SOLVER, Support
from mireach.engines.registry import engine_for


@dataclass(frozen=True)
class Distorted(Engine):
    """Exact answers, whose bounds are moved along every `every`-th row, and whose witnesses may be left out.

    Attributes
    ----------
    by : float
        Added to the bounds, relative to the size of X.
    """

    name = "distorted"
    by: float = np.inf
    every: int = 1
    rests_on: str = COUNTED
    values: bool = True
    resolution: float = 0.0

    def support(self, loop, F, V, steps=1, *, cutoff=None, warm_start=None):
        found = Exact().support(loop, F, V, steps)
        bound = found.bound.copy()
        bound[:: self.every] += self.by
        if self.values:
            return Support(found.value, bound, found.witness, rests_on=self.rests_on)
        return Support(np.full(len(V), -np.inf), bound, (None,) * len(V), rests_on=self.rests_on)


LOOSE = [Distorted(by, every, values=values) for by in (np.inf, 0.1) for every in (1, 2) for values in (True, False)]
WRONG = [Distorted(by, every, SOLVER, values) for by in (-0.3, -0.02) for every in (1, 2) for values in (True, False)]
ENGINES = [*LOOSE, *WRONG, Distorted(0.1, 1, SOLVER), Distorted(0.0, 1, SOLVER)]


@pytest.fixture(params=["few cells", "many cells"])
def cells(request, monkeypatch):
    """Whether exact arithmetic may decide in three states."""
    if request.param == "many cells":
        monkeypatch.setattr("mireach.analysis.comparison.FEW_CELLS", 0)
    return request.param


def some_loop(seed):
    """A random loop of two or three states; X is RPI for about half of them."""
    loop = random_loop(seed, 2 + seed % 2, cuts=1, layers=1, limits=4.0, gain=0.3)
    modes = [mr.Mode(m.A / (1 + seed % 4), m.B, m.p, m.region, m.disturbance) for m in loop.system.modes]
    return mr.ClosedLoop(mr.PWASystem(modes, loop.system.state_set, loop.system.input_set), loop.network)


def is_rpi(loop, F):
    """Whether R_1(F) lies in F, by exact arithmetic."""
    return bool((mr.support(loop, F, F.H, engine="exact").bound <= F.h).all())


@pytest.mark.parametrize("seed", [0, 2, 3, 7])
@pytest.mark.parametrize("tol", [None, 0.0])
def test_verdicts_about_sets_are_right(seed, tol, cells):
    loop, given = some_loop(seed), 0
    X = loop.system.state_set
    for F in (X, X.scale(0.5)):
        truth, room = is_rpi(loop, F), F.h - mr.support(loop, F, F.H, engine="exact").value
        for engine in ENGINES:
            check = check_rpi(loop, F, engine, tol=tol)
            assert check.verdict == "unknown" or check.verdict == ("proven" if truth else "refuted")
            assert check.verdict != "refuted" or replays(loop, F, check.escape)
            assert ((check.margin <= 0) | (check.margin <= room + 1e-12)).all()
            assert check.verdict != "unknown" or check.reason
            given += check.verdict != "unknown"
    assert given


@pytest.mark.parametrize("seed", [1, 4, 5, 7, 9])
def test_verdicts_about_safe_sets_are_right(seed, cells):
    loop = some_loop(seed)
    truth = safe_set(loop, engine="exact", max_iterations=30)
    for engine in ENGINES:
        safe = safe_set(loop, engine=engine, max_iterations=6)
        if safe.verdict == "proven":
            assert is_rpi(loop, safe.set) and safe.set.is_subset(loop.system.state_set)
        if safe.verdict == "refuted":
            assert truth.verdict != "proven"
        if safe.verdict == "unknown":
            assert safe.set is None and safe.settled == ""


@pytest.mark.parametrize("engine", [Distorted(), Distorted(values=False), Distorted(0.1), Distorted(0.02, 2)])
@pytest.mark.parametrize("n", [2, 3])
def test_loose_bounds_refute_no_safe_set(engine, n):
    """x1+ = 0.5 x1 + 0.9 x2 leaves |x1| <= 1 from X, but not from F_1, where |x2| <= 0.5."""
    A = 0.5 * np.eye(n)
    A[0, 1] = 0.9
    loop = affine_loop(A)
    assert safe_set(loop, box_directions(n)).verdict == "proven"
    safe = safe_set(loop, box_directions(n), engine)
    assert safe.verdict != "refuted"
    if engine == Distorted():
        assert safe.reason.startswith("F1 = F0 by bounds that may be loose") and "leaves X by 0.4" in safe.reason


@pytest.mark.parametrize("by", [-np.inf, -3.0])
@pytest.mark.parametrize("n", [2, 3])
def test_a_wrong_word_empties_no_safe_set(by, n, cells):
    loop = affine_loop(0.5 * np.eye(n), p=0.1 * np.ones(n))
    assert safe_set(loop, engine=Distorted(by, rests_on=SOLVER)).verdict != "refuted"


@pytest.mark.parametrize("tol", [None, 0.0, 1e-3])
@pytest.mark.parametrize(("resolution", "verdict"), [(0.0, "unknown"), (1e-6, "proven")])
def test_a_word_of_a_solver_counts_only_with_the_resolution_of_that_solver(monkeypatch, resolution, verdict, tol):
    monkeypatch.setattr("mireach.analysis.comparison.FEW_CELLS", 0)
    loop, F = affine_loop(0.5 * np.eye(3)), Polytope.box([-0.5] * 3, [0.5] * 3)
    engine = Distorted(0.0, rests_on=SOLVER, resolution=resolution)
    check, safe = check_rpi(loop, F, engine, tol=tol), safe_set(loop, engine=engine, tol=tol)
    assert check.verdict == safe.verdict == verdict
    for result in (check, safe):
        if verdict == "proven":
            assert result.settled == "to within 1e-06 of the size of X, a solver's word"
        else:
            assert SOLVER in result.reason and "too many cells" in result.reason
    assert np.isfinite(check.margin).all() == (verdict == "proven")


def test_a_wrong_word_gives_no_contraction_factor(cells):
    for n in (2, 3):
        loop, R = affine_loop(0.95 * np.eye(n)), Polytope.box(-0.5 * np.ones(n), 0.5 * np.ones(n))
        alpha = contraction(loop, R, engine=Distorted(-0.1, rests_on=SOLVER), accuracy=1e-3)
        assert alpha <= 1 / 0.95


@pytest.mark.parametrize("resolution", [np.inf, np.nan, -1e-9, 1e-4])
def test_a_resolution_is_a_tolerance_and_not_how_loose_bounds_are(resolution):
    with pytest.raises(ValueError, match=r"resolution of the engine distorted must lie between 0 and 1e-05"):
        engine_for(affine_loop(np.eye(2)), Distorted(0.0, resolution=resolution))


def test_a_missing_bound_is_named():
    loop = affine_loop(0.5 * np.eye(3))
    with pytest.raises(ValueError, match="the engine distorted has no bound along row 1"):
        outer_step(loop, loop.system.state_set, box_directions(3), Distorted(every=2))
    with pytest.raises(ValueError, match="the engine distorted has no bound along row 1"):
        mr.scaled_minimal_set(loop, engine=Distorted(every=2))


@pytest.mark.parametrize(("by", "constant"), [(0.0, True), (np.inf, False)])
def test_a_sequence_at_rest_stays_there_only_if_its_bounds_are_attained(by, constant):
    """x1+ = x1, x2+ = 0 comes to rest after one step; x+ = x / 2 seems to where no bounds are known."""
    loop = affine_loop([[1.0, 0], [0, 0]] if constant else 0.5 * np.eye(2))
    found = terminal_set(loop, loop.system.state_set, engine=Distorted(by), max_steps=4)
    assert not found.criterion and found.reason.startswith("stagnation") == (constant or by == np.inf)
    assert ("always will" in found.reason) == constant


# -- the example in the docstring of Engine -----------------------------------------------------------


@pytest.fixture(scope="module")
def intervals():
    """The engine that the docstring of `Engine` shows."""
    names = vars(base).copy()
    for example in DocTestParser().get_examples(Engine.__doc__):
        if not example.want:
            exec(example.source, names)
    return names["Intervals"]()


@pytest.mark.parametrize("steps", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_no_bound_of_the_example_is_passed(intervals, seed, steps):
    loop = random_loop(seed, 2 + seed % 2, cuts=1, layers=1, with_input=seed % 2 == 0)
    X, n = loop.system.state_set, loop.system.state_size
    V, x = mr.directions(3 + n, n), X.sample(seed, 1)[0]
    for F in (X, X.scale(1.5), X.scale(0.2), Polytope.box(x, x), Polytope.box(x, np.where(np.arange(n), x, X.h[:n]))):
        found = mr.support(loop, F, V, steps, intervals)
        truth = brute_support(loop, F, V, steps)
        assert (found.bound >= truth - 1e-9).all() and (found.value <= truth + 1e-9).all()
        for v, value, witness in zip(V, found.value, found.witness):
            assert witness is None or assert_replays(loop, F, v, value, witness) is None
    for F in (Polytope.box(10 * X.h[:n], 11 * X.h[:n]), Polytope(X.H, -X.h)):
        assert (mr.support(loop, F, V, steps, intervals).bound == -np.inf).all()


def test_verdicts_of_the_example_are_right(intervals, monkeypatch):
    verdicts = []
    for most in (1000, 0):
        monkeypatch.setattr("mireach.analysis.comparison.FEW_CELLS", most)
        for seed in range(12):
            loop = some_loop(seed)
            for F in (loop.system.state_set, loop.system.state_set.scale(0.5)):
                check = check_rpi(loop, F, intervals)
                assert check.verdict == "unknown" or (check.verdict == "proven") == is_rpi(loop, F)
                verdicts.append(str(check.verdict))
            safe = safe_set(loop, engine=intervals, max_iterations=6)
            assert safe.verdict != "proven" or is_rpi(loop, safe.set)
            assert safe.verdict != "refuted" or safe_set(loop, engine="exact", max_iterations=30).verdict != "proven"
    assert set(verdicts) == {"proven", "refuted", "unknown"}
