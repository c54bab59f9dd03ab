"""Predictions of a fine model against solves of every frame, exact solutions, and data of another mesh."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import write_experiment
from tissuereg.errors import ConvergenceError, ExperimentError
from tissuereg.experiment.effects import (
    ActuatorGain,
    ActuatorOffset,
    Detachment,
    Gravity,
    Inclusion,
    MarkerSlip,
    Poisson,
    Relaxation,
    Set,
    Sliding,
    Stiffness,
)
from tissuereg.experiment.experiment import Case
from tissuereg.simulation import memory as memory_module
from tissuereg.simulation.experiment import simulate_plain
from tissuereg.simulation.fine import FineMeshing, FineModel, rough_element
from tissuereg.simulation.fine import model as model_module
from tissuereg.simulation.fine.elastic import guess
from tissuereg.simulation.loading import distinct_states
from tissuereg.simulation.solve import Simulator

#: Coarse at the rim: these tests check that results are the same, not that they are accurate.
COARSE = FineMeshing(rim_edge=1.0)


def case(name, times, motion):
    times = np.asarray(times, np.float64)
    given = np.asarray(motion, np.float64)[:, None] * [1.0, 0.0, 0.0]
    return Case(name, times, np.full((len(times), 2, 3), np.nan), {"push": given})


#: Up, held, down.
RAMP = case("ramp", [10.0, 10.5, 11.0, 12.0, 12.5, 13.0], [0.0, 1.0, 2.0, 2.0, 1.0, 0.0])


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    rig = tr.read_experiment(write_experiment(tmp_path_factory.mktemp("fine") / "rig"))
    return replace(rig, cases={"ramp": RAMP})


@pytest.fixture(scope="module")
def model(rig):
    return FineModel(rig, COARSE)


def stayed(model):
    """Return the nodes of the given mesh that no rim has moved."""
    given = model.experiment.mesh.nodes
    return np.flatnonzero((model.mesh.nodes[: len(given)] == given).all(axis=1))


def test_states_solved_once_are_frames_solved_each_on_its_own(model):
    output = model.simulate()["ramp"]
    each = simulate_plain(model.fine, element="tet10")["ramp"]
    rows = stayed(model)
    np.testing.assert_allclose(output.displacement[:, rows], each.displacement[:, rows], atol=1e-5)
    np.testing.assert_allclose(output.forces["push"], each.forces["push"], atol=0.01)
    np.testing.assert_array_equal(output.displacement[2], output.displacement[3])
    # Markers follow the mid-edge nodes too, which moves them a little.
    np.testing.assert_allclose(output.markers, each.markers, atol=0.1)


def test_displacements_are_those_of_the_given_nodes_where_rims_have_moved_them(model):
    output = model.simulate()["ramp"]
    given = model.experiment.mesh
    assert output.displacement.shape == (len(RAMP.times), given.n_nodes, 3)
    moved = np.setdiff1d(np.arange(given.n_nodes), stayed(model))
    assert len(moved)
    assert np.isin(moved, given.surface_nodes).all()
    each = simulate_plain(model.fine, element="tet10")["ramp"]
    # A node that slid by a share of an edge answers otherwise than the place that it came from.
    slid = model.mesh.nodes[moved] - given.nodes[moved]
    off = output.displacement[2, moved] - each.displacement[2, moved]
    assert 1e-3 < np.abs(off).max() < np.linalg.norm(slid, axis=1).max()
    # That place is read as a marker there is.
    there = replace(model.experiment, marker_names=("here",), marker_reference=given.nodes[moved[:1]])
    blank = {name: replace(c, markers=np.full((len(c.times), 1, 3), np.nan)) for name, c in there.cases.items()}
    seen = FineModel(replace(there, cases=blank), COARSE).simulate()["ramp"].markers[:, 0] - given.nodes[moved[0]]
    np.testing.assert_allclose(output.displacement[:, moved[0]], seen, atol=1e-4)


def test_threads_do_not_matter_and_progress_ends_at_all_frames(model):
    seen = []
    one = model.simulate(threads=1, progress=lambda done, of: seen.append((done, of)))["ramp"]
    two = model.simulate(threads=2)["ramp"]
    np.testing.assert_array_equal(one.markers, two.markers)
    assert seen[-1] == (6, 6)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_equal_loads_are_one_state_in_the_order_in_which_they_come():
    states, of_frame = distinct_states(RAMP)
    assert of_frame.tolist() == [0, 1, 2, 2, 1, 0]
    assert states[:, 1].tolist() == [0.0, 0.5, 1.0]


def test_a_guess_is_exact_for_a_parabola_and_the_nearest_state_off_the_line():
    rng = np.random.default_rng(4)
    a, b = rng.standard_normal((2, 5, 3))
    line = np.array([0.6, 0.0, 0.8])
    solved = [(s * line, s * a + s**2 * b) for s in (0.0, 1.0, 2.0)]
    np.testing.assert_allclose(guess(3.0 * line, solved), 3.0 * a + 9.0 * b, rtol=1e-12)
    np.testing.assert_array_equal(guess(np.array([1.0, 0.5, 1.6]), solved), solved[2][1])
    assert guess(np.array([0.0, 1.0, 0.0]), solved[:1]) is None
    assert guess(line, []) is None


def test_a_bar_in_uniform_stretch_is_exact(rig):
    top = np.flatnonzero(rig.mesh.nodes[:, 2] == 40.0)
    pull = np.array([0.0, 4.0, 8.0])[:, None] * [0.0, 0.0, 1.0]
    bar = replace(
        rig,
        mesh=rig.mesh.with_node_set("push", top),
        actuators=(replace(rig.actuators[0], nodes=top, rule="push"),),
        cases={"pull": Case("pull", np.arange(3.0), np.full((3, 2, 3), np.nan), {"push": pull})},
    )
    output = FineModel(bar, COARSE).simulate([Poisson(poisson=0.0)])["pull"]
    stretch = 1.0 + pull[:, 2] / 40.0
    # Without lateral strain: mu (l - 1/l) on 600 mm^2, mu = 5 kPa.
    np.testing.assert_allclose(output.forces["push"][:, 2], 600.0 * 5.0 * (stretch - 1.0 / stretch), atol=0.02)
    np.testing.assert_allclose(output.markers[:, :, 2], np.outer(stretch, rig.marker_reference[:, 2]), atol=1e-5)
    np.testing.assert_allclose(output.targets["deep"][:, 2], 20.0 * stretch, atol=1e-5)


def test_a_shifted_pad_is_cut_out_where_it_sits(rig, model):
    output = model.simulate([ActuatorOffset(actuator="push", shift_mm=(-6.0, 0.0, 0.0))])["ramp"]
    ball = {"centre_mm": [24.0, 10.0, 40.0], "radius_mm": 8.0}
    there = FineModel(replace(rig, actuators=(replace(rig.actuators[0], rule=ball),)), COARSE)
    np.testing.assert_array_equal(output.markers, there.simulate()["ramp"].markers)


def test_what_has_come_off_within_a_ball_ends_at_its_rim(rig):
    model = FineModel(rig, FineMeshing(rim_edge=0.35))

    def pushed(radius):
        effect = Detachment(boundary="base", centre_mm=(30.0, 10.0, 0.0), radius_mm=radius)
        return model.simulate([effect])["ramp"].forces["push"][2, 0]

    # The base has nodes 7.5 mm apart, none of them between these radii: without a cut all would be the same.
    forces = np.array([pushed(radius) for radius in (10.0, 11.0, 12.0)])
    np.testing.assert_array_less(np.diff(forces) / forces[0], -0.005)


def test_effects_of_body_actuators_and_trackers_act(model):
    plain = model.simulate()["ramp"]
    stiff = model.simulate([Stiffness(young_kpa=20.0)])["ramp"]
    np.testing.assert_allclose(stiff.forces["push"], 2.0 * plain.forces["push"], atol=0.05)
    gain = model.simulate([ActuatorGain(actuator="push", gain=0.5)])["ramp"]
    np.testing.assert_allclose(gain.markers[2], plain.markers[1], atol=1e-4)
    hard = model.simulate([Inclusion(centre_mm=(15.0, 10.0, 30.0), semi_axes_mm=(8.0, 8.0, 8.0), contrast=4.0)])["ramp"]
    assert (np.abs(hard.forces["push"][2, 0]) > 1.02 * np.abs(plain.forces["push"][2, 0])).all()
    slipped = model.simulate([MarkerSlip(marker="P2", offset_mm=(0.0, 0.0, 1.0), from_time_s=11.5)])["ramp"]
    np.testing.assert_allclose(slipped.markers[:, 1, 2] - plain.markers[:, 1, 2], [0, 0, 0, 1, 1, 1], atol=1e-12)
    loose = model.simulate([Detachment(boundary="base", azimuth_deg=180.0, share=0.3)])["ramp"]
    assert abs(loose.forces["push"][2, 0]) < 0.95 * abs(plain.forces["push"][2, 0])


@pytest.mark.parametrize(
    "effect",
    [
        Sliding(boundary="base", spring_kpa_per_mm=5.0),
        Sliding(boundary="base", friction=0.3, cohesion_kpa=0.1),
        Gravity(direction=(0.0, 0.0, -1.0), in_reference=True),
    ],
    ids=["springs", "friction", "hanging"],
)
def test_what_a_body_rests_on_is_solved_in_ten_node_elements(rig, effect, monkeypatch):
    model = FineModel(rig, COARSE)
    solved = []

    def counted(*given, **settings):
        frames = solve_frames(*given, **settings)
        solved.append([report["iterations"] for report in frames.reports])
        return frames

    solve_frames = memory_module.solve_frames
    monkeypatch.setattr(memory_module, "solve_frames", counted)
    output = model.simulate([effect])["ramp"]
    each = simulate_plain(replace(model.fine, effects=(effect,)), element="tet10")["ramp"]
    rows = stayed(model)
    np.testing.assert_allclose(output.displacement[:, rows], each.displacement[:, rows], atol=1e-4)
    np.testing.assert_allclose(output.forces["push"], each.forces["push"], atol=0.05)
    # Up and down again are one where nothing sticks; where the load stands, nothing is solved at all.
    assert len(solved[0]) == (5 if effect.id == "sliding" and effect.friction else 3)
    assert sum(solved[0]) < sum(solved[1])
    model.simulate([effect], warm=True)
    warm = model.simulate([effect], warm=True)["ramp"]
    np.testing.assert_allclose(warm.displacement, output.displacement, atol=5e-4)


@pytest.mark.parametrize("effect", [Relaxation(g=(0.4,), tau_s=(1.0,)), Set(fraction=0.2)], ids=lambda e: e.id)
def test_frames_through_time_are_nearly_solved_by_correction(rig, effect):
    model = FineModel(rig, COARSE)
    quick, full = (model.simulate([effect], through_time=how)["ramp"] for how in ("corrected", "solved"))
    rough = simulate_plain(replace(model.fine, effects=(effect,)))["ramp"]
    missing = np.linalg.norm(rough.forces["push"] - full.forces["push"])
    assert np.linalg.norm(quick.forces["push"] - full.forces["push"]) < 0.25 * missing
    missing = np.linalg.norm(rough.markers - full.markers)
    assert np.linalg.norm(quick.markers - full.markers) < 0.35 * missing


def test_a_correction_is_known_at_the_second_call(model, monkeypatch):
    slow = Relaxation(g=(0.4,), tau_s=(1.0,))
    first = model.simulate([slow])["ramp"]

    def refuse(*_, **__):
        raise AssertionError

    monkeypatch.setattr(model_module, "solve_states", refuse)
    seen = []
    second = model.simulate([slow], progress=lambda done, of: seen.append((done, of)))["ramp"]
    np.testing.assert_array_equal(first.markers, second.markers)
    assert seen[-1] == (18, 18)


def test_warm_calls_give_the_same_answer_with_less_work(rig, monkeypatch):
    rig = replace(rig, cases={"far": case("far", [0.0, 1.0, 2.0], [0.0, 4.0, 8.0])})
    work = []

    def counted(self, *given, **settings):
        found = solve(self, *given, **settings)
        work.append(found.report["iterations"])
        return found

    solve = Simulator.solve
    monkeypatch.setattr(Simulator, "solve", counted)
    model = FineModel(rig, COARSE)
    cold = model.simulate([Poisson(poisson=0.4)])["far"]
    needed = sum(work)
    model.simulate([Poisson(poisson=0.42)], warm=True)
    work.clear()
    warm = model.simulate([Poisson(poisson=0.4)], warm=True)["far"]
    assert 0 < sum(work) < needed
    work.clear()
    model.simulate([Poisson(poisson=0.4)], warm=True)
    assert sum(work) == 0
    np.testing.assert_allclose(warm.displacement, cold.displacement, atol=5e-4)
    np.testing.assert_allclose(warm.forces["push"], cold.forces["push"], atol=0.05)


def test_an_unknown_case_is_refused(model):
    with pytest.raises(ExperimentError, match="must have a case 'twist'"):
        model.simulate(cases=["twist"])


def test_a_case_without_equilibrium_is_refused(rig):
    far = replace(rig, cases={"far": case("far", [0.0], [-500.0])})
    with pytest.raises(ConvergenceError, match="case 'far' must have a frame that finds equilibrium"):
        FineModel(far, COARSE).simulate()


def test_data_of_another_mesh_are_met_far_better_than_by_the_users(shared_data):
    folder = shared_data / "examples" / "null"
    if not folder.is_dir():
        pytest.skip("no open examples")
    rig = tr.read_experiment(folder)
    case = rig.cases["push_z"]
    # At rest and held at full stroke.
    frames = [2, 4, 5, 6, 7]
    case = replace(
        case,
        times=case.times[frames],
        markers=case.markers[frames],
        displacements={name: values[frames] for name, values in case.displacements.items()},
        forces={name: values[frames] for name, values in case.forces.items()},
    )
    rig = replace(rig, cases={"push_z": case})
    truth = [Stiffness(young_kpa=8.4)]
    fine = FineModel(rig).simulate(truth)["push_z"]
    user = simulate_plain(replace(rig, effects=tuple(truth)))["push_z"]
    measured = case.forces["push_z"][-1]
    off = [np.linalg.norm(output.forces["push_z"][-1] - measured) / np.linalg.norm(measured) for output in (fine, user)]
    assert off[0] < 0.02 < 0.1 < off[1]
    # The noise of four frames, 0.025 mm, is in both.
    held = case.markers[-4:].mean(axis=0)
    left = [np.sqrt(np.mean((output.markers[-1] - held) ** 2)) for output in (fine, user)]
    assert left[0] < 0.03 < 0.06 < left[1]


def test_elements_of_first_order_are_averaged_where_plain_ones_lock(rig):
    for poisson, element in ((0.45, "tet4"), (0.49, "tet4-averaged")):
        assert rough_element(replace(rig, material=tr.Material(10.0, poisson))) == element
