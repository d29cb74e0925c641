"""The shipped case studies, and the engines on them: the cells against the MILP and its reading version."""

from itertools import product

import numpy as np
import pytest

import mireach as mr
from mireach.errors import CorruptFileError
from mireach.studies.case_studies import CASES, NAMES, PAPER_NAMES, data_file, load_sets

BOUNDARY_POINTS = {
    "pwa": [(0.0, -4.0), (3.0, 0.0), (0.0, 0.0), (-5.0, 0.0), (0.0, 10.0)],
    "double_integrator": [(2.0, 0.5), (-2.0, 2.0), (1.0, -2.0), (2.0, -2.0), (6.0, 0.0)],
}


LARGER = {"three_tanks": "milp", "four_tanks": "milp", "aircraft_pitch": "cells", "quadrotor": "cells"}  # and an engine


@pytest.fixture(scope="module", params=PAPER_NAMES)
def case(request):
    return mr.case_study(request.param)


@pytest.fixture(scope="module", params=LARGER)
def larger(request):
    return mr.case_study(request.param)


@pytest.fixture(scope="module")
def safe(case):
    return mr.safe_set(case.loop, case.safe_directions)


@pytest.fixture(scope="module")
def terminal(case, safe):
    return mr.terminal_set(case.loop, safe, case.directions, case.epsilon)


def test_unknown_case_is_refused_with_the_names():
    assert NAMES == (*PAPER_NAMES, *LARGER)
    with pytest.raises(ValueError, match="pwa, double_integrator, three_tanks, four_tanks, aircraft_pitch, quadrotor"):
        mr.case_study("pwm")


def test_a_name_that_is_no_text_is_a_type_error():
    with pytest.raises(TypeError, match="name must be of the kind str; got int 3"):
        mr.case_study(3)


def test_a_case_is_shown_as_one_line_and_as_a_table(case):
    text, table = str(case), case._repr_html_()
    assert text.startswith(f"case {case.name}: n = 2, m = 1, {len(case.system.modes)} modes") and "\n" not in text
    assert table.startswith("<table>") and f"|d|_inf &lt;= {case.disturbance_bound:g}" in table
    assert case.name in str(case.definition)


@pytest.mark.parametrize("name", NAMES)
def test_a_definition_agrees_with_the_shipped_files(name):
    definition, case = CASES[name], mr.case_study(name)
    hidden = case.network.hidden[:-2]
    layers, width, pool = definition.shape
    assert [(layer.width, layer.pool) for layer in hidden] == [(width, pool or 2)] * layers
    assert case.starts.tolist() == definition.starts and case.paper == definition.paper
    assert (definition.fit is None) == (case.fit is None) == (case.plant is None)
    assert definition.slider is not None or case.system.state_size > 2


def test_shipped_network_has_the_paper_s_shape_and_stays_in_U(case):
    shape = {"pwa": [(3, 3)] * 3, "double_integrator": [(5, 5)] * 5}[case.name] + [(1, 2)] * 2
    assert [(layer.width, layer.pool) for layer in case.network.hidden] == shape
    limit = {"pwa": 1, "double_integrator": 2}[case.name]
    inputs = case.network(case.system.state_set.sample(np.random.default_rng(0), 20_000))
    assert np.abs(inputs).max() <= limit


def test_own_torch_module_takes_the_place_of_the_network(case):
    torch = pytest.importorskip("torch")
    module = torch.nn.Sequential(torch.nn.Linear(2, 4), torch.nn.ReLU(), torch.nn.Linear(4, 1, bias=False))
    for parameter in module.parameters():
        torch.nn.init.zeros_(parameter)
    own = mr.case_study(case.name, module)
    assert own.loop.network(np.ones(2)) == 0


