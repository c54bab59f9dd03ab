"""Experiment folders: what is read, and how faults are named."""

import numpy as np
import pytest

import tissuereg as tr
from support.files import EXPERIMENT, TABLES, write_experiment
from tissuereg.errors import ExperimentError, FormatError
from tissuereg.io.experiments import is_experiment

EXAMPLES = ("null", "inclusion", "relaxation")


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_are_read(shared_data, name):
    rig = tr.read_experiment(shared_data / "examples" / name)
    assert rig.mesh.n_nodes == 4164
    assert rig.material.young == 10.0
    assert rig.young_std == 3.0
    assert rig.gravity is None
    assert (rig.marker_std, rig.force_std, rig.rest_case) == (0.05, 5.0, "rest")
    assert [pad.name for pad in rig.actuators] == ["push_x", "push_y", "push_z"]
    assert {case: len(history.times) for case, history in rig.cases.items()} == {
        "rest": 10,
        "push_x": 24,
        "push_y": 24,
        "push_z": 24,
    }
    for case in rig.cases.values():
        assert np.isfinite(case.markers).all()
        assert case.markers.shape == (len(case.times), 25, 3)
        assert list(case.displacements) == [pad for pad in ("push_x", "push_y", "push_z") if pad == case.name]
    # the file's own node sets are the same as plane and spheres
    for rule, own in (("fixed", "base"), ("push_x", "pad_x"), ("push_y", "pad_y"), ("push_z", "pad_z")):
        assert np.array_equal(rig.mesh.node_set(rule), rig.mesh.node_set(own))


def test_a_frame_holds_what_was_given_and_measured(shared_data):
    rig = tr.read_experiment(shared_data / "examples" / "null")
    frame = rig.frame("push_x", 14.1)
    assert (frame.case, frame.time, frame.index) == ("push_x", 14.0, 8)
    assert frame.displacements["push_x"].tolist() == [-7.5, 0.0, 0.0]
    assert len(frame.markers) == 25
    assert frame.markers.names == rig.marker_names
    assert np.linalg.norm(frame.targets["lesion"] - rig.targets["lesion"]) > 0.5


def test_missing_rows_and_cells_are_nan_and_controls_are_interpolated(tmp_path):
    rig = tr.read_experiment(write_experiment(tmp_path / "rig"))
    lean = rig.case("lean")
    assert lean.times.tolist() == [10.0, 10.5, 11.0]
    assert lean.displacements["push"][:, 0].tolist() == [0.0, 1.0, 2.0]
    assert np.isnan(lean.markers[1, 1]).all()
    assert np.isnan(lean.forces["push"][:2]).all()
    assert lean.forces["push"][2].tolist() == [300.0, 0.0, 0.0]
    assert np.isnan(rig.case("rest").markers[1, 1]).all()
    assert rig.frame("lean", 10.6).markers.seen.tolist() == [True, False]


def test_the_law_may_be_any_that_the_solver_owns(tmp_path):
    ogden = 'law = "ogden"\nalpha = [-19.0, 3.0]\nweight = [0.9, 0.1]\nvolumetric = "quadratic"'
    rig = tr.read_experiment(write_experiment(tmp_path / "rig", toml=EXPERIMENT.replace('law = "neo-hookean"', ogden)))
    assert rig.material.law == "ogden"
    assert rig.material.shape == {"alpha": [-19.0, 3.0], "weight": [0.9, 0.1]}
    assert rig.material.volumetric == "quadratic"


def test_a_time_beyond_half_a_step_is_refused_with_the_range(tmp_path):
    rig = tr.read_experiment(write_experiment(tmp_path / "rig"))
    assert rig.case("lean").index(11.24) == 2
    for time in (11.3, 9.7, float("nan")):
        with pytest.raises(ExperimentError, match=r"'lean'.*3 frames run from 10 to 11 s"):
            rig.frame("lean", time)
    with pytest.raises(ExperimentError, match="a case 'bend'; it has: rest, lean"):
        rig.frame("bend", 10.0)
    with pytest.raises(ExperimentError, match="an actuator 'pull'; it has: push"):
        rig.actuator("pull")


