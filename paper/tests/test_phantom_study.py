"""The phantom experiment: recordings, methods on them, and what is counted."""

import json
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.small_model import SMALL_MODEL
from tissuereg._base.clock import Clock
from tissuereg.errors import ArgumentError, FormatError, MarkerError
from tissuereg.io.fields import write_npz
from tissuereg.registration.learned.network import NetworkModel
from tissuereg_paper.rivals import (
    EnsembleOfSimulations,
    Estimate,
    KfAdmm,
    MeanOfMarkers,
    Network,
    Rigid,
    Rival,
    VariedNetwork,
)
from tissuereg_paper.studies import contest as contests
from tissuereg_paper.studies.believed import BELIEVED, CONDITIONS, EVERY, MOTION, PLAIN, Believed, measured
from tissuereg_paper.studies.contest import Contest, NetworkAlone, Simulated
from tissuereg_paper.studies.phantom import _goals, _rows, _short, merged, phantom_study
from tissuereg_paper.studies.phantom_pages import phantom_markdown
from tissuereg_paper.studies.rigs import Pad, Rig, read_rig, read_rigs
from tissuereg_paper.studies.run import Running, _delivered, run_contest
from tissuereg_paper.studies.runs import Run
from tissuereg_paper.studies.variants import read_variants

SHARES = np.concatenate([np.linspace(0.1, 1.0, 12), np.linspace(0.9, 0.0, 12)])


@pytest.fixture(scope="module")
def mesh():
    return tr.phantom.phantom_mesh("small")


@pytest.fixture(scope="module")
def rig(mesh):
    """A rig whose truth is the believed simulation, at nodes of the mesh."""
    free = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)
    inner = np.setdiff1d(np.arange(mesh.n_nodes), np.union1d(mesh.surface_nodes, mesh.fixed_nodes))
    seen, below = free[:: len(free) // 15][:15], inner[:: len(inner) // 11][:11]
    levels = {"marker": (2, 15, 3), "sensor": (2, 3), "inner": (2, 10, 3)}
    bare = Rig(
        name="scenario1-00",
        scenario=1,
        seed=0,
        pads=(Pad(np.array([58.0, 0.0, 20.0]), np.array([-6.0, 0.0, 0.0]), 14.0),),
        frame_s=0.025,
        motion=SHARES,
        reference_mm=mesh.nodes[seen],
        sensor_mm=mesh.nodes[below[0]],
        inner_mm=mesh.nodes[below[1:]],
        shares=np.array([0.5, 1.0]),
        pad_forces=np.zeros((2, 1, 3)),
        truth={"scenario": 1, "seed": 0},
        **{f"{name}_levels_mm": np.zeros(shape) for name, shape in levels.items()},
    )
    path = Believed(bare, mesh, 1).path
    fields = path.fields_mm[1:3]
    return replace(
        bare,
        marker_levels_mm=fields[:, seen],
        sensor_levels_mm=fields[:, below[0]],
        inner_levels_mm=fields[:, below[1:]],
        pad_forces=path.pushes[1:3, None, None] * np.array([-1.0, 0.0, 0.0]),
    )


def arrays_of(rig):
    """Return a rig as the arrays of its file."""
    strokes = np.array([pad.stroke_mm for pad in rig.pads])
    sizes = np.linalg.norm(strokes, axis=1)
    return {
        "pad_centre_mm": [pad.centre_mm for pad in rig.pads],
        "pad_direction": strokes / sizes[:, None],
        "pad_radius_mm": [pad.radius_mm for pad in rig.pads],
        "pad_stroke_mm": sizes,
        "motion": rig.motion,
        "frame_s": rig.frame_s,
        "shares": rig.shares,
        "markers_mm": rig.reference_mm,
        "sensor_mm": rig.sensor_mm,
        "inner_mm": rig.inner_mm,
        "marker_displacement_mm": rig.marker_levels_mm,
        "sensor_displacement_mm": rig.sensor_levels_mm,
        "inner_displacement_mm": rig.inner_levels_mm,
        "pad_force_mN": rig.pad_forces,
        "truth": json.dumps(dict(rig.truth)),
    }


class Fails(Rival):
    """A method that never finds anything."""

    name = "fails"

    def register(self, measured_mm, simulation_mm=None):
        message = "no"
        raise MarkerError(message)


class NeedsFields(Rigid):
    """A method that wants training fields."""

    name = "needs fields"
    needs = frozenset({"fields"})


class Off(Rival):
    """The simulation and 2 mm more along x, which it says it knows to 1 mm."""

    name = "off"
    needs = frozenset({"simulation"})

    def register(self, measured_mm, simulation_mm=None):
        return Estimate(simulation_mm + np.array([2.0, 0.0, 0.0]), np.ones_like(simulation_mm))


METHODS = {method.name: method for method in (Simulated, MeanOfMarkers, Rigid, Off, Fails, NeedsFields)}


@pytest.fixture(scope="module")
def made(rig, mesh):
    return Contest([rig], mesh, methods=METHODS, threads=1)


# --- recordings ---


def test_a_rig_is_read_as_it_was_written(rig, tmp_path):
    write_npz(tmp_path / "scenario1-00.npz", arrays_of(rig))
    (found,) = read_rigs(tmp_path)
    assert (found.name, found.scenario, found.seed, found.frame_s) == ("scenario1-00", 1, 0, 0.025)
    np.testing.assert_array_equal(found.inner_levels_mm, rig.inner_levels_mm)
    np.testing.assert_allclose(found.pads[0].stroke_mm, rig.pads[0].stroke_mm, rtol=1e-15)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"shares": [1.0, 0.5]}, "must be two or more growing numbers above 0"),
        ({"motion": [0.0, 1.5]}, "must be shares from 0 to 1"),
        ({"truth": "{}"}, "must be JSON with `scenario` and `seed`"),
        ({"inner_displacement_mm": np.zeros((2, 9, 3))}, "inner_displacement_mm"),
        ({"sensor_mm": [0.0, 0.0, np.nan]}, "must be finite"),
    ],
)
def test_a_spoilt_rig_is_refused_with_the_array_that_is_wrong(rig, tmp_path, changed, said):
    write_npz(tmp_path / "rig.npz", arrays_of(rig) | changed)
    with pytest.raises(FormatError, match=said):
        read_rig(tmp_path / "rig.npz")