def test_safe_and_terminal_sets_are_never_left_by_extreme_disturbances(case, safe, terminal):
    rng = np.random.default_rng(1)
    for P in (safe.set, terminal.set):
        x = np.vstack(
            [P.sample(rng, 20_000), P.vertices().mean(0) + (P.vertices() - P.vertices().mean(0)) * (1 - 1e-12)]
        )
        for d in case.system.modes[0].disturbance.vertices():
            assert P.contains(case.loop.step(x) + d, tol=1e-9).all()


def test_sets_are_proven_by_both_engines(case, safe, terminal):
    for P in (safe.set, terminal.set):
        for engine in ("cells", "milp"):
            assert mr.check_rpi(case.loop, P, engine).verdict == "proven"


def test_cells_agree_with_the_milp(case, safe, terminal):
    points = [*case.starts, *map(np.array, BOUNDARY_POINTS[case.name])]
    for F in (case.system.state_set, safe.set, terminal.set, *(mr.Polytope.box(x, x) for x in points)):
        cells = mr.support(case.loop, F, case.directions, engine="cells")
        milp = mr.support(case.loop, F, case.directions, engine="milp")
        np.testing.assert_allclose(cells.value, milp.value, rtol=0, atol=1e-7)
        truth = np.nextafter(mr.support(case.loop, F, case.directions, engine="exact").value, -np.inf)
        assert (milp.bound >= truth).all() and (cells.bound >= truth).all() and (cells.bound >= milp.value).all()


def test_reading_version_of_the_milp_agrees(case, terminal):
    pytest.importorskip("cvxpy")
    cells = mr.support(case.loop, terminal.set, case.directions[:3], engine="cells")
    model = mr.support(case.loop, terminal.set, case.directions[:3], engine="cvxpy")
    np.testing.assert_allclose(cells.value, model.value, atol=1e-6)


def test_both_maps_count_where_regions_share_a_boundary(case):
    for x in map(np.array, BOUNDARY_POINTS[case.name]):
        u = case.network(x)
        touching = [m for m in case.system.modes if (m.region.H @ [*x, *u] <= m.region.h + 1e-12).all()]
        reached = [m.successor(x, u) @ case.directions.T + m.disturbance.support(case.directions) for m in touching]
        cells = mr.support(case.loop, mr.Polytope.box(x, x), case.directions)
        assert len(touching) > 1 or case.name == "double_integrator"
        np.testing.assert_allclose(cells.value, np.max(reached, axis=0), atol=1e-9)


@pytest.mark.parametrize(("k", "lower", "upper"), [(2, [-1, -1], [1, 1]), (3, [0.5, -1], [1, 0])])
def test_several_steps_through_several_modes_agree_between_cells_and_milp(k, lower, upper):
    case, F = mr.case_study("pwa"), mr.Polytope.box(lower, upper)
    cells = mr.support(case.loop, F, case.directions[:2], steps=k, engine="cells")
    milp = mr.support(case.loop, F, case.directions[:2], steps=k, engine="milp")
    assert all(len(set(witness.modes)) == k for witness in cells.witness)
    np.testing.assert_allclose(cells.value, milp.value, rtol=0, atol=1e-7)


def test_three_sides_of_the_pwa_safe_set_follow_from_the_modes():
    case = mr.case_study("pwa")
    lower, upper = mr.safe_set(case.loop, case.safe_directions).set.bounding_box()
    np.testing.assert_allclose([*lower, upper[1]], [-7.3, -10, 8.52], atol=1e-8)


def test_lemma_rk_nonlinear_trajectories_of_the_plant_stay_in_the_outer_sets(terminal, case):
    if case.plant is None:
        case = mr.case_study("double_integrator")
        terminal = mr.terminal_set(case.loop, mr.safe_set(case.loop, case.safe_directions), case.directions)
    starts = terminal.history[0].sample(np.random.default_rng(2), 2000)
    paths = case.plant.simulate(case.network, starts, terminal.steps)
    for k, R in enumerate(terminal.history):
        assert R.contains(paths[:, k], tol=1e-9).all()


