"""Data sets: files that read back exactly, files that must be refused, and the shipped data."""

from pathlib import Path

import numpy as np
import pytest

from mireach.errors import CorruptFileError
from mireach.learning.datasets import (
    DataSet,
    make_aircraft_pitch_data,
    make_double_integrator_data,
    make_four_tanks_data,
    make_pwa_data,
    make_quadrotor_data,
    make_three_tanks_data,
)
from mireach.learning.mpc import NonlinearMPC, solve_miqp
from mireach.systems.plants import (
    aircraft_pitch_plant,
    double_integrator_plant,
    four_tanks_plant,
    pwa_plant,
    quadrotor_plant,
)

DATA = Path(__file__).parents[2] / "data"
FIELDS = ("states", "inputs", "costs", "infeasible")


@pytest.fixture
def sample():
    rng = np.random.default_rng(0)
    return DataSet(rng.normal(size=(7, 3)) / 3, rng.normal(size=(7, 2)) * 1e-9, rng.normal(size=7), np.eye(3) / 7)


def same(first, second):
    return all(np.array_equal(getattr(first, field), getattr(second, field)) for field in FIELDS)


def test_round_trip_is_exact(sample, tmp_path):
    sample.save(tmp_path / "deep" / "samples.csv")
    assert same(sample, DataSet.load(tmp_path / "deep" / "samples.csv"))


def test_round_trip_without_infeasible_states(tmp_path):
    sample = DataSet(np.ones((2, 2)), np.zeros((2, 1)), np.ones(2), np.zeros((0, 2)))
    sample.save(tmp_path / "samples.csv")
    assert same(sample, DataSet.load(tmp_path / "samples.csv"))


