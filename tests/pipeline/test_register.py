"""Does the whole thing register? Synthetic truths from another model than the prior's."""

import json

import numpy as np
import pytest

import tissuereg as tr
from support.small_model import SMALL_MODEL
from tissuereg.errors import MarkerError, ModelError, ShapeError

INNER = {"deep": (18.0, 12.0, 22.0), "near the top": (12.0, 8.0, 34.0)}


@pytest.fixture(scope="module")
def leaned(block_mesh):
    """A block pulled sideways at its top: displacement by ten-node elements, twice as stiff, tilted load."""
    top = block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] > 40 - 1e-9).all(axis=1)]
    true_load = tr.Load(traction=(top, (0.2, 0.07, 0.03)))
    believed = tr.Load(traction=(top, (0.2, 0.02, 0.0)))
    truth = tr.simulate(block_mesh, true_load, tr.Material(16.0, 0.46), element="tet10").displacement
    return truth, believed


@pytest.fixture(scope="module")
def seen(block_mesh, leaned):
    truth, _ = leaned
    rng = np.random.default_rng(11)
    nodes = rng.choice(block_mesh.surface_nodes[block_mesh.nodes[block_mesh.surface_nodes, 2] > 8], 12, replace=False)
    measured = block_mesh.nodes[nodes] + truth[nodes] + 0.05 * rng.standard_normal((12, 3))
    return tr.Markers(block_mesh.nodes[nodes], measured, 0.05)


def true_place(mesh, truth, point):
    from tissuereg.body.observe import TargetObservation

    inside = TargetObservation(mesh, {"t": point})
    return np.asarray(point) + inside.predict(truth[inside.nodes])[0]


def test_without_model_or_load_the_body_is_found_from_markers_alone(block_mesh, leaned, seen):
    truth, _ = leaned
    result = tr.register(block_mesh, seen, targets=INNER)
    before = np.linalg.norm(truth, axis=1).mean()
    after = np.linalg.norm(result.displacement - truth, axis=1).mean()
    assert after < 0.12 * before
    assert result.markers.after_rms_mm < 0.2
    assert result.trust.ok, result.trust.reasons
    for name, point in INNER.items():
        off = result.target(name).mean - true_place(block_mesh, truth, point)
        assert off @ np.linalg.solve(result.target(name).covariance, off) < 16.3  # 99.9 % of chi-square, 3 degrees


def test_a_believed_load_gives_the_simulation_and_a_better_answer(block_mesh, leaned, seen):
    truth, believed = leaned
    result = tr.register(tr.Body(block_mesh, material=tr.Material(8.0, 0.45)), seen, load=believed, targets=INNER)
    simulated = np.linalg.norm(
        np.array([t.simulation - true_place(block_mesh, truth, t.reference) for t in result.targets.values()]), axis=1
    )
    registered = np.linalg.norm(
        np.array([t.mean - true_place(block_mesh, truth, t.reference) for t in result.targets.values()]), axis=1
    )
    assert registered.mean() < 0.15 * simulated.mean()
    assert result.min_det_f > 0.3


def test_the_same_seed_gives_the_same_bits_at_any_thread_count(block_mesh, seen):
    one, two = (
        tr.register(block_mesh, seen, targets=INNER, seed=3, settings=tr.RegisterSettings(threads=threads))
        for threads in (1, 2)
    )
    assert np.array_equal(one.displacement, two.displacement)
    assert np.array_equal(one.std, two.std)
    assert np.array_equal(one.target("deep").covariance, two.target("deep").covariance)


def test_another_seed_gives_another_ensemble_and_nearly_the_same_answer(block_mesh, leaned, seen):
    a, b = (tr.register(block_mesh, seen, seed=seed) for seed in (0, 1))
    difference = np.linalg.norm(a.displacement - b.displacement, axis=1).mean()
    assert 0 < difference < 0.1 * np.linalg.norm(leaned[0], axis=1).mean()


def test_the_same_call_does_the_same_work_and_gives_the_same_bits(block_mesh, seen):
    first, second = tr.register(block_mesh, seen), tr.register(block_mesh, seen)
    assert first.work == second.work
    assert np.array_equal(first.displacement, second.displacement)


