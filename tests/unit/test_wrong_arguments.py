"""Wrong arguments of every public name: each works, or is refused by an error of ours that names the argument."""

import contextlib
import dataclasses
import importlib
import re
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from support.files import FIDUCIALS, GOOD_MARKERS, GOOD_RECORDING, write_experiment
from support.meshes import block
from support.rigs import rig
from support.wrong import WRONG, ends_well, swept
from tissuereg.errors import ExperimentError, FormatError, MaterialError, TissueRegError, UnitWarning
from tissuereg.experiment.effects import EFFECTS
from tissuereg.imaging.images import Grid, write_image
from tissuereg.io.experiments import read_experiment
from tissuereg.live import LiveSettings
from tissuereg.parallel import Failed, Processes, open_executor
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.wrong_markers import score_markers
from tissuereg.simulation.fine import FineMeshing


@cache
def mesh():
    return block(cells=(2, 2, 3))


@cache
def markers():
    places = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0]])
    return tr.Markers(places, places + np.array([0.5, 0.0, 0.0]))


#: A target in the body of `mesh`.
DEEP = {"deep": (15.0, 10.0, 20.0)}


@cache
def fields():
    return np.random.default_rng(0).normal(size=(9, mesh().n_nodes, 3))


@cache
def quick():
    few = ContactSettings(n_chains=2, n_chains_first=2, max_passes=1, n_kept=1, powers=(1.0,), n_draws=2)
    return tr.RegisterSettings(threads=1, contacts=few)


@cache
def registered():
    return tr.register(mesh(), markers(), targets={"deep": (15.0, 10.0, 20.0)}, settings=quick())


@cache
def registrar():
    return tr.Registrar(mesh(), markers(), settings=quick())


def tracker():
    return tr.Tracker(registrar())


CORNERS = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 20.0, 0.0]]


def one_frame():
    return tr.Recording(np.zeros(1), ("P1",), np.zeros((1, 1, 3)), listed=1)


def polled(**given):
    """Push a frame and register it, which is where its arguments are checked."""
    made = tracker()
    made.push(**{"measured_mm": markers().measured, "time_s": 0.0, **given})
    return made.poll()


@cache
def load():
    return tr.Load(forces=np.where(mesh().nodes[:, 2:] == 40.0, [5.0, 0.0, 0.0], 0.0))


@cache
def simulator():
    return tr.Simulator(mesh())


def registration(**changed):
    given = {"mesh": mesh(), "markers": markers(), "settings": quick()}
    return tr.register(**{**given, **changed})


def experiment_with(**changed):
    from dataclasses import replace

    return replace(rig(), **changed)


def filled(**given):
    """Check the arguments of a filling; the mesher is exchanged, for time and where there is none."""
    body = importlib.import_module("tissuereg.meshing.body")
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(body, "check_mesher", lambda: None)
        changed.setattr(body, "filled", lambda *_: (mesh().nodes, mesh().tets, "ours"))
        return tr.tetrahedralize(**{"surface": (mesh().nodes, mesh().surface), "size_mm": 12.0, **given})


def moved_grid(**given):
    with tempfile.TemporaryDirectory() as folder:
        registered().transform(Path(folder) / "field.nrrd", **given)


def moved_image(**given):
    with tempfile.TemporaryDirectory() as folder:
        grid = Grid((4, 4, 4), np.array([0.0, 0.0, 5.0]), 7.0 * np.eye(3))
        image = write_image(Path(folder) / "seg.nrrd", grid.image(np.ones((4, 4, 4), np.uint8)))
        registered().warp_image(**{"image": image, "path": Path(folder) / "moved.nrrd", **given})


def moved_surface(**given):
    with tempfile.TemporaryDirectory() as folder:
        skin = (mesh().nodes, mesh().surface)
        registered().warp_surface(**{"surface": skin, "path": Path(folder) / "moved.ply", **given})