def test_places_may_come_from_a_first_frame(tmp_path):
    places = EXPERIMENT[EXPERIMENT.index("[markers.reference]") : EXPERIMENT.index("[[target]]")]
    for rule in ("[markers.reference]\nreference_time_s = 10.0\n", ""):
        toml = EXPERIMENT.replace(places, rule)
        toml = toml if rule else toml.replace('rest_case = "rest"', 'rest_case = "rest"\nreference_time_s = 10.0')
        rig = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml))
        assert rig.marker_names == ("P1", "P2")
        assert rig.marker_reference.tolist() == [[0, 10, 40], [15, 0, 20]]
    toml = EXPERIMENT.replace(places, "[markers.reference]\nreference_time_s = 0.5\n")
    with pytest.raises(ExperimentError, match=r"seen at reference_time_s = 0\.5; not seen: P2"):
        tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml))


def test_a_force_actuator_reads_its_own_table(tmp_path):
    toml = EXPERIMENT.replace('kind = "displacement"', 'kind = "force"')
    applied = "case,time_s,actuator,x_mN,y_mN,z_mN\nlean,10,push,0,0,0\nlean,11,push,50,0,0\n"
    rig = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml, actuators=None, forces_applied=applied))
    assert rig.case("lean").applied_forces["push"][:, 0].tolist() == [0.0, 25.0, 50.0]
    assert rig.case("lean").displacements == {}


def test_gravity_is_read(tmp_path):
    toml = EXPERIMENT + "[gravity]\ndirection = [0, 0, -1]\nin_reference = false\n"
    rig = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml) / "experiment.toml")
    assert rig.gravity.direction.tolist() == [0, 0, -1]
    assert (rig.gravity.g_mm_per_s2, rig.gravity.in_reference) == (9810.0, False)


def test_a_recipe_is_no_experiment(tmp_path):
    (tmp_path / "recipe.toml").write_text('seed = 1\n[mesh]\nfile = "phantom"\n')
    assert not is_experiment(tmp_path / "recipe.toml")
    assert is_experiment(write_experiment(tmp_path / "rig"))
    assert is_experiment(tmp_path / "rig" / "experiment.toml")
    assert not is_experiment(tmp_path / "rig" / "mesh.vtu")


def changed(old: str, new: str) -> dict:
    assert old in EXPERIMENT
    return {"toml": EXPERIMENT.replace(old, new)}


def table(name: str, more: str) -> dict:
    return {name: TABLES[f"{name}.csv"] + more}


