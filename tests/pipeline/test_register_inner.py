"""Markers inside the body move with the tissue around them; targets that were seen are such markers."""

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, run_json
from support.pushes import ELEMENT, MATERIAL, push
from support.slicer import write_mrk
from support.small_model import SMALL_MODEL
from tissuereg.body.observe import TargetObservation
from tissuereg.errors import MarkerError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import write_markers, write_points
from tissuereg.phantom.event import LESION_MM, make_event

#: Places 5 to 16 mm below the skin of the slab, and a target between them.
SEEDS = np.array([[20.0, 20.0, 8.0], [40.0, 18.0, 14.0], [34.0, 40.0, 10.0], [22.0, 36.0, 15.0], [30.0, 28.0, 12.0]])
LESION = np.array([30.0, 30.0, 16.0])
STD = 0.05


def where(places):
    """Return the true deformed places (n, 3), mm, of inner places of the slab."""
    inner = TargetObservation(push().mesh, {str(i): place for i, place in enumerate(places)})
    return places + inner.predict(push().displacement[inner.nodes])


def seeds(seed=0, off=0.0):
    noise = STD * np.random.default_rng(seed).standard_normal(SEEDS.shape)
    return tr.Markers(SEEDS, where(SEEDS) + noise + off, STD, [f"S{i + 1}" for i in range(len(SEEDS))])


def registered(markers, **more):
    body = tr.Body(push().mesh, MATERIAL, ELEMENT)
    return tr.register(body, markers, targets={"lesion": LESION}, settings=tr.RegisterSettings(threads=1), **more)


def error(result):
    return float(np.linalg.norm(result.target("lesion").mean - where(LESION[None])[0]))


def joined(one, other):
    both = [np.concatenate(parts) for parts in ((one.reference, other.reference), (one.measured, other.measured))]
    return tr.Markers(*both, STD, [*one.names, *other.names])


def test_seeds_are_used_where_they_are_and_bring_the_target_closer_than_skin_alone():
    skin = push().markers(STD).only([0, 2, 5, 9, 12])
    alone, with_seeds = registered(skin), registered(joined(skin, seeds()))
    for result in (with_seeds, registered(seeds())):
        assert result.trust.ok, result.trust.reasons
        assert result.markers.inner == seeds().names
        assert set(seeds().names) <= set(result.markers.used)
        assert result.target("lesion").region(0.90).contains(where(LESION[None])[0])
    assert alone.markers.inner == ()
    assert error(with_seeds) < 0.7 * error(alone)
    assert with_seeds.to_json()["markers"]["inner"] == list(seeds().names)


def test_a_seed_that_is_wrong_is_still_found_out():
    markers = joined(push().markers(STD), seeds())
    places = markers.measured.copy()
    places[-1] += [0.0, 5.0, 0.0]
    result = registered(tr.Markers(markers.reference, places, STD, markers.names))
    assert [name for name, why in result.markers.dropped if why == "wrong"] == ["S5"]


def test_a_marker_in_the_middle_of_a_thick_body_is_not_far_from_the_surface(block_mesh):
    deep = np.array([[15.0, 10.0, 20.0], [12.0, 9.0, 28.0], [18.0, 11.0, 14.0]])
    for std in (0.1, 2.0):
        result = tr.register(block_mesh, tr.Markers(deep, deep + np.array([0.3, 0.0, 0.0]), std))
        assert result.markers.inner == ("M1", "M2", "M3")
        assert result.trust.ok, result.trust.reasons


@pytest.mark.parametrize("n_skin", [2, 4, 9])
def test_any_mixture_of_skin_and_seeds_is_plausible(n_skin):
    rng = np.random.default_rng(n_skin)
    more = np.concatenate([SEEDS, rng.uniform([15.0, 15.0, 5.0], [45.0, 45.0, 18.0], (7, 3))])
    skin = push().markers(STD, off=1.0).only(np.arange(n_skin))
    deep = tr.Markers(more, where(more), STD, [f"S{i + 1}" for i in range(len(more))])
    result = registered(joined(skin, deep))
    assert result.trust.ok, result.trust.reasons


def test_a_registrar_and_a_tracker_attach_a_seed_as_register_does():
    body, once = tr.Body(push().mesh, MATERIAL, ELEMENT), registered(seeds())
    registrar = tr.Registrar(body, seeds(), targets={"lesion": LESION}, settings=tr.RegisterSettings(threads=1))
    again = registrar.register(seeds().measured)
    np.testing.assert_array_equal(again.displacement, once.displacement)
    tracker = tr.Tracker(registrar)
    for time_s, off in ((0.0, 0.0), (0.1, 0.02)):
        tracked = tracker.update(time_s, seeds(off=off).measured)
        assert tracked.markers.inner == seeds().names
        assert tracked.markers.used == seeds().names