def saved(**given):
    with tempfile.TemporaryDirectory() as folder:
        registered().save(Path(folder) / "out", **given)


def reported(**given):
    with tempfile.TemporaryDirectory() as folder:
        registered().report(Path(folder) / "report.html", **given)


def registrations(**changed):
    """Register one moment of many; what fails for it is raised."""
    given = {"mesh": mesh(), "markers": markers(), "measured": markers().measured[None], "settings": quick()}
    for result in tr.register_many(**{**given, **changed}):
        if isinstance(result, Failed):
            raise result.error


def opened(**given):
    """Check the arguments of a cluster, of which none is there."""
    cluster = importlib.import_module("tissuereg.parallel.cluster")
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(cluster, "reach", lambda *_, **__: None)
        changed.setattr(cluster, "local", lambda *_, **__: None)
        return open_executor(**{"address": "tcp://127.0.0.1:8786", **given})


def processes(**given):
    with Processes(**given) as made:
        return made.n_workers


def diagnosis_of_nothing(**given):
    """Check the arguments of a diagnosis, which ends where the data are wanted."""
    try:
        tr.diagnose(**given)
    except ExperimentError as error:
        if "it has none" not in str(error):
            raise


def diagnosed(**given):
    """Check the arguments of many diagnoses, of which none is made."""
    with tempfile.TemporaryDirectory() as folder:
        for outcome in tr.diagnose_many(**{"experiments": [], "out": folder, **given}):
            raise outcome.error