BAD = {
    "no TOML": ({"toml": "name = "}, "must be a TOML file"),
    "material test": (
        {"toml": 'kind = "material-test"\n' + EXPERIMENT},
        "`read_material_experiment` reads material tests, got 'material-test'",
    ),
    "unknown key at the top": ({"toml": "colour = 1\n" + EXPERIMENT}, "got 'colour' of .*toml"),
    "unknown key in a table": (changed("poisson = 0.45", "poisson = 0.45\nnu = 0.3"), r"got 'nu' in \[material\]"),
    "no mesh": (changed('[mesh]\nfile = "mesh.vtu"\n', ""), r"a table \[mesh\] must be given"),
    "mesh file missing": (changed("mesh.vtu", "gone.vtu"), r"no such file: .*gone\.vtu"),
    "unknown law": (changed("neo-hookean", "jelly"), "`law` must be one of neo-hookean, bimod.* got 'jelly'"),
    "law without its shape": (
        changed('"neo-hookean"', '"yeoh"'),
        r"`c2_over_c1` must be given; the table holds law",
    ),
    "shape of another law": (changed("poisson = 0.45", "poisson = 0.45\nshare = 0.1"), r"got 'share' in \[material\]"),
    "shape out of range": (changed('"neo-hookean"', '"fung"\nb = -1.0'), r"`b` of the law must be .*not negative"),
    "shape that is no number": (changed('"neo-hookean"', '"fung"\nb = true'), "`b` must be a number or a list"),
    "volumetric energy of a law without": (
        changed('"neo-hookean"', '"hooke"\nvolumetric = "quadratic"'),
        "`volumetric` of the law must be left out",
    ),
    "nu too large": (changed("poisson = 0.45", "poisson = 0.5"), r"`poisson` must be in \(-1, 0.5\)"),
    "spread not positive": (changed("[10.0, 3.0]", "[10.0, 0.0]"), r"`young_kpa` must be a number or \[mean"),
    "unknown node set": (changed("{ plane = [0.0, 0.0, 1.0, 0.0], tolerance_mm = 0.1 }", '"bottom"'), "'bottom'"),
    "plane catches nothing": (changed("1.0, 0.0], tol", "1.0, -9.0], tol"), "nearest is 9 mm away"),
    "sphere catches nothing": (
        changed("[30.0, 10.0, 40.0]", "[90.0, 10.0, 40.0]"),
        r"nearest is 60.09 mm away in \[\[actuator\]\] number 1",
    ),
    "no such patch": (
        changed("centre_mm = [30.0, 10.0, 40.0], radius_mm = 8.0", "box = 1"),
        "`nodes` must be a node set, { plane",
    ),
    "unknown kind of boundary": (changed('kind = "fixed"', 'kind = "sliding"'), "`kind` must be one of fixed"),
    "unknown kind of actuator": (changed('kind = "displacement"', 'kind = "heat"'), "one of displacement, force"),
    "a number of many digits": (changed("poisson = 0.45", f"poisson = {400 * '9'}"), "`poisson` must be a number or"),
    "a number of thousands of digits": (changed("poisson = 0.45", f"poisson = {5000 * '9'}"), "must be a TOML file"),
    "a pad that is held": (
        changed("{ centre_mm = [30.0, 10.0, 40.0], radius_mm = 8.0 }", '"plane 0 0 1 0"'),
        "must have a node that no boundary holds; all 20 of 'push' are held",
    ),
    "plane in words, half given": (
        changed("{ centre_mm = [30.0, 10.0, 40.0], radius_mm = 8.0 }", '"plane 0 0 1"'),
        r"`nodes` must be 'plane nx ny nz d \[tol\]'.*in \[\[actuator\]\] number 1",
    ),
    "two patches of one name": (changed('name = "push"', 'name = "base"'), "a name of its own"),
    "nothing held": (
        {"toml": EXPERIMENT.replace(EXPERIMENT[EXPERIMENT.index("[[b") : EXPERIMENT.index("[[a")], "")},
        None,  # the mesh has a node set `fixed`, so this one is good
    ),
    "marker noise missing": (
        changed("std_mm = 0.05\n", ""),
        r"`std_mm` must be given; the table holds rest_case",
    ),
    "trial share negative": (
        changed("std_mm = 0.05", "std_mm = 0.05\ntrial_share = -0.1"),
        "`trial_share` must be a finite number greater than 0",
    ),
    "rest case unknown": (changed('rest_case = "rest"', 'rest_case = "nap"'), "one of the cases rest, lean"),
    "place of two numbers": (changed("P2 = [15.0, 0.0, 20.0]", "P2 = [15.0, 0.0]"), "`P2` must be a list of 3"),
    "no marker": (changed("P1 = [0.0, 10.0, 40.0]\nP2 = [15.0, 0.0, 20.0]\n", ""), "at least one marker"),
    "forces without table": (changed("[forces]\nstd_mN = 5.0\n", ""), r"\[forces\] with std_mN must be given"),
    "gravity half said": ({"toml": EXPERIMENT + "[gravity]\ndirection = [0, 0, -1]\n"}, "`in_reference` must be given"),
    "unknown marker": (table("markers", "lean,12,P9,1,2,3\n"), "marker 'P9' must be declared.*line 11"),
    "unknown actuator": (table("actuators", "lean,12,pull,1,2,3\n"), "actuator 'pull' must be declared.*line 4"),
    "unknown target": (table("targets", "lean,11,skin,1,2,3\n"), "target 'skin' must be declared.*line 3"),
    "repeated row": (table("markers", "lean,11.0,P1,1,2,3\n"), "must not be repeated.*line 11 follows 11 s at line 9"),
    "time backwards": (table("markers", "lean,10.2,P1,1,2,3\n"), "time must increase.*line 11"),
    "force off the frames": (table("forces", "lean,11.2,push,1,2,3\n"), "fall on a frame.*line 3"),
    "target in an unknown case": (table("targets", "bend,11,deep,1,2,3\n"), "case 'bend' must have marker.*line 3"),
    "actuator does not cover": (
        {"actuators": "case,time_s,actuator,x_mm,y_mm,z_mm\nlean,10,push,0,0,0\nlean,10.5,push,1,0,0\n"},
        "must cover case 'lean' from 10 to 11 s; they cover 10 to 10.5 s",
    ),
    "wrong header": ({"markers": "case,time,marker,x,y,z\n"}, "must begin with the header case,time_s,marker"),
    "tables elsewhere": ({"toml": 'tables = "gone"\n' + EXPERIMENT}, r"no such file: .*gone.markers\.csv"),
    "markers missing": ({"markers": None}, r"no such file: .*markers\.csv"),
    "actuators missing": ({"actuators": None}, r"no such file: .*actuators\.csv"),
    "forces missing": ({"forces": None}, r"no such file: .*forces\.csv"),
}