def test_a_trained_model_takes_seeds_too():
    event = make_event(seed=0, size="small")
    places = np.array([LESION_MM, [10.0, 5.0, 15.0], [-12.0, 8.0, 12.0]])
    inner = TargetObservation(event.mesh, {str(i): place for i, place in enumerate(places)})
    true = places + inner.predict(event.true_displacement[inner.nodes])
    target = places[0] + [3.0, 0.0, 3.0]
    found = {}
    for count in (0, 3):
        markers = event.markers.with_seen(
            {f"S{i}": place for i, place in enumerate(places)}, {f"S{i}": true[i] for i in range(count)}
        )
        simulation = tr.simulate(event.mesh, event.load, event.material).displacement
        result = tr.register(event.mesh, markers, model=SMALL_MODEL, simulation=simulation, targets={"near": target})
        assert result.markers.inner == tuple(f"S{i}" for i in range(count))
        assert set(result.markers.inner) <= set(result.markers.used)
        found[count] = result
    assert [reason for reason in found[3].trust.reasons if reason not in found[0].trust.reasons] == []
    spread = [float(np.trace(result.target("near").covariance)) for result in found.values()]
    assert spread[1] < spread[0]


def test_a_target_that_was_seen_counts_by_its_name():
    skin = push().markers(STD).only([0, 2, 5, 9, 12])
    seen = skin.with_seen({"lesion": LESION, "other": SEEDS[0]}, {"lesion": where(LESION[None])[0]}, std=0.1)
    assert seen.axis_std[-1].tolist() == [0.1, 0.1, 0.1]
    result = registered(seen)
    assert "lesion" in result.markers.used
    assert result.markers.inner == ("lesion",)
    assert error(result) < 0.5 * error(registered(skin))


def test_a_seen_target_that_is_none_or_has_a_markers_name_is_refused():
    skin = push().markers(STD)
    with pytest.raises(MarkerError, match=r"every name in `seen` must be in `targets` \(lesion\), got 'leison'"):
        skin.with_seen({"lesion": LESION}, {"leison": LESION})
    with pytest.raises(MarkerError, match="every name in `seen` must be in `std`"):
        skin.with_seen({"lesion": LESION}, {"lesion": LESION}, std={})
    with pytest.raises(MarkerError, match="unique, repeated: M1"):
        skin.with_seen({"M1": LESION}, {"M1": LESION})


def test_the_command_takes_seen_targets_from_a_table_and_from_points_of_slicer(tmp_path, capsys):
    mesh, skin = push().mesh, push().markers(STD)
    at = where(LESION[None])[0]
    write_vtu(tmp_path / "body.vtu", mesh)
    write_markers(tmp_path / "skin.csv", skin)
    write_points(tmp_path / "targets.csv", {"lesion": LESION, "gone": SEEDS[0]})
    cells = ",".join(map(repr, at.tolist()))
    (tmp_path / "seen.csv").write_text(f"target,x_mm,y_mm,z_mm,std_mm\nlesion,{cells},0.2\ngone,,,,\n")
    write_mrk(tmp_path / "seen.mrk.json", {"lesion": tuple(at.tolist())}, "LPS")
    given = ("register", tmp_path / "body.vtu", tmp_path / "skin.csv", "--targets", tmp_path / "targets.csv")
    for name, std, lost in (("seen.csv", 0.2, ["gone"]), ("seen.mrk.json", 0.1, [])):
        code, said, _ = run_json(
            capsys, *given, "--seen", tmp_path / name, "--out", tmp_path / name[-4:], "--threads", 1, "--frame", "LPS"
        )
        assert code == 0
        assert said["markers"]["used"] == [*skin.names, "lesion"]
        assert said["markers"]["inner"] == ["lesion", *lost]
        assert [one["marker"] for one in said["markers"]["dropped"]] == lost
        assert "inside" in (tmp_path / name[-4:] / "report.html").read_text()
        places, stds = tr.read_seen(tmp_path / name)
        assert stds["lesion"] == std
        np.testing.assert_allclose(places["lesion"], at)
    (tmp_path / "seen.csv").write_text("target,x_mm,y_mm,z_mm\nleison,1,2,3\n")
    code, _, err = run(capsys, *given, "--seen", tmp_path / "seen.csv", "--out", tmp_path / "none")
    assert code == 2
    assert "seen.csv: every name in `seen` must be in `targets` (lesion, gone), got 'leison'" in " ".join(err.split())
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("name", ["seeds0", "seeds1", "skin_and_seeds0"])
def test_implanted_seeds_of_an_organ_are_kept_and_bring_the_lesion_closer(shared_data, name):
    cases = shared_data / "cases"
    mesh, targets = tr.read_mesh(cases / "organ.vtu"), tr.read_targets(cases / "targets.csv")
    truth = tr.read_targets(cases / "truth.csv")["lesion"]
    result, skin = (
        tr.register(mesh, tr.read_markers(cases / file), targets=targets)
        for file in (f"implanted/{name}.csv", "markers.csv")
    )
    seeds = [name for name in result.all_markers.names if name.startswith("S")]
    assert list(result.markers.inner) == seeds
    assert result.markers.dropped == ()
    assert result.trust.ok, result.trust.reasons
    off, before = (np.linalg.norm(one.target("lesion").mean - truth) for one in (result, skin))
    assert off < 0.5 * before
    assert result.target("lesion").region(0.90).contains(truth)