#: Every public function and class: a call that works, and other names of its arguments in messages.
CALLS = {
    "Mesh": (tr.Mesh, {"nodes": mesh().nodes, "tets": mesh().tets, "node_sets": {"fixed": [0, 1, 2]}, "frame": "LPS"}),
    "Mesh.node_set": (mesh().node_set, {"name": "fixed"}),
    "Mesh.with_node_set": (mesh().with_node_set, {"name": "other", "indices": [0, 1]}),
    "Mesh.surface_nodes_within": (mesh().surface_nodes_within, {"centre": (0, 0, 0), "radius": 9.0}),
    "Mesh.in_frame": (mesh().in_frame, {"frame": "RAS"}),
    "Triangles": (tr.Triangles, {"vertices": mesh().nodes, "triangles": mesh().surface}),
    "FilledMesh": (tr.FilledMesh, {"nodes": mesh().nodes, "tets": mesh().tets, "frame": "LPS"}),
    "tetrahedralize": (
        filled,
        {
            "surface": (mesh().nodes, mesh().surface),
            "size_mm": 12.0,
            "unit": "mm",
            "fixed": ["plane 0 0 1 0 0.1", "ball 0 0 40 12"],
            "node_sets": {"top": (0.0, 0.0, 1.0, 40.0, 0.1)},
            "deviation_mm": 0.5,
            "threads": 1,
        },
    ),
    "tetrahedralize a set": (
        lambda rule: filled(node_sets={"top": "plane 0 0 1 40 0.1", "rule": rule}),
        {"rule": [(0.0, 0.0, 1.0, 40.0, 0.1), "plane 0 0 1 0 0.1"]},
    ),
    "Markers": (
        tr.Markers,
        {"reference": markers().reference, "measured": markers().measured, "std": 0.1, "names": ["a", "b", "c"]},
    ),
    "Markers.only": (markers().only, {"keep": [0, 1]}),
    "Markers.with_seen": (
        lambda **given: markers().with_seen(**{"targets": DEEP, "seen": DEEP, **given}),
        {"targets": DEEP, "seen": DEEP, "std": 0.5},
    ),
    "Material": (
        tr.Material,
        {
            "young": 10.0,
            "poisson": 0.4,
            "law": "fung",
            "density": 1.0,
            "shape": {"b": 1.0},
            "volumetric": "log",
            "fibre": tr.Fibre(),
        },
    ),
    "Material of fibres": (
        lambda **fibre: tr.Material(fibre=tr.Fibre(**fibre)),
        {"k1_over_mu": 1.0, "k2": 1.0, "direction": (0, 0, 1.0), "tension_only": True},
    ),
    "Material.scaled": (tr.Material().scaled, {"factor": 2.0}),
    "Material.weight": (tr.Material().weight, {"direction": (0, 0, -1.0), "g": 9810.0}),
    "Load": (
        lambda **parts: tr.simulate(mesh(), tr.Load(**parts), tr.Material(), threads=1),
        {
            "forces": load().forces,
            "body_force": (0, 0, 0.001),
            "prescribed": np.zeros((len(mesh().fixed_nodes), 3)),
            "traction": (mesh().surface[:2], (0.0, 0.0, 0.01)),
        },
    ),
    "simulate": (
        tr.simulate,
        {
            "mesh": mesh(),
            "load": load(),
            "material": tr.Material(),
            "element": "tet4",
            "held_nodes": mesh().fixed_nodes,
            "tolerance": 1e-6,
            "threads": 1,
        },
    ),
    "Simulator": (
        tr.Simulator,
        {"mesh": mesh(), "element": "tet4", "held_nodes": mesh().fixed_nodes, "springs": (), "rests": True},
    ),
    "Simulator.solve": (
        lambda **given: simulator().solve(**given),
        {
            "load": load(),
            "material": tr.Material(),
            "tolerance": 1e-6,
            "threads": 1,
            "method": "auto",
            "max_iterations": 50,
            "load_steps": 0,
            "start": np.zeros((mesh().n_nodes, 3)),
        },
    ),
    "Simulator.solve_many": (
        lambda **given: simulator().solve_many(**given),
        {"loads": [load()], "materials": [tr.Material()], "progress": None, "threads": 1},
    ),
    "Simulator.internal_forces": (
        lambda **given: simulator().internal_forces(**given),
        {"displacement": np.zeros((mesh().n_nodes, 3)), "material": tr.Material(), "springs": None},
    ),
    "Body": (
        tr.Body,
        {
            "mesh": mesh(),
            "material": tr.Material(),
            "element": "auto",
            "held": "sure",
            "stiffness": "believed",
            "held_nodes": mesh().fixed_nodes,
        },
    ),
    "RegisterSettings": (
        tr.RegisterSettings,
        {
            "threads": 1,
            "tracker": "drifts",
            "contacts": quick().contacts,
            "ensemble": 0,
            "smoother": tr.SmootherSettings(),
            "readings": "doubtful",
        },
    ),
    "SmootherSettings": (
        tr.SmootherSettings,
        {"n_members": 9, "n_steps": 2, "decrease": 2.0},
    ),
    "SimulationVariants": (
        tr.SimulationVariants,
        {"fields": fields(), "simulation": np.zeros((mesh().n_nodes, 3))},
    ),
    "SurfacePoints": (lambda **given: tr.SurfacePoints(**given), {"measured": mesh().nodes, "std": 0.1}),
    "ContactSettings": (ContactSettings, {"n_slots": 3, "odds": 0.8, "sizes": (0.1,), "weight": (0.1, 2.0)}),
    "register": (
        registration,
        {
            "mesh": tr.Body(mesh()),
            "markers": markers(),
            "surface": None,
            "targets": {},
            "load": None,
            "simulation": None,
            "model": None,
            "seed": 0,
            "settings": quick(),
            "progress": None,
        },
    ),
    "register_many": (
        registrations,
        {
            "mesh": mesh(),
            "markers": markers(),
            "measured": markers().measured[None],
            "executor": None,
            "progress": None,
            "targets": {},
            "seed": 0,
            "settings": quick(),
        },
    ),
    "Registrar": (
        lambda **given: tr.Registrar(**{"mesh": mesh(), "reference_mm": markers().reference, **given}),
        {
            "mesh": mesh(),
            "reference_mm": markers().reference,
            "model": None,
            "targets": {},
            "load": None,
            "seed": 0,
            "settings": quick(),
        },
    ),
    "Registrar.register": (
        lambda **given: registrar().register(**{"measured_mm": markers().measured, **given}),
        {"measured_mm": markers().measured, "simulation": None, "after": None, "progress": None},
    ),
    "Tracker": (
        lambda **given: tr.Tracker(**{"body": mesh(), "reference_mm": markers().reference, **given}),
        {
            "body": mesh(),
            "reference_mm": markers().reference,
            "model": None,
            "targets": {},
            "simulator": None,
            "variants": [],
            "restart": "forces",
            "temporal": True,
        },
    ),
    "Tracker.step": (
        lambda **given: tracker().step(**{"measured_mm": markers().measured, "time_s": 0.0, **given}),
        {"measured_mm": markers().measured, "time_s": 1.0, "actuator": None},
    ),
    "Tracker.update": (
        lambda **given: tracker().update(**{"measured_mm": markers().measured, "time_s": 0.0, **given}),
        {"measured_mm": markers().measured, "time_s": 1.0, "actuator": None},
    ),
    "Tracker.poll": (
        polled,
        {"measured_mm": markers().measured, "time_s": 1.0, "actuator": None},
    ),
    "Tracker.run": (
        lambda **given: list(tracker().run(**{"frames": [], **given})),
        {"frames": [(0.0, markers().measured)], "failed": print},
    ),
    "FemPhysics": (
        tr.tracking.FemPhysics,
        {
            "mesh": mesh(),
            "material": tr.Material(),
            "load_of": None,
            "element": "tet4",
            "held_nodes": mesh().fixed_nodes,
            "tolerance": 1e-5,
            "threads": 1,
        },
    ),
    "FemPhysics.field": (
        lambda **given: tr.tracking.FemPhysics(mesh(), threads=1).field(**{"actuator": None, **given}),
        {"actuator": load(), "start": np.zeros((mesh().n_nodes, 3))},
    ),
    "TablePhysics": (tr.tracking.TablePhysics, {"axes": [0.0, 1.0], "fields": np.zeros((2, 4, 3))}),
    "TablePhysics.field": (
        lambda **given: tr.tracking.TablePhysics([0.0, 1.0], np.zeros((2, 4, 3))).field(**given),
        {"actuator": 0.5},
    ),
    "CalledPhysics": (tr.tracking.CalledPhysics, {"function": lambda _: np.zeros((4, 3))}),
    "rigid_alignment": (
        lambda **given: tr.tracking.rigid_alignment(**{"body_mm": CORNERS, **given}),
        {"tracker_mm": CORNERS, "body_mm": CORNERS, "names": ["a", "b", "c"], "std": 0.1},
    ),
    "Recording.nearest": (
        lambda **given: one_frame().nearest(**{"names": ("P1",), "reference_mm": [[0, 0, 0]], "within_mm": 1, **given}),
        {"names": ("P1",), "reference_mm": [[0.0, 0.0, 0.0]], "within_mm": 2.0},
    ),
    "Recording.of": (
        lambda **given: one_frame().of(**{"names": ("P1",), **given}),
        {"names": ("P1",), "match": "label"},
    ),
    "LiveSettings": (
        LiveSettings,
        {"surface": "plain", "gather_s": 0.05, "farthest_mm": 1e4, "most_bytes": 1000, "most_peers": 2},
    ),
    "fitted_prior": (
        lambda **given: tr.tracking.fitted_prior(**{"mesh": mesh(), "largest_mm": 1.0, "n_events": 6, **given}),
        {
            "mesh": mesh(),
            "material": tr.Material(),
            "largest_mm": 1.0,
            "n_events": 6,
            "n_latent": 2,
            "held_nodes": mesh().fixed_nodes,
            "seed": 0,
            "threads": 1,
        },
    ),
    "advise_markers": (
        lambda **given: tr.advise_markers(**{"mesh": mesh(), "fields_mm": fields(), "targets": DEEP, "n": 1, **given}),
        {
            "mesh": mesh(),
            "fields_mm": fields(),
            "targets": DEEP,
            "n": 1,
            "candidates_mm": markers().reference,
            "placed_mm": None,
            "std": 0.1,
            "apart_mm": 0.0,
        },
    ),
    "open_executor": (opened, {"address": "local:2", "task_limit": 900.0, "patience": 60.0}),
    "Processes": (processes, {"n": 2}),
    "register of a surface": (
        lambda **given: tr.register(mesh(), settings=quick(), **given),
        {"surface": mesh().nodes[mesh().surface_nodes]},
    ),
    "Registration.draws": (lambda **given: registered().draws(**given), {"count": 2}),
    "Registration.at": (lambda **given: registered().at(**given), {"points": [(15.0, 10.0, 20.0)], "covariance": True}),
    "Registration.warp_image": (moved_image, {"image": None, "path": None, "labels": True, "like": None}),
    "Registration.warp_surface": (moved_surface, {"surface": None, "path": None, "unit": "mm"}),
    "Registration.transform": (moved_grid, {"spacing": 9.0, "like": None, "direction": "modeling", "std": None}),
    "PointAnswer.region": (
        lambda **given: registered().at([(15.0, 10.0, 20.0)]).region(**given),
        {"number": 0, "share": 0.9},
    ),
    "Registration.save": (saved, {"extra": {"seed": 3}, "deformed": True, "picture": False, "image": None}),
    "Registration.report": (reported, {"picture": False, "image": None}),
    "Registration.target": (lambda **given: registered().target(**given), {"name": "deep"}),
    "Target.region": (lambda **given: registered().target("deep").region(**given), {"share": 0.9}),
    "Region.contains": (lambda **given: registered().target("deep").region().contains(**given), {"point": (0, 0, 0)}),
    "diagnose": (
        diagnosis_of_nothing,
        {
            "experiment": experiment_with(cases={}),
            "seed": 0,
            "threads": 1,
            "keep": False,
            "element": "tet4",
            "progress": None,
            "settings": None,
        },
    ),
    "diagnose_many": (
        diagnosed,
        {
            "experiments": [],
            "executor": None,
            "seed": 0,
            "threads": 1,
            "keep": False,
            "element": "tet4",
            "progress": None,
            "settings": None,
        },
    ),
    "simulate_experiment": (
        lambda **given: tr.simulate_experiment(**{"experiment": rig(), "model": "plain", **given}),
        {"experiment": None, "model": "plain", "element": "tet4", "threads": 1, "progress": None},
    ),
    "register_frame": (
        lambda **given: tr.register_frame(**{"experiment": rig(), "settings": quick(), **given}),
        {"experiment": rig(), "case": "down", "time": 12.0, "element": "tet4", "settings": quick()},
    ),
    "Experiment.frame": (rig().frame, {"case": "down", "time": 12.0}),
    "Experiment.actuator": (rig().actuator, {"name": "top"}),
    "Experiment": (
        experiment_with,
        {
            "name": "rig",
            "mesh": rig().mesh,
            "material": rig().material,
            "young_std": 3.0,
            "poisson_std": None,
            "gravity": None,
            "boundaries": rig().boundaries,
            "actuators": rig().actuators,
            "marker_names": rig().marker_names,
            "marker_reference": rig().marker_reference,
            "marker_std": 0.05,
            "targets": {},
            "cases": rig().cases,
            "force_std": 2.0,
            "rest_case": "rest",
            "effects": (),
            "trial_share": 0.0,
            "surface_std": 0.0,
            "surface_length": None,
            "simulated": None,
        },
    ),
    "FineModel": (
        lambda **given: tr.FineModel(**{"experiment": rig(), **given}),
        {"experiment": rig(), "meshing": FineMeshing(rim_edge=2.0)},
    ),
    "score_markers": (
        score_markers,
        {"residual": np.ones((1, 3)), "noise": np.eye(3), "absorbed": 0.1 * np.eye(3)},
    ),
    "phantom.breast_mesh": (tr.phantom.breast_mesh, {"n_nodes": 300}),
    "FineMeshing": (FineMeshing, {"rim_edge": 0.5, "growth": 1.0, "edge_share": 0.5, "cut": True}),
}