def test_a_marker_that_was_not_seen_is_listed_and_predicted(block_mesh, leaned, seen):
    measured = seen.measured.copy()
    measured[4] = np.nan
    result = tr.register(block_mesh, tr.Markers(seen.reference, measured, 0.05))
    assert result.markers.dropped == (("M5", "not seen"),)
    assert "M5" not in result.markers.used
    predicted = result.unseen["M5"]
    off = predicted.mean - seen.measured[4]
    assert off @ np.linalg.solve(predicted.covariance, off) < 16.3  # 99.9 % of chi-square, 3 degrees
    assert np.sqrt(np.trace(predicted.covariance)) < 0.5 * np.linalg.norm(seen.measured[4] - seen.reference[4])


def test_a_marker_ten_sigma_off_is_named(block_mesh, seen):
    measured = seen.measured.copy()
    measured[7] += (1.0, -1.0, 1.0)
    result = tr.register(block_mesh, tr.Markers(seen.reference, measured, 0.05))
    assert not result.trust.ok
    assert [reason for reason in result.trust.reasons if reason.startswith("wrong marker: M8 ")]
    assert result.markers.dropped == (("M8", "wrong"),)
    # It does not bend the body: as if it had not been seen.
    measured[7] = np.nan
    without = tr.register(block_mesh, tr.Markers(seen.reference, measured, 0.05))
    off = np.linalg.norm(result.displacement - without.displacement, axis=1)
    assert off.mean() < 0.1
    assert (off < 3.0 * without.std + 1e-9).all()


def test_plain_arrays_serve_as_well(block_mesh, seen):
    plain = tr.register((block_mesh.nodes, block_mesh.tets, block_mesh.fixed_nodes), (seen.reference, seen.measured))
    assert plain.displacement.shape == (block_mesh.n_nodes, 3)


def test_a_foreign_simulation_is_the_start_and_is_improved(block_mesh, leaned, seen):
    truth, believed = leaned
    output = tr.simulate(block_mesh, believed, tr.Material(8.0, 0.45)).displacement
    result = tr.register(block_mesh, seen, simulation=output)
    assert result.markers.before_rms_mm > 5 * result.markers.after_rms_mm
    assert (
        np.linalg.norm(result.displacement - truth, axis=1).mean()
        < 0.15 * np.linalg.norm(output - truth, axis=1).mean()
    )


def test_the_phantom_is_registered_by_the_shipped_network():
    from tissuereg.phantom.event import LESION_MM, make_event

    event = make_event(seed=0)
    simulation = tr.simulate(event.mesh, event.load, event.material).displacement
    result = tr.register(
        event.mesh, event.markers, model="phantom", simulation=simulation, targets={"lesion": LESION_MM}
    )
    before = np.linalg.norm(simulation - event.true_displacement, axis=1).mean()
    after = np.linalg.norm(result.displacement - event.true_displacement, axis=1).mean()
    assert after < 0.5 * before
    assert result.model["kind"] == "closure"
    assert result.model["source"] == "shipped"
    lesion = result.target("lesion")
    assert np.linalg.norm(lesion.mean - event.true_lesion) < 0.5 * np.linalg.norm(lesion.simulation - event.true_lesion)


def test_a_model_that_was_never_calibrated_registers_the_phantom_by_what_it_states():
    from tissuereg.phantom.event import LESION_MM, make_event

    event = make_event(seed=0, size="small")
    simulation = tr.simulate(event.mesh, event.load, event.material).displacement
    for known, least in (
        (simulation, np.linalg.norm(simulation - event.true_displacement, axis=1).mean()),
        (None, 4.0),
    ):
        result = tr.register(
            event.mesh, event.markers, model=SMALL_MODEL, simulation=known, targets={"lesion": LESION_MM}
        )
        assert np.linalg.norm(result.displacement - event.true_displacement, axis=1).mean() < 0.5 * least
        lesion = result.target("lesion")
        off = lesion.mean - event.true_lesion
        assert off @ np.linalg.solve(lesion.covariance, off) < 16.3  # 99.9 % of chi-square, 3 degrees
        assert result.trust.ok, result.trust.reasons