def test_a_folder_without_rigs_is_refused(tmp_path):
    with pytest.raises(FormatError, match="must hold rigs"):
        read_rigs(tmp_path)


def test_frames_at_stored_shares_are_the_stored_displacements(rig):
    frames = replace(rig, motion=np.array([0.0, 0.5, 1.0])).at_frames(rig.inner_levels_mm)
    np.testing.assert_allclose(frames, [0.0 * frames[1], *rig.inner_levels_mm], atol=1e-12)


# --- what the tracker gives ---


def test_one_marker_is_off_by_what_the_condition_states_and_no_other(rig):
    wrong = next(one for one in CONDITIONS if one.wrong_mm)
    off = measured(rig, wrong, 0) - measured(rig, PLAIN, 0)
    sizes = np.linalg.norm(off, axis=2)
    assert (sizes > 1e-9).sum(axis=1).tolist() == [1] * len(SHARES)
    np.testing.assert_allclose(sizes.max(axis=1), 5.0, rtol=1e-12)


@pytest.mark.parametrize(("share", "n"), [(20, 3), (40, 6), (60, 9)])
def test_dropped_markers_are_missing_in_all_frames(rig, share, n):
    (dropped,) = [one for one in CONDITIONS if one.name == f"dropped-{share}"]
    missing = np.isnan(measured(rig, dropped, 0)).all(axis=2)
    assert missing.sum(axis=1).tolist() == [n] * len(SHARES)
    assert (missing == missing[0]).all()


# --- what is believed ---


def test_the_believed_body_pressed_as_hard_as_itself_moves_as_far(rig, mesh):
    believed = Believed(rig, mesh, 1)
    at_whole_stroke = believed.simulation_mm("force")[11]
    # The curve is inverted between 4,001 points: a four-thousandth of a share of 6 mm, squared.
    np.testing.assert_allclose(at_whole_stroke, believed.path.fields_mm[2], atol=1e-5)


def test_a_true_body_that_pushes_back_harder_makes_the_believed_one_go_farther(rig, mesh):
    stiff = Believed(replace(rig, pad_forces=1.4 * rig.pad_forces), mesh, 1)
    path = stiff.path
    (share,) = path.shares_of(1.4 * path.pushes[2:3])
    assert 1.2 < share < 1.5
    np.testing.assert_allclose(stiff.simulation_mm("force")[11], path.fields_at(np.array([share]))[0], atol=1e-9)
    np.testing.assert_allclose(path.shares_of(np.array([1e9])), path.shares[-1])


# --- methods on rigs ---


