"""A registered field for points thought of later: exact inside, fading around, stored and read again."""

import json
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from support.pushes import ELEMENT, MATERIAL, push
from tissuereg.body.surroundings import SpaceMap, surroundings
from tissuereg.errors import FormatError, MarkerError
from tissuereg.registration.deviations import Deviations
from tissuereg.registration.field import RegisteredField

MESH = block((40.0, 30.0, 50.0), (4, 3, 5))


def bent(places):
    """A smooth displacement that holds the base."""
    x, y, z = np.moveaxis(places, -1, 0)
    return np.stack([0.002 * z**2, 0.05 * z * np.sin(x / 15.0), -0.03 * z + 0.01 * y], axis=-1)


def field(roots=None, tail=None):
    rng = np.random.default_rng(0)
    roots = 0.3 * rng.standard_normal((9, MESH.n_nodes, 3)) if roots is None else roots
    doubt = MESH.nodes[:, 2] - 45.0
    return RegisteredField(MESH, bent(MESH.nodes), Deviations.of(roots, doubt, tail, 0.0))


def inner(count, seed=1):
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.ones(4), count)
    tets = MESH.tets[rng.integers(MESH.n_tets, size=count)]
    return np.einsum("pk,pkx->px", shares, MESH.nodes[tets]), tets, shares


def test_inner_points_move_as_the_mesh_interpolates_and_nodes_as_they_do():
    places, tets, shares = inner(10_000)
    answer = field().at(places)
    wanted = np.einsum("pk,pkx->px", shares, bent(MESH.nodes)[tets])
    assert answer.inside.all()
    assert np.abs(answer.mean - places - wanted).max() < 1e-9
    nodes = field().at(MESH.nodes)
    assert np.abs(nodes.mean - MESH.nodes - bent(MESH.nodes)).max() < 1e-9


def test_the_covariance_of_a_point_is_that_of_the_fields_at_it():
    rng = np.random.default_rng(3)
    roots = rng.standard_normal((7, MESH.n_nodes, 3))
    places, tets, shares = inner(50)
    found = field(roots).at(places).covariance
    at_points = np.einsum("pk,rpkx->rpx", shares, roots[:, tets])
    assert found == pytest.approx(np.einsum("rpa,rpb->pab", at_points, at_points), abs=1e-4)
    assert field().at(places, covariance=False).covariance is None


def test_few_modes_keep_every_variance():
    rng = np.random.default_rng(4)
    smooth = np.array([np.sin(MESH.nodes @ rng.standard_normal((3, 3)) / 30.0) for _ in range(4)])
    roots = np.concatenate([smooth, 0.01 * rng.standard_normal((40, *smooth.shape[1:]))])
    few = Deviations.of(roots, np.zeros(MESH.n_nodes, bool))
    assert len(few.modes) < 10
    assert few.std == pytest.approx(np.sqrt(np.sum(roots**2, axis=(0, 2))), rel=1e-4)
    assert few.times(4.0).std == pytest.approx(2.0 * few.std, rel=1e-5)
    assert np.trace(few.covariance, axis1=1, axis2=2) == pytest.approx(few.std**2, rel=1e-4)
    still = Deviations.of(np.zeros((3, MESH.n_nodes, 3)), np.zeros(MESH.n_nodes, bool))
    assert not still.std.any()


def test_points_outside_and_points_of_which_no_marker_tells_are_flagged():
    answer = field(tail=5.0).at([[20.0, 15.0, 25.0], [20.0, 15.0, 49.0], [20.0, 15.0, 60.0]])
    assert answer.flag == (None, "no marker tells", "outside the body")
    assert answer.inside.tolist() == [True, True, False]
    assert len(answer) == 3
    # The t law of the same 90 % region reaches farther out at 99 %.
    gaussian = replace(answer, tail=None)
    assert answer.region(0, 0.9).radii == pytest.approx(gaussian.region(0, 0.9).radii)
    assert np.all(answer.region(0, 0.99).radii > 1.05 * gaussian.region(0, 0.99).radii)


def test_around_the_body_the_displacement_goes_on_and_fades_to_nothing():
    space = SpaceMap(MESH, bent(MESH.nodes))
    corners = MESH.nodes[MESH.surface]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    at = corners.mean(axis=1)
    inside, outside = space.at(at - 1e-6 * normal), space.at(at + 1e-6 * normal)
    assert inside[1].all()
    assert not outside[1].any()
    assert np.abs(inside[0] - outside[0]).max() < 0.02 * np.abs(bent(MESH.nodes)).max()
    # On the whole it goes the way that the skin goes.
    assert np.sum(space.at(at + 8.0 * normal)[0] * inside[0]) > 0.3 * np.sum(inside[0] ** 2)
    most = np.abs(bent(MESH.nodes)).max(axis=0)
    sizes = [np.abs(space.at(at + out * normal)[0]).max(axis=0) for out in (1.0, 8.0, 16.0, 26.0, 200.0)]
    assert all(np.all(size <= most + 1e-9) for size in sizes)
    assert [np.linalg.norm(size) for size in sizes] == sorted((np.linalg.norm(size) for size in sizes), reverse=True)
    assert not sizes[-1].any()

    assert len(surroundings(MESH).tets) > 1000