@pytest.mark.parametrize(("changes", "words"), BAD.values(), ids=BAD)
def test_a_faulty_experiment_is_refused_by_place(tmp_path, changes, words):
    folder = write_experiment(tmp_path / "rig", **changes)
    if words is None:
        assert len(tr.read_experiment(folder).mesh.fixed_nodes) > 0
        return
    with pytest.raises(FormatError, match=words):
        tr.read_experiment(folder)


def test_a_folder_without_experiment_is_refused(tmp_path):
    with pytest.raises(FormatError, match=r"no such file: .*experiment\.toml"):
        tr.read_experiment(tmp_path)


def test_a_rig_that_nothing_measured_has_the_cases_of_its_actuators(tmp_path):
    folder = write_experiment(tmp_path / "rig", markers=None, forces=None, targets=None)
    rig = tr.read_experiment(folder, measured=False)
    assert list(rig.cases) == ["lean"]
    assert rig.case("lean").times.tolist() == [10.0, 11.0]
    assert np.isnan(rig.case("lean").markers).all()
    assert (rig.rest_case, rig.force_std, rig.case("lean").forces) == (None, 5.0, {})
    (folder / "actuators.csv").write_text("case,time_s,actuator,x_mm,y_mm,z_mm\n", encoding="utf-8")
    with pytest.raises((ExperimentError, FormatError), match=r"must be a case: rows in|at least one row"):
        tr.read_experiment(folder, measured=False)


@pytest.mark.parametrize(
    ("rule", "stored"),
    [
        ('"plane 0 0 2 40 0.5"', {"plane": [0.0, 0.0, 2.0, 40.0], "tolerance_mm": 0.5}),
        ("{ plane = [0, 0, 1, 40] }", {"plane": [0.0, 0.0, 1.0, 40.0], "tolerance_mm": 0.1}),
        ('"ball 30 10 40 8"', {"centre_mm": [30.0, 10.0, 40.0], "radius_mm": 8.0}),
    ],
)
def test_a_patch_is_said_as_on_the_command_line(tmp_path, rule, stored):
    toml = EXPERIMENT.replace("{ centre_mm = [30.0, 10.0, 40.0], radius_mm = 8.0 }", rule)
    pad = tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml)).actuator("push")
    assert pad.rule == stored
    assert pad.nodes.size > 0


def test_two_motions_of_one_node_are_refused(tmp_path):
    second = """
[[actuator]]
name = "also"
nodes = "ball 30 10 40 12"
kind = "displacement"
"""
    rows = "lean,10,also,0,0,0\nlean,11,also,0,0,1\n"
    folder = write_experiment(tmp_path / "rig", toml=EXPERIMENT + second)
    assert "push" in tr.read_experiment(folder).cases["lean"].displacements  # absent pads move nothing
    with (folder / "actuators.csv").open("a", encoding="utf-8") as table:
        table.write(rows)
    with pytest.raises(
        ExperimentError, match=r"nodes of their own; all \d+ of 'push' are moved by 'also' too in case 'lean'"
    ):
        tr.read_experiment(folder)