def test_a_simulation_that_is_the_truth_has_no_error(made, rig):
    run = next(run for run in made.runs(rig, MOTION) if run.method == "simulation")
    assert len(run.sensor_mm) == len(np.arange(0, 24, EVERY))
    # Its spline has two more fields beyond the rig's: two cubics where the rig's is a parabola.
    assert max(run.sensor_mm.max(), run.inner_mm.max()) < 0.02


def test_errors_and_coverage_are_those_of_a_known_offset(made, rig):
    run = next(run for run in made.runs(rig, MOTION) if run.method == "off")
    np.testing.assert_allclose(run.inner_mm, 2.0, rtol=0.01)  # the simulation's own error, as above
    # Of three components one is off by two standard deviations, two are exact.
    assert run.coverage90 == pytest.approx(2 / 3)


def test_where_a_method_fails_the_simulation_counts_and_it_is_said(made, rig):
    run = next(run for run in made.runs(rig, MOTION) if run.method == "fails")
    assert (run.failed, run.frames) == (3, 3)
    simulated = next(run for run in made.runs(rig, MOTION) if run.method == "simulation")
    np.testing.assert_array_equal(run.sensor_mm, simulated.sensor_mm)


def test_methods_that_lack_what_they_need_are_left_out_and_named(made):
    assert made.left_out == ("needs fields",)


class Remembers(Off):
    """A method that moves 0.1 mm farther with each moment."""

    name = "remembers"
    remembers = True

    def __init__(self, setting):
        super().__init__(setting)
        self.moments = 0

    def register(self, measured_mm, simulation_mm=None):
        self.moments += 1
        return Estimate(simulation_mm + np.array([0.1 * self.moments, 0.0, 0.0]))


def test_a_method_that_remembers_is_given_every_frame_and_others_the_scored_ones(rig, mesh):
    contest = Contest([rig], mesh, methods={"off": Off, "remembers": Remembers}, threads=1)
    off, remembers = contest.runs(rig, MOTION)
    assert (off.frames, remembers.frames) == (3, 24)
    # Frames 0, 8 and 16 are scored; the simulation's own error as above.
    np.testing.assert_allclose(remembers.sensor_mm, [0.1, 0.9, 1.7], atol=0.03)


def test_without_a_simulation_the_registrar_is_given_none(rig, mesh):
    model = NetworkModel(SMALL_MODEL, mesh, threads=1)
    about = Believed(rig, mesh, 1)
    markers, simulation = measured(rig, PLAIN, 0)[11], about.simulation_mm("motion")[11]
    found = NetworkAlone(about.setting(PLAIN, model, None, 0)).register(markers, simulation)
    registrar = tr.Registrar(
        tr.Body(mesh, material=BELIEVED),
        tr.Markers(rig.reference_mm, std=0.1),
        model,
        settings=tr.RegisterSettings(threads=1),
    )
    np.testing.assert_array_equal(found.displacement_mm, registrar.register(markers).displacement)


def test_a_spread_that_must_be_asked_for_is_not_timed_with_the_answer(rig, mesh):
    asked = []

    class Asked(Off):
        name = "asked"

        def __init__(self, setting, *, spread=False):
            super().__init__(setting)
            self.spread = spread

        def register(self, measured_mm, simulation_mm=None):
            asked.append(self.spread)
            found = super().register(measured_mm, simulation_mm)
            return found if self.spread else Estimate(found.displacement_mm)

    (run,) = Contest([rig], mesh, methods={"asked": Asked}, threads=1).runs(rig, MOTION)
    assert asked == [False] * 3 + [True] * 3
    assert run.frames == 3
    assert run.coverage90 == pytest.approx(2 / 3)


class Counted(Off):
    """Counts its calls."""

    name = "counted, of all"
    calls = 0

    def register(self, measured_mm, simulation_mm=None):
        type(self).calls += 1
        return super().register(measured_mm, simulation_mm)


def test_what_is_kept_is_not_run_again_unless_seed_or_rig_differ(rig, mesh, tmp_path):
    def made(rig, seed=0):
        return Contest([rig], mesh, methods={"counted": Counted}, seed=seed, threads=1, keep=tmp_path / "kept")

    (first,) = made(rig).runs(rig, MOTION)
    calls = Counted.calls
    (again,) = made(rig).runs(rig, MOTION)
    assert Counted.calls == calls == 3
    np.testing.assert_array_equal(again.inner_mm, first.inner_mm)
    assert (again.ms, again.frames, again.coverage90) == (first.ms, first.frames, first.coverage90)
    other = replace(rig, sensor_levels_mm=rig.sensor_levels_mm + 0.1)
    made(rig, seed=1).runs(rig, MOTION)
    made(other).runs(other, MOTION)
    assert Counted.calls == 3 * calls