def test_theorem_2_needs_the_error_inside_the_disturbance_set():
    case = mr.case_study("double_integrator")
    safe = mr.safe_set(case.loop, case.safe_directions)
    terminal = mr.terminal_set(case.loop, safe, case.directions)
    assert mr.ultimately_bounded(case.plant, case.loop, safe, terminal).verdict == "proven"
    small = case.loop.with_disturbance(mr.Polytope.box([-0.118, -0.118], [0.118, 0.118]))
    refused = mr.ultimately_bounded(case.plant, small, safe, terminal)
    assert refused.verdict == "unknown" and not refused.conditions["f - f_PWA lies in D for every mode"]


def test_data_files_are_found(case):
    for file in ("network.json", "samples.csv", "seeds.csv", "seed_networks.jsonl"):
        assert data_file(case.name, file).is_file()


# -- more than two states -----------------------------------------------------------------------------


def test_larger_case_is_wired(larger):
    n, m, modes, rows, shape = {
        "three_tanks": (3, 2, 4, 8, (5, 2)),
        "four_tanks": (4, 2, 1, 8, (4, 3)),
        "aircraft_pitch": (3, 1, 1, 18, (16, 2)),
        "quadrotor": (6, 3, 1, 24, (8, 2)),
    }[larger.name]
    assert larger.system.state_size == n and len(larger.system.modes) == modes and larger.paper == {}
    assert [(layer.width, layer.pool) for layer in larger.network.hidden] == [shape, shape, (m, 2), (m, 2)]
    assert larger.directions.shape == larger.safe_directions.shape == (rows, n) and larger.starts.shape == (3, n)
    lower, upper = larger.system.modes[0].disturbance.bounding_box()
    np.testing.assert_array_equal([lower, upper], np.outer([-1, 1], [larger.disturbance_bound] * n))


def test_larger_network_stays_in_U_and_has_learnt_the_data(larger):
    lower, upper = larger.system.input_set.bounding_box()
    X = larger.system.state_set
    inputs = larger.network(np.vstack([X.sample(np.random.default_rng(0), 20_000), X.vertices()]))
    assert (inputs >= lower).all() and (inputs <= upper).all()
    error = ((larger.network(larger.data.states) - larger.data.inputs) ** 2).mean()
    assert error < 1e-3 * larger.data.inputs.var()


def test_the_aircraft_has_a_relu_network():
    for layer in mr.case_study("aircraft_pitch").network.hidden[:2]:
        assert not layer.weight[1::2].any() and not layer.bias[1::2].any()


def corners(F):
    """The vertices of F: array (v, n). In R^6, F is the product of three polygons in the planes (x_i, x_(i+3))."""
    if F.dimension < 6:
        return F.vertices()
    octagons = [F.section((i, i + 3)).vertices() for i in range(3)]
    return np.array(list(product(*octagons))).transpose(0, 2, 1).reshape(-1, 6)


def test_larger_sets_are_proven(larger):
    safe, *_, terminal = load_sets(larger.name)
    for F in (safe, terminal):
        assert mr.check_rpi(larger.loop, F, LARGER[larger.name]).verdict == "proven"
    assert terminal.is_subset(safe) and safe.is_subset(larger.system.state_set)
    assert safe.contains(larger.starts).all()
    assert terminal.contains(safe.sample(np.random.default_rng(0), 20_000)).mean() < 0.1


def test_larger_trajectories_stay_in_the_safe_set_and_enter_the_terminal_set(larger):
    safe, *_, terminal = load_sets(larger.name)
    rng, n, steps = np.random.default_rng(1), larger.system.state_size, 150
    x0 = np.vstack([safe.sample(rng, 300), corners(safe), larger.starts])
    held = rng.choice([-1.0, 1.0], (len(x0), 1, n)).repeat(steps, axis=1)  # the same corner of D all the time, or any
    drawn = rng.choice([-1.0, 1.0], (len(x0), steps, n))
    for signs in (held, drawn):
        path = larger.loop.simulate(x0, steps, larger.disturbance_bound * signs)
        assert safe.contains(path, tol=1e-6).all()
        assert terminal.contains(path[:, -1], tol=1e-6).all()