def with_a_wrong_marker(size, simulated):
    """Return an event of the phantom, its simulation or None, and its markers, of which one is 8 mm off."""
    from tissuereg.phantom.event import make_event

    event = make_event(seed=0, size=size)
    simulation = tr.simulate(event.mesh, event.load, event.material).displacement if simulated else None
    measured = event.markers.measured.copy()
    measured[3] += (0.0, 6.0, 6.0)
    return event, simulation, tr.Markers(event.markers.reference, measured, 0.1)


@pytest.mark.parametrize("simulated", [False, True])
def test_a_model_that_was_never_calibrated_names_a_wrong_marker(simulated):
    event, simulation, seen = with_a_wrong_marker("small", simulated)
    result = tr.register(event.mesh, seen, model=SMALL_MODEL, simulation=simulation)
    assert [reason for reason in result.trust.reasons if reason.startswith(f"wrong marker: {seen.names[3]} ")]
    # Nothing was rehearsed that would say how rare such a marker is.
    assert result.markers.dropped == ()


@pytest.mark.parametrize("simulated", [False, True])
def test_a_calibrated_model_leaves_a_wrong_marker_out(simulated):
    event, simulation, seen = with_a_wrong_marker("full", simulated)
    result = tr.register(event.mesh, seen, model="phantom", simulation=simulation)
    name = seen.names[3]
    assert result.markers.dropped == ((name, "wrong"),)
    # It does not bend the body: as if it had not been seen.
    measured = seen.measured.copy()
    measured[3] = np.nan
    without = tr.register(event.mesh, tr.Markers(seen.reference, measured, 0.1), model="phantom", simulation=simulation)
    assert np.array_equal(result.displacement, without.displacement)
    off = event.markers.measured[3] - result.unseen[name].mean
    assert off @ np.linalg.solve(result.unseen[name].covariance, off) < 16.3
    if simulated:
        # So rare that it is a reason against the answer, too; the only one that the other markers do not give.
        (reason,) = set(result.trust.reasons) - set(without.trust.reasons)
        assert reason.startswith(f"wrong marker: {name} does not fit the others (p = ")
        assert reason.endswith("was left out")


def test_a_model_for_another_mesh_is_refused(block_mesh, seen):
    with pytest.raises(ModelError, match=r"must have been trained for this mesh: it knows a mesh of 4258 nodes"):
        tr.register(block_mesh, seen, model="phantom")


def test_a_simulation_of_another_mesh_or_with_nan_is_refused(block_mesh, seen):
    with pytest.raises(ShapeError, match=r"`simulation` must have shape"):
        tr.register(block_mesh, seen, simulation=np.zeros((7, 3)))
    spoilt = np.zeros((block_mesh.n_nodes, 3))
    spoilt[5, 1] = np.nan
    with pytest.raises(ShapeError, match=r"`simulation` must be finite, got .* at node 5"):
        tr.register(block_mesh, seen, simulation=spoilt)


def test_markers_all_missing_are_refused(block_mesh, seen):
    with pytest.raises(MarkerError, match="at least one marker must have been seen; all 12 are missing"):
        tr.register(block_mesh, (seen.reference, np.full((12, 3), np.nan)))


def test_saving_writes_six_files_with_finite_numbers(block_mesh, seen, tmp_path):
    result = tr.register(block_mesh, seen, targets=INNER)
    result.save(tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "field.npz", "registered.png", "registered.vtu", "registration.json", "targets.csv", "targets.mrk.json",
    ]  # fmt: skip
    summary = json.loads(
        (tmp_path / "out" / "registration.json").read_text(encoding="utf-8"), parse_constant=pytest.fail
    )
    assert summary["schema"] == "tissuereg.registration/1"
    radii = summary["targets"]["deep"]["region90_radii_mm"]
    assert radii == sorted(radii)
    result.report(tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<div class='viewer'" in page
    assert "http" not in page
