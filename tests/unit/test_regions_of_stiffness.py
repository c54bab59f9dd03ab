"""Parts of a body with a stiffness of their own: named by node sets, perhaps uncertain."""

import json

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.body.observe import TargetObservation
from tissuereg.cli import main
from tissuereg.errors import ArgumentError, MaterialError, MeshError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import write_markers
from tissuereg.registration.contacts.registration import _regions

MESH = block((60.0, 60.0, 24.0), (8, 8, 4))
SOFT, HARD = 8.0, 400.0

#: A hard part in the middle of the slab, by its nodes, and its tets.
CORE = np.flatnonzero((np.abs(MESH.nodes[:, :2] - 30.0) <= 15.1).all(axis=1) & (MESH.nodes[:, 2] >= 11.9))
INSIDE = np.isin(MESH.tets, CORE).all(axis=1)
BODY = MESH.with_node_set("core", CORE)

#: Beside the hard part and in its middle.
TARGETS = {"beside": [50.0, 30.0, 14.0], "middle": [30.0, 30.0, 18.0]}


@pytest.fixture(scope="module")
def pushed():
    """Markers of the slab, pushed at its side, and the true places of the targets."""
    forces = np.zeros((MESH.n_nodes, 3))
    side = np.flatnonzero((MESH.nodes[:, 0] == 0.0) & (MESH.nodes[:, 2] > 11.0))
    forces[side] = [120.0, 0.0, 0.0]
    young = np.where(INSIDE, HARD, SOFT)
    moved = tr.Simulator(MESH, element="tet4").solve(tr.Load(forces=forces), tr.Material(young, 0.4)).displacement
    nodes = np.random.default_rng(0).choice(MESH.surface_nodes[MESH.nodes[MESH.surface_nodes, 2] > 3.0], 12, False)
    noise = 0.03 * np.random.default_rng(1).standard_normal((12, 3))
    markers = tr.Markers(MESH.nodes[nodes], MESH.nodes[nodes] + moved[nodes] + noise, 0.03)
    targets = TargetObservation(MESH, TARGETS)
    return markers, targets.reference + targets.predict(moved[targets.nodes])


def registered(markers, **options):
    body = tr.Body(BODY, tr.Material(SOFT, 0.4), "tet4", **options)
    return tr.register(body, markers, targets=TARGETS, settings=tr.RegisterSettings(threads=1))


def off(result, truth):
    return float(np.mean([np.linalg.norm(result.targets[n].mean - t) for n, t in zip(TARGETS, truth, strict=True)]))


def test_a_hard_part_that_is_known_improves_targets_beside_and_in_it(pushed):
    markers, truth = pushed
    known = registered(markers, regions={"core": HARD})
    assert np.array_equal(known.body.material.young_array, np.where(INSIDE, HARD, SOFT))
    assert off(known, truth) < 0.6 * off(registered(markers), truth)
    assert known.provenance.to_json(known.given)["settings"]
    assert known.body.to_json()["regions"] == {"core": {"young_kpa": HARD, "std_kpa": 0.0, "tets": int(INSIDE.sum())}}


def test_an_uncertain_stiffness_widens_regions_by_its_own_effect(pushed):
    markers, _ = pushed
    sure, unsure = (registered(markers, regions={"core": (40.0, std)}) for std in (0.0, 20.0))
    assert np.array_equal(unsure.displacement, sure.displacement)
    half = registered(markers, regions={"core": (40.0, 10.0)})
    for name in TARGETS:
        gain = unsure.targets[name].covariance - sure.targets[name].covariance
        assert np.linalg.eigvalsh(gain).min() > -1e-9
        assert np.trace(gain) > 1e-3 * np.trace(sure.targets[name].covariance)
        # An effect of the first order: half the deviation, a quarter of the variance.
        assert half.targets[name].covariance - sure.targets[name].covariance == pytest.approx(0.25 * gain, rel=1e-3)