def test_larger_network_steers_to_the_origin_without_disturbance(larger):
    safe = load_sets(larger.name)[0]
    path = larger.loop.simulate(safe.sample(np.random.default_rng(2), 300), 400)
    equilibrium = larger.loop.equilibrium()
    assert np.abs(path[:, -1] - equilibrium).max() < 1e-3
    assert np.abs(equilibrium).max() < 0.05  # cm


def test_larger_bounds_dominate_dense_samples(larger):
    safe, *_, terminal = load_sets(larger.name)
    rng, C = np.random.default_rng(3), larger.directions[:: 3 if larger.name == "three_tanks" else 1]
    for F in (safe, terminal):
        x = np.vstack([F.sample(rng, 20_000), corners(F)])
        modes, u = larger.system.modes, larger.network(x)
        inside = larger.system.violation(x, u) <= 0  # on shared boundaries every mode that contains the point counts
        reached = [mode.successor(x, u)[inside[:, i]] for i, mode in enumerate(modes)]
        sampled = (np.vstack(reached) @ C.T).max(axis=0) + modes[0].disturbance.support(C)
        found = mr.support(larger.loop, F, C, engine=LARGER[larger.name])
        assert (found.bound >= sampled).all() and (found.value >= sampled - 1e-7).all()
        assert (found.bound - found.value <= 1e-6).all()


@pytest.mark.parametrize("name", ["aircraft_pitch", "quadrotor"])
def test_cells_milp_and_rational_arithmetic_agree_in_space(name):
    case, terminal = mr.case_study(name), load_sets(name)[-1]
    cells, milp, exact = (
        mr.support(case.loop, terminal, case.directions, engine=engine) for engine in ("cells", "milp", "exact")
    )
    assert (cells.bound >= exact.bound).all() and (milp.bound >= exact.bound).all()
    np.testing.assert_allclose(cells.bound, exact.bound, rtol=0, atol=1e-8)
    np.testing.assert_allclose(milp.value, exact.value, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", ["aircraft_pitch", "quadrotor"])
def test_safe_sets_in_space_are_proven_in_rational_arithmetic(name):
    found = mr.check_rpi(mr.case_study(name).loop, load_sets(name)[0], "exact")
    assert found.verdict == "proven" and found.settled == "exact arithmetic"


def test_larger_supports_agree_with_glpk(larger):
    pytest.importorskip("cvxpy")
    pytest.importorskip("cvxopt")
    terminal = load_sets(larger.name)[-1]
    V = np.ones((1, larger.system.state_size))
    found = mr.support(larger.loop, terminal, V, engine="milp")
    glpk = mr.support(larger.loop, terminal, V, engine=mr.Cvxpy("GLPK_MI"))
    np.testing.assert_allclose(found.value, glpk.value, atol=1e-6)


@pytest.mark.parametrize("name", ["four_tanks", "aircraft_pitch", "quadrotor"])
def test_larger_safe_set_is_found_again(name):
    case = mr.case_study(name)
    safe = mr.safe_set(case.loop, case.safe_directions, engine=LARGER[name])
    stored = load_sets(name)[0]
    assert safe.verdict == "proven" and safe.iterations > 0
    np.testing.assert_allclose(safe.set.support(stored.H), stored.support(stored.H), atol=1e-6)


def test_damaged_sets_are_named(tmp_path, monkeypatch):
    file = tmp_path / "certificate.json"
    monkeypatch.setattr("mireach.studies.case_studies.data_file", lambda name, file: tmp_path / file)
    head = '{"format": "mireach-certificate/1"'
    for text in (head, head + ', "template": [[1, 0]], "sets": [[]]}'):
        file.write_text(text)
        with pytest.raises(CorruptFileError, match=r"certificate\.json"):
            load_sets("three_tanks")