#: What a message may call an argument instead of its name; several are split by bars.
CALLED = {
    "body": "mesh",
    "address": "cluster",
    "tets": "tet",
    "node_sets": "node set|`a`",
    "reference": "marker",
    "measured": "marker|surface",
    "std": "std",
    "case": "case",
    "shape": "`b`",
    "direction": "direction",
    "held_nodes": "held",
    "fields": "variants",
    "nodes": "node",
    "indices": "node_sets",
    "body_force": "body force",
    "loads": "load",
    "time": "frame",
    "name": "actuator",
    "experiment": "experiment",
    "experiments": "no such file",
    "image": "image|no such file|regular file",
    "fibre": "Fibre",
    "targets": "target",
    "surface": "vertices|no such file",
    "path": "name must end in",
    "like": "no such file",
    "factor": "young",
    "marker_names": "marker_reference",
    "markers": "marker",
    "model": "model",
    "traction": "traction",
    "prescribed": "prescribed",
}

SWEPT = swept(CALLS)


@pytest.mark.parametrize(("call", "argument", "wrong"), SWEPT)
def test_a_wrong_argument_works_or_is_named(call, argument, wrong):
    good = next(given for each, given in CALLS.values() if each is call)
    given = {name: value for name, value in good.items() if value is not None}
    ends_well(call, argument, CALLED, **{**given, argument: wrong})