def test_truncation_is_noticed(sample, tmp_path):
    path = tmp_path / "samples.csv"
    sample.save(path)
    content = path.read_bytes()
    for length in [*range(0, len(content), 7), *range(len(content) - 40, len(content))]:
        path.write_bytes(content[:length])
        with pytest.raises(CorruptFileError, match=r"samples\.csv"):
            DataSet.load(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("x1,x2", "x2,x1", "first line"),
        ("cost", "price", "first line"),
        ("0.5", "half", "line 2: could not convert"),
        ("0.5", "nan", "finite"),
        (",1\n", ",2\n", "line 2"),
        ("0.25,,,0", "0.25,1.0,,0", "line 3"),
        ("end: 2", "end: 3", "truncated"),
    ],
)
def test_damage_is_named(tmp_path, old, new, message):
    path = tmp_path / "samples.csv"
    DataSet([[0.5, 2.0]], [[3.0]], [4.0], [[8.0, 0.25]]).save(path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(CorruptFileError, match=message):
        DataSet.load(path)


def test_a_data_set_is_shown_by_its_sizes(sample):
    assert str(sample) == "DataSet(7 states with inputs, 3 infeasible)" and len(sample) == 7


@pytest.mark.parametrize(
    "make",
    [make_pwa_data, make_three_tanks_data, make_four_tanks_data, make_aircraft_pitch_data, make_quadrotor_data],
)
def test_a_seed_and_its_generator_give_the_same_data(make):
    assert same(make(rng=5, count=3), make(rng=np.random.default_rng(5), count=3))


def test_numbers_of_states_must_be_whole():
    with pytest.raises(ValueError, match="count must be a whole number of at least 1; got 0"):
        make_pwa_data(count=0)
    with pytest.raises(ValueError, match="grid must be a whole number of at least 2"):
        make_double_integrator_data(grid=2.5)


def test_sizes_must_match():
    with pytest.raises(ValueError, match="costs has 2 rows but states has 1"):
        DataSet([[0.5, 2.0]], [[3.0]], [4.0, 5.0], [[8.0, 0.25]])


def test_making_is_reproducible_and_independent_of_jobs():
    pytest.importorskip("joblib")
    first = make_pwa_data(rng=3, count=12, progress=False)
    assert same(first, make_pwa_data(rng=3, count=12, progress=False, jobs=2))
    assert not np.array_equal(first.states[:5], make_pwa_data(rng=4, count=12, progress=False).states[:5])


def test_small_grid():
    data = make_double_integrator_data(grid=3, progress=False)
    states = np.vstack([data.states, data.infeasible])
    assert {tuple(x) for x in states} == {(a, b) for a in (-6.0, 0.0, 6.0) for b in (-6.0, 0.0, 6.0)}
    assert [6.0, 6.0] in data.infeasible.tolist() and [0.0, 0.0] in data.states.tolist()


def test_shipped_pwa_data():
    data, system = DataSet.load(DATA / "pwa" / "samples.csv"), pwa_plant()
    assert len(data) == 992 and len(data.infeasible) == 8
    assert np.abs(data.states).max() <= 10 and np.abs(data.inputs).max() <= 1 + 1e-9
    assert (data.infeasible @ [0.491, 0.62] < -10).all() and (data.infeasible < 0).all()
    for i in np.random.default_rng(0).choice(len(data), 25, replace=False):
        solution = solve_miqp(system, data.states[i])
        assert solution.cost == pytest.approx(data.costs[i], rel=1e-9)
        np.testing.assert_allclose(solution.inputs[0], data.inputs[i], atol=1e-7)


def test_shipped_pwa_data_is_the_first_draw():
    data, made = DataSet.load(DATA / "pwa" / "samples.csv"), make_pwa_data(count=20, progress=False)
    np.testing.assert_array_equal(made.states, data.states[: len(made)])


def test_shipped_double_integrator_data():
    data, mpc = DataSet.load(DATA / "double_integrator" / "samples.csv"), NonlinearMPC(double_integrator_plant())
    assert len(data) == 639 and len(data.infeasible) == 261
    assert len(np.unique(np.vstack([data.states, data.infeasible]), axis=0)) == 900
    assert np.abs(data.inputs).max() <= 2 + 1e-8
    for i in np.random.default_rng(0).choice(len(data), 10, replace=False):
        solution = mpc.solve(data.states[i])
        assert solution.cost == pytest.approx(data.costs[i], rel=1e-7)
        np.testing.assert_allclose(solution.inputs[0], data.inputs[i], atol=1e-5)


@pytest.mark.parametrize(
    ("name", "make", "sizes"),
    [
        ("three_tanks", make_three_tanks_data, (1495, 5)),
        ("four_tanks", make_four_tanks_data, (2000, 0)),
        ("aircraft_pitch", make_aircraft_pitch_data, (1959, 41)),
        ("quadrotor", make_quadrotor_data, (1340, 160)),
    ],
)
def test_shipped_data_of_more_than_two_states(name, make, sizes):
    data, made = DataSet.load(DATA / name / "samples.csv"), make(count=15, progress=False)
    assert (len(data), len(data.infeasible)) == sizes
    np.testing.assert_array_equal(made.states, data.states[: len(made)])
    np.testing.assert_array_equal(made.infeasible, data.infeasible[: len(made.infeasible)])
    np.testing.assert_allclose(made.inputs, data.inputs[: len(made)], atol=1e-7)
    np.testing.assert_allclose(made.costs, data.costs[: len(made)], rtol=1e-9)


@pytest.mark.parametrize(
    ("name", "plant", "N", "q", "r", "limits", "largest"),
    [
        ("four_tanks", four_tanks_plant, 20, [1, 1, 0.1, 0.1], [5, 5], [5, 5, 1.5, 1.2], 1),
        ("aircraft_pitch", aircraft_pitch_plant, 12, [0.01, 3, 1], [1], [25, 10, 20], 15),
        ("quadrotor", quadrotor_plant, 10, [1, 1, 1, 0.1, 0.1, 0.1], [1, 1, 10], [2] * 6, 1),
    ],
)
def test_data_of_one_mode_agree_with_a_convex_solver(name, plant, N, q, r, limits, largest):
    cp = pytest.importorskip("cvxpy")
    data, (mode,) = DataSet.load(DATA / name / "samples.csv"), plant().modes
    Q, R = np.diag(q), np.diag(r)
    P = Q
    for _ in range(2000):  # Riccati recursion
        K = np.linalg.solve(R + mode.B.T @ P @ mode.B, mode.B.T @ P @ mode.A)
        P = Q + mode.A.T @ P @ (mode.A - mode.B @ K)
    for i in (0, 7, 123):
        x, u = cp.Variable((N + 1, len(q))), cp.Variable((N, len(r)))
        stages = [cp.quad_form(x[k], Q) + cp.quad_form(u[k], R) for k in range(N)]
        rules = [x[k + 1] == mode.A @ x[k] + mode.B @ u[k] for k in range(N)]
        rules += [x[0] == data.states[i], cp.abs(u) <= largest, *(cp.abs(x[k]) <= limits for k in range(N + 1))]
        problem = cp.Problem(cp.Minimize(sum(stages) + cp.quad_form(x[N], cp.psd_wrap((P + P.T) / 2))), rules)
        assert problem.solve() == pytest.approx(data.costs[i], rel=1e-5)
        np.testing.assert_allclose(u.value[0], data.inputs[i], atol=1e-3 * largest)