def test_a_kept_run_that_is_spoilt_is_made_anew(rig, mesh, tmp_path):
    def run():
        return Contest([rig], mesh, methods={"off": Off}, threads=1, keep=tmp_path).runs(rig, MOTION)[0]

    first = run()
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:100])
    np.testing.assert_array_equal(run().inner_mm, first.inner_mm)


def test_methods_are_given_the_variants_of_each_frame_and_are_run_anew_for_others(rig, mesh, tmp_path):
    # Bodies that move in proportion to their push, of which some go too far.
    fields = np.arange(1.0, 7.0)[:, None, None, None] * np.array([0.5, 1.0])[:, None, None] * mesh.nodes / 100.0
    pushes = np.outer(np.ones(6), rig.push(rig.pad_forces))
    seen = []

    class Asked(EnsembleOfSimulations):
        def register(self, measured_mm, simulation_mm=None, variants_mm=None):
            seen.append(variants_mm)
            return super().register(measured_mm, simulation_mm, variants_mm)

    def runs(fields):
        write_npz(tmp_path / "variants" / f"{rig.name}.npz", {"field_mm": fields, "push_mN": pushes})
        methods = {Simulated.name: Simulated, Asked.name: Asked}
        keep = tmp_path / "kept"
        return Contest([rig], mesh, methods=methods, threads=1, variants=tmp_path / "variants", keep=keep).runs(
            rig, PLAIN
        )

    (tmp_path / "variants").mkdir()
    _, run = runs(fields)
    believed, known = Believed(rig, mesh, 1), read_variants(tmp_path / "variants", rig, mesh.n_nodes)
    pushed = rig.at_frames(rig.push(rig.pad_forces))[believed.scored]
    assert len(seen) == run.frames == 3
    for given, push in zip(seen, pushed, strict=True):
        np.testing.assert_array_equal(given, known.at(float(push)))
    runs(fields)
    assert len(seen) == 3
    runs(1.1 * fields)
    assert len(seen) == 6
    assert Contest([rig], mesh, methods={Asked.name: Asked}, threads=1).left_out == (Asked.name,)


# --- what is summed up and written ---


def test_the_reduction_is_the_mean_over_rigs_of_each_rigs_own():
    def run(method, rig, error):
        errors = np.array([error - 0.5, error + 0.5])
        return Run(method, "plain", rig, 1, np.arange(2.0), errors, errors[:, None], None, 1.0, 2, 0)

    runs = [run("simulation", "a", 4.0), run("ours", "a", 1.0), run("simulation", "b", 2.0), run("ours", "b", 1.0)]
    rows = {row["method"]: row for row in _rows(PLAIN, runs)}
    assert rows["ours"]["reduction"] == pytest.approx((0.75 + 0.5) / 2)
    assert rows["simulation"]["reduction"] == 0.0
    assert rows["simulation"]["sensor_mean_mm"] == pytest.approx(3.0)


def test_a_figure_without_rigs_of_its_scenario_is_refused(made):
    with pytest.raises(ArgumentError, match="must hold rigs of scenario 2 for 'fig11' that can"):
        phantom_study("fig11", made)


def test_a_rig_whose_believed_body_has_no_equilibrium_is_left_out_and_named(rig, mesh):
    # Pads that would be pushed through the body.
    pads = tuple(replace(pad, stroke_mm=40.0 * pad.stroke_mm) for pad in rig.pads)
    impossible = replace(rig, name="scenario1-99", pads=pads)
    contest = Contest([rig, impossible], mesh, methods=METHODS, threads=1)
    found = phantom_study("phantom", contest)
    assert found["rigs_left_out"] == ["scenario1-99"]
    assert found["rigs"] == 1
    assert "scenario1-99" in phantom_markdown({**found, "rows": found["rows"]})
    with pytest.raises(ArgumentError, match="that can be simulated"):
        phantom_study("phantom", Contest([impossible], mesh, methods=METHODS, threads=1))