@pytest.mark.parametrize("call", CALLS, ids=str)
def test_the_call_that_is_swept_works_with_good_arguments(call):
    function, good = CALLS[call]
    function(**{name: value for name, value in good.items() if value is not None})


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_an_effect_of_wrong_keys_is_refused_as_one(effect, wrong):
    keys = [key.name for key in dataclasses.fields(effect)]
    if not keys:
        return
    with contextlib.suppress(ExperimentError):
        effect(**dict.fromkeys(keys, wrong))


READERS = {
    "read_mesh": tr.read_mesh,
    "read_markers": tr.read_markers,
    "read_targets": tr.read_targets,
    "read_seen": tr.read_seen,
    "read_surface": tr.read_surface,
    "read_recording": tr.read_recording,
    "read_experiment": tr.read_experiment,
    "read_registration": tr.read_registration,
    "read_material_experiment": tr.read_material_experiment,
    "open_dataset": tr.open_dataset,
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_wrong_path_is_no_file(read, wrong, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FormatError) as caught:
        read(wrong)
    assert "path" in str(caught.value) or "no such file" in str(caught.value)


@pytest.mark.parametrize(
    "name", ["a.csv", "a.fcsv", "a.mrk.json", "a.vtu", "a.vtk", "a.msh", "a.npz", "a.toml", "experiment.toml"]
)
@pytest.mark.parametrize("content", [None, b"", b"\x00\xff\xfe" * 99, b"words", b"\n" * 50], ids=str)
@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_folder_and_an_empty_or_binary_file_are_refused(read, name, content, tmp_path):
    path = tmp_path / name
    path.mkdir() if content is None else path.write_bytes(content)
    with pytest.raises(FormatError, match=re.escape(name)):
        read(path)


@pytest.mark.parametrize(
    "wrong",
    [value for name, value in WRONG.items() if name not in ("a word",)],
    ids=[n for n in WRONG if n != "a word"],
)
def test_nothing_is_written_to_a_wrong_path(wrong, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for write in (registered().save, registered().report, lambda path: tr.write_experiment(filed(tmp_path), path)):
        with pytest.raises(TissueRegError, match=r"path|folder|writ"):
            write(wrong)


def test_options_of_a_reader_that_are_wrong_are_refused(tmp_path):
    (tmp_path / "m.csv").write_text(GOOD_MARKERS)
    (tmp_path / "read_markers.csv").write_text(GOOD_MARKERS)
    (tmp_path / "read_targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,1,2,3\n")
    (tmp_path / "read_seen.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,1,2,3\n")
    (tmp_path / "read_surface.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n")
    (tmp_path / "sit.fcsv").write_text(FIDUCIALS)
    (tmp_path / "recording.csv").write_text(GOOD_RECORDING)
    np.savez(tmp_path / "m.npz", nodes_mm=mesh().nodes, tets=mesh().tets, fixed_nodes=mesh().fixed_nodes)
    for wrong in WRONG.values():
        ends_well(tr.read_markers, "std", {}, path=tmp_path / "m.csv", std=wrong)
        for frame in ("frame", "table_frame"):
            for read in (tr.read_markers, tr.read_targets, tr.read_seen, tr.read_surface):
                ends_well(read, frame, {}, path=tmp_path / f"{read.__name__}.csv", **{"frame": "LPS", frame: wrong})
        ends_well(tr.read_seen, "std", {}, path=tmp_path / "read_seen.csv", std=wrong)
        for option in ("columns", "offsets", "rate_hz", "unit"):
            ends_well(tr.read_recording, option, {}, path=tmp_path / "recording.csv", **{option: wrong})
        ends_well(tr.read_mesh, "fixed", {}, path=tmp_path / "m.npz", fixed=wrong)
        ends_well(tr.read_mesh, "frame", {}, path=tmp_path / "m.npz", frame=wrong)
        ends_well(tr.read_markers, "measured", {}, path=tmp_path / "sit.fcsv", measured=wrong)
        ends_well(tr.read_markers, "std", {}, path=tmp_path / "sit.fcsv", measured=tmp_path / "sit.fcsv", std=wrong)


@pytest.mark.parametrize(
    ("said", "unit"),
    [({"young": 3e5}, "Pa: divide by 1000"), ({"young": 1e-4}, "MPa: multiply by 1000")],
)
def test_a_modulus_that_no_soft_material_has_is_accepted_and_its_likely_unit_named(said, unit):
    with pytest.warns(UnitWarning, match=unit):
        assert tr.Material(**said).young == said["young"]


def test_moduli_of_silicones_and_soft_tissues_and_stiff_parts_in_them_are_taken_in_silence():
    for young in (0.01, 0.3, 5.0, 2000.0, 1e5, np.r_[np.full(99, 8.0), 2e7]):
        tr.Material(young)


@pytest.mark.parametrize("young", [1e-9, 1e11])
def test_a_modulus_that_no_solid_has_is_refused(young):
    with pytest.raises(MaterialError, match="`young` must be in kPa, from 1e-06 to 1e\\+10 kPa"):
        tr.Material(young)


#: Public names that take no argument, or are made by us alone.
NO_ARGUMENTS = {
    "Recording",
    "ContactRegistration",
    "LearnedRegistration",
    "MarkerAdvice",
    "Progress",
    "Registration",
    "Simulation",
    "StoredRegistration",
    "TissueRegError",
    "__version__",
    "effects",
    "errors",
    "phantom",
    "tracking",
}


def test_every_public_name_is_swept():
    swept = {name.split(".")[0].split(" ")[0] for name in CALLS} | set(READERS) | NO_ARGUMENTS
    assert set(tr.__all__) - swept == {"Fibre", "write_experiment"}, "these have tests of their own above"


def filed(folder: Path):
    """An experiment that was read from a file, next to the folder."""
    return read_experiment(write_experiment(folder.parent / f"{folder.name}-rig"))