def test_of_parts_that_overlap_the_smaller_counts():
    around = np.flatnonzero((np.abs(MESH.nodes[:, :2] - 30.0) <= 22.6).all(axis=1))
    mesh = BODY.with_node_set("around", around)
    wide = np.isin(MESH.tets, around).all(axis=1) & ~INSIDE
    young = np.where(INSIDE, 400.0, np.where(wide, 20.0, SOFT))
    for regions in ({"core": 400.0, "around": 20.0}, {"around": 20.0, "core": 400.0}):
        assert np.array_equal(tr.Body(mesh, tr.Material(SOFT), regions=regions).material.young_array, young)
    # The modulus around the core is uncertain there alone.
    body = tr.Body(mesh, tr.Material(SOFT, 0.4), "tet4", regions={"around": (20.0, 5.0), "core": 400.0})
    [(cause, std)] = _regions(body)
    assert std == 5.0
    assert np.array_equal(cause.rates, wide.astype(float))
    told = body.to_json()["regions"]
    assert {name: one["tets"] for name, one in told.items()} == {"around": wide.sum(), "core": INSIDE.sum()}
    # What is made of its parts again has the same parts.
    again = tr.Body(mesh, tr.Material(SOFT, 0.4), "tet4", regions=body.regions)
    assert all(np.array_equal(again.regions[name].tets, one.tets) for name, one in body.regions.items())


def test_of_parts_of_the_same_tets_the_later_one_counts():
    mesh = BODY.with_node_set("same", CORE)
    body = tr.Body(mesh, tr.Material(SOFT), regions={"same": (20.0, 5.0), "core": 400.0})
    assert np.array_equal(body.material.young_array, np.where(INSIDE, 400.0, SOFT))
    assert body.to_json()["regions"]["same"]["tets"] == 0
    assert not _regions(body)


def test_regions_go_on_top_of_moduli_of_tets_and_of_points():
    of_tets = tr.Body(BODY, tr.Material(np.linspace(5.0, 9.0, MESH.n_tets)), regions={"core": 50.0}).material
    assert np.array_equal(of_tets.young_array, np.where(INSIDE, 50.0, np.linspace(5.0, 9.0, MESH.n_tets)))
    of_points = tr.Body(BODY, tr.Material(np.full((MESH.n_tets, 4), 6.0)), regions={"core": 50.0}).material
    assert np.array_equal(of_points.young_array, np.where(INSIDE, 50.0, 6.0)[:, None] * np.ones(4))


@pytest.mark.parametrize(
    ("regions", "error", "said"),
    [
        ({"liver": 4.0}, MeshError, "node set named 'liver'"),
        ({"fixed": 4.0}, MeshError, "'fixed' has none"),
        ({"core": -4.0}, MaterialError, "a modulus above 0 kPa"),
        ({"core": (4.0, -1.0)}, MaterialError, "a standard deviation from 0"),
        ({"core": (4.0, 1.0, 2.0)}, MaterialError, "a modulus, or it and its standard deviation"),
        ({"core": "hard"}, MaterialError, "core"),
        ([("core", 4.0)], ArgumentError, "regions"),
    ],
)
def test_what_is_no_region_is_refused(regions, error, said):
    with pytest.raises(error, match=said):
        tr.Body(BODY, regions=regions)


def test_a_trained_model_refuses_regions():
    with pytest.raises(tr.errors.ModelError, match="`regions` must be left out with a trained model"):
        tr.Registrar(tr.Body(BODY, regions={"core": 4.0}), np.array([[30.0, 30.0, 24.0]]), model="phantom")


def test_the_command_takes_node_sets(pushed, tmp_path, capsys):
    markers, _ = pushed
    write_vtu(tmp_path / "slab.vtu", BODY)
    write_markers(tmp_path / "markers.csv", markers)
    files = ["register", str(tmp_path / "slab.vtu"), str(tmp_path / "markers.csv"), "--out", str(tmp_path / "out")]
    words = ["--stiffness", "core=400:50", "--stiffness", "graded", "--no-picture", "--quiet"]
    assert main([*files, *words]) in (0, 4)
    body = json.loads((tmp_path / "out" / "registration.json").read_text(encoding="utf-8"))
    assert '"core": {"young_kpa": 400.0, "std_kpa": 50.0, "tets": ' in json.dumps(body)
    for word, said in (("core", "SET=KPA"), ("core=x", "SET=KPA"), ("=4", "SET=KPA"), ("none=4", "'none'")):
        assert main([*files, "--stiffness", word]) == 2
        assert said in " ".join(capsys.readouterr().err.split())
    assert main([*files, "--stiffness", "graded", "--stiffness", "believed"]) == 2
    assert main([*files, "--stiffness", "core=4", "--stiffness", "core=5"]) == 2