def test_studies_are_written_with_every_method_and_condition(made, tmp_path):
    said = []
    contents = run_contest(["fig10", "phantom"], made, Running(progress=lambda *given: said.append(given)))
    answer = _delivered(tmp_path / "out", contents, Clock())
    assert said[-1] == ("phantom", 8, 8)
    names = {"simulation", MeanOfMarkers.name, Rigid.name, "off", "fails"}
    for study, conditions in (("fig10", 1), ("phantom", 8)):
        kept = json.loads((tmp_path / "out" / f"{study}.json").read_text())
        assert {row["method"] for row in kept["rows"]} == names
        assert len(kept["rows"]) == 5 * conditions == len([r for r in answer["rows"] if r["study"] == study])
        page = (tmp_path / "out" / f"{study}.md").read_text()
        assert page.count("| off |") == conditions
        assert "Not run, since a model, training fields or variants were not given: needs fields." in page
        assert len((tmp_path / "out" / f"{study}.csv").read_text().splitlines()) == 1 + 5 * conditions
        assert (tmp_path / "out" / f"{study}.png").stat().st_size > 10_000
    assert set(json.loads((tmp_path / "out" / "fig10.json").read_text())["curves"]["sensor_mm"]) == names
    short = json.loads((tmp_path / "out" / "phantom.json").read_text())
    assert set(short["methods"]) == {"simulation", "copy", "rigid", "off", "fails"}
    row = next(row for row in short["rows"] if row["method"] == "off" and row["condition"] == "plain")
    assert short["methods"]["off"] == {
        "sensor_mean_mm": row["sensor_mean_mm"],
        "inner_mean_mm": row["inner_mean_mm"],
        "inner_95_mm": row["inner_q95_mm"],
        "ms_a_frame": row["ms"],
        "coverage90": pytest.approx(2 / 3),
    }
    # Neither ours nor KF-ADMM was run.
    assert (short["cut_of_simulation"], short["better_than_kf_admm"]) == (None, None)
    assert short["with_variants"] == {"cut_of_simulation": None, "better_than_kf_admm": None}
    assert (short["rigs"], short["seeds"]) == (1, [0])


@pytest.mark.parametrize("study", ["fig10", "phantom"])
def test_methods_that_are_run_again_take_the_place_of_what_was_known(rig, mesh, study):
    class Farther(Off):
        def register(self, measured_mm, simulation_mm=None):
            return Estimate(simulation_mm + np.array([3.0, 0.0, 0.0]))

    def found(**methods):
        return phantom_study(study, Contest([rig], mesh, methods=methods, threads=1))

    known = found(simulation=Simulated, off=Off, rigid=Rigid)
    again = merged(known, found(simulation=Simulated, off=Farther, fails=Fails))
    whole = found(simulation=Simulated, off=Farther, rigid=Rigid, fails=Fails)
    untimed = [
        {(row["condition"], row["method"]): row["sensor_mean_mm"] for row in one["rows"]} for one in (again, whole)
    ]
    assert untimed[0] == untimed[1]
    assert again["agree"] == whole["agree"]
    if study == "fig10":
        assert again["curves"] == whole["curves"]
    else:
        assert again["goals"] == whole["goals"]
        assert set(again["methods"]) == set(whole["methods"])
    other = phantom_study(study, Contest([replace(rig, name="other", seed=1)], mesh, methods={"off": Off}, threads=1))
    if study == "phantom":
        with pytest.raises(ArgumentError, match="must have the same seeds"):
            merged(known, other)


def test_goals_are_counted_for_the_network_and_with_variants():
    def run(method, error):
        errors = np.full(2, error)
        return Run(method, "plain", "a", 1, np.arange(2.0), errors, 2.0 * errors[:, None], None, 1.0, 2, 0)

    errors = {Simulated.name: 1.0, Network.name: 0.4, VariedNetwork.name: 0.1, KfAdmm.name: 0.5, "other": 0.3}
    rows = _rows(PLAIN, [run(method, error) for method, error in errors.items()])
    goals = {one["goal"]: (one["found"], one["met"]) for one in _goals(rows)}
    assert goals["simulation's error lowered by 80%, mean over rigs"] == ("60%", False)
    assert goals["simulation's error lowered by 80%, of the mean errors at inner points, with variants"] == (
        "90%",
        True,
    )
    assert goals["55% better than KF-ADMM"] == ("20%", False)
    assert goals["55% better than KF-ADMM, with variants"] == ("80%", True)
    # Ours are not counted against each other.
    assert goals["better than every other method"] == ("other (0.30 mm)", False)
    assert goals["better than every other method, with variants"] == ("none is better", True)
    short = _short(rows)
    assert (short["cut_of_simulation"], short["better_than_kf_admm"]) == pytest.approx((0.6, 0.2))
    assert short["with_variants"] == pytest.approx({"cut_of_simulation": 0.9, "better_than_kf_admm": 0.8})


def test_every_method_has_a_short_name_of_its_own():
    assert set(contests.KEYS) == set(contests.METHODS)
    assert len(set(contests.KEYS.values())) == len(contests.KEYS)