def test_the_way_back_undoes_the_way_there():
    space = SpaceMap(MESH, bent(MESH.nodes))
    places = np.concatenate([inner(500)[0], inner(60)[0] + [0.0, 0.0, 25.0]])
    moved, _ = space.at(places)
    assert np.abs(space.back(places + moved) - moved).max() < 1e-9
    assert not space.back(np.array([[900.0, 0.0, 0.0]])).any()


@pytest.mark.parametrize("bad", [[[np.nan, 0.0, 0.0]], [[0.0, 0.0]], "x"])
def test_points_that_are_no_places_are_refused(bad):
    with pytest.raises((MarkerError, tr.errors.ShapeError)):
        field().at(bad)


def test_a_region_needs_covariances():
    answer = field().at([[20.0, 15.0, 25.0]], covariance=False)
    for asked in (lambda: answer.region(0), lambda: answer.std):
        with pytest.raises(MarkerError, match="covariance=True"):
            asked()


@pytest.fixture(scope="module")
def result():
    body = tr.Body(push().mesh, MATERIAL, ELEMENT)
    targets = {"deep": (30.0, 30.0, 12.0)}
    return tr.register(body, push().markers(), targets=targets, settings=tr.RegisterSettings(threads=1))


def test_a_result_answers_as_its_targets_do(result):
    answer = result.at([[30.0, 30.0, 12.0]])
    target = result.target("deep")
    assert answer.mean[0] == pytest.approx(target.mean, abs=1e-9)
    # Draws of 128: some per cent.
    assert np.sqrt(np.trace(answer.covariance[0])) == pytest.approx(np.sqrt(np.trace(target.covariance)), rel=0.2)
    assert answer.flag == (target.flag,)


def test_a_stored_registration_answers_as_the_result_did(result, tmp_path):
    result.save(tmp_path / "out", picture=False)
    stored = tr.read_registration(tmp_path / "out")
    places = np.concatenate([push().mesh.nodes[::7], [[30.0, 30.0, 40.0]]])
    one, other = result.at(places), stored.at(places)
    assert np.array_equal(one.mean, other.mean)
    assert one.flag == other.flag
    assert other.covariance == pytest.approx(one.covariance, abs=2e-3 * np.abs(one.covariance).max())
    assert stored.trust == result.trust
    assert stored.target("deep").region().radii == pytest.approx(result.target("deep").region().radii)
    assert stored.std == pytest.approx(result.std, rel=2e-3)
    assert np.array_equal(stored.displacement, result.displacement)
    assert stored.mesh.node_sets.keys() == result.mesh.node_sets.keys()
    assert "405 nodes" in repr(stored)
    with pytest.raises(MarkerError, match="no target named 'x'"):
        stored.target("x")


def test_a_spoilt_folder_is_refused_by_name(result, tmp_path):
    folder = result.save(tmp_path / "out", picture=False)
    content = (folder / "registration.json").read_text(encoding="utf-8")
    for spoilt in ("{", "[]", '{"targets": {}}', content.replace('"mean_mm"', '"mean"', 1)):
        (folder / "registration.json").write_text(spoilt, encoding="utf-8")
        with pytest.raises(FormatError, match="out"):
            tr.read_registration(folder)
    (folder / "registration.json").write_text(content, encoding="utf-8")
    with np.load(folder / "field.npz") as whole:
        arrays = dict(whole)
    wrong = {
        "modes": arrays["modes"][:, :5],
        "rest_mm2": -1.0 - arrays["rest_mm2"],
        "doubt_mm2": arrays["doubt_mm2"][:5],
        "displacement_mm": np.full_like(arrays["displacement_mm"], np.nan),
    }
    for name, array in wrong.items():
        np.savez(folder / "field.npz", **{**arrays, name: array})
        with pytest.raises(FormatError, match=r"field\.npz"):
            tr.read_registration(folder)
    (folder / "field.npz").unlink()
    with pytest.raises(FormatError, match=r"field\.npz"):
        tr.read_registration(folder)
    assert json.loads(content)["targets"]
