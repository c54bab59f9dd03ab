"""Surfaces become bodies: positive tetrahedra, the volume of the surface, node sets, errors that state what to do."""

import subprocess
import sys

import numpy as np
import pytest

import tissuereg as tr
from support.surfaces import box, inverted, sphere, together, volume, without
from tissuereg.errors import FormatError, MeshError, MeshingError, MissingPackageError, UnitError
from tissuereg.meshing import fill
from tissuereg.meshing.body import largest_distance
from tissuereg.simulation.fine.bisection import shape_quality

BALL = sphere()
needs_mesher = pytest.mark.skipif(
    fill.importlib.util.find_spec("pytetwild") is None, reason="the extra `mesh` is not installed"
)


def sides(mesh, surface):
    """Largest distances between the boundary of the tets and a surface, either way, mm."""
    boundary, given = tr.Triangles(mesh.nodes, mesh.surface), tr.Triangles(*surface)
    return largest_distance(boundary, given), largest_distance(given, boundary)


@pytest.fixture(scope="module")
def beam():
    """A box of 20 x 20 x 40 mm without one triangle and with normals inwards, and what is made of it."""
    if fill.importlib.util.find_spec("pytetwild") is None:
        pytest.skip("the extra `mesh` is not installed")
    sets = {"lid": "plane 0 0 -2 -40 0.3", "corner": ["ball 0 0 0 3", "ball 20 20 0 3"]}
    return tr.tetrahedralize(without(inverted(box()), 3), 4.0, fixed=(0, 0, 1, 0, 0.3), node_sets=sets, threads=1)


def test_the_body_keeps_volume_and_faces_of_the_surface(beam):
    # Flat faces are kept within the given deviation, so the volume within deviation times area.
    deviation = beam.settings["deviation_mm"]
    assert deviation == pytest.approx(1e-3 * np.linalg.norm([20, 20, 40]))
    assert beam.volumes.min() > 0
    assert beam.volumes.sum() == pytest.approx(16000.0, abs=deviation * 4000.0)
    assert max(sides(beam, box())) <= 1.5 * deviation


def test_repairs_are_reported(beam):
    assert [sentence.split(":")[0] for sentence in beam.repaired] == [
        "1 hole was closed",
        "all normals pointed inwards and were turned outwards",
    ]


def test_the_quality_is_that_of_the_mesh(beam):
    found = beam.quality
    shape = shape_quality(beam.nodes, beam.tets)
    length = np.linalg.norm(beam.nodes[beam.edges[:, 0]] - beam.nodes[beam.edges[:, 1]], axis=1)
    assert (found["min_quality"], found["median_quality"]) == (shape.min(), np.median(shape))
    assert found["min_quality"] > 0.05
    assert (found["shortest_edge_mm"], found["median_edge_mm"]) == (length.min(), np.median(length))
    assert found["volume_change_percent"] == pytest.approx(beam.volumes.sum() / 160.0 - 100.0, abs=1e-9)
    assert (found["surface_distance_mm"], found["missed_mm"]) == pytest.approx(sides(beam, box()), abs=1e-6)
    assert found["parts"] == 1
    # The mesher splits edges above 4/3 of the size and joins those below 4/5 of it where shape and quality let it.
    assert 0.7 * 4.0 <= found["median_edge_mm"] <= 4 / 3 * 4.0
    assert set(beam.seconds) == {"read", "repair", "fill", "measure"}


def test_node_sets_follow_the_words_of_the_command_line(beam):
    assert np.array_equal(beam.fixed_nodes, np.flatnonzero(np.abs(beam.nodes[:, 2]) <= 0.3))
    assert np.array_equal(beam.node_set("lid"), np.flatnonzero(np.abs(beam.nodes[:, 2] - 40) <= 0.3))
    near = [np.linalg.norm(beam.nodes - corner, axis=1) <= 3 for corner in ([0, 0, 0], [20, 20, 0])]
    assert all(ball.any() for ball in near)
    assert np.array_equal(beam.node_set("corner"), np.flatnonzero(near[0] | near[1]))


def test_the_body_can_be_simulated(beam):
    weight = tr.Load(np.where(beam.nodes[:, 2:] > 39.0, [[50.0, 0.0, 0.0]], 0.0))
    found = tr.simulate(beam, weight, tr.Material(young=10.0, poisson=0.45))
    assert np.abs(found.displacement[beam.fixed_nodes]).max() == 0.0
    assert found.displacement[:, 0].max() > 0.1


@needs_mesher
def test_a_sphere_in_metres_keeps_its_volume_and_a_cavity_stays_hollow():
    wall = together(sphere(30.0), inverted(sphere(12.0, subdivisions=1)))
    mesh = tr.tetrahedralize((wall[0] / 1000.0, wall[1]), 10.0, unit="m", deviation_mm=0.3, threads=1)
    # The faces lie within the deviation on either side, over the areas of both spheres.
    area = 4.0 * np.pi * (30.0**2 + 12.0**2)
    assert mesh.volumes.min() > 0
    assert mesh.volumes.sum() == pytest.approx(volume(wall), abs=0.3 * area)
    assert mesh.quality["surface_distance_mm"] <= 0.3 * 1.5
    assert np.linalg.norm(mesh.nodes, axis=1).min() > 9.0
    assert "kept as a cavity" in mesh.repaired[0]


@needs_mesher
def test_two_bodies_are_filled_and_the_user_is_warned():
    pair = together(sphere(10.0, subdivisions=1), sphere(10.0, centre=(30.0, 0, 0), subdivisions=1))
    with pytest.warns(UserWarning, match="in 2 parts that share no node"):
        mesh = tr.tetrahedralize(pair, 8.0, threads=1)
    assert mesh.quality["parts"] == 2
    assert mesh.repaired[0].startswith("2 separate shells")


# --- refusals; none of them runs the mesher ---


@pytest.fixture
def no_mesher_runs(monkeypatch):
    def run(*words, **settings):
        pytest.fail("the mesher was started")

    monkeypatch.setattr(fill.subprocess, "run", run)
    monkeypatch.setattr("tissuereg.meshing.body.check_mesher", lambda: None)


@pytest.mark.usefixtures("no_mesher_runs")
@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"size_mm": 0.0}, MeshError, "positive and at most half of the largest extent, 20 mm, got 0 mm"),
        ({"size_mm": 21.0}, MeshError, "at most half of the largest extent"),
        ({"size_mm": float("nan")}, MeshError, "got nan"),
        ({"size_mm": 0.1}, MeshError, r"at most 3,000,000 tetrahedra; 0\.1 mm would make about 2\.7e\+08: choose at"),
        ({"size_mm": 5.0, "deviation_mm": 5.0}, MeshError, "less than the size, 5 mm"),
        ({"size_mm": 5.0, "unit": "inch"}, FormatError, "one of mm, cm, m, got 'inch'"),
        ({"size_mm": 5.0, "unit": "m"}, UnitError, "looks like millimetres; say --unit mm"),
        ({"size_mm": 5.0, "fixed": "plane 0 0 0 1 1"}, FormatError, "normal not zero"),
        ({"size_mm": 5.0, "node_sets": {"lid": "ball 0 0 9"}}, FormatError, "`lid` must be 'ball x y z r'"),
        ({"size_mm": 5.0, "node_sets": {"lid": "ball 0 0 9 -1"}}, FormatError, "radius r positive"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_the_mesher_runs(settings, error, words):
    with pytest.raises(error, match=words):
        tr.tetrahedralize(BALL, **settings)


def test_the_unit_is_checked_before_anything_else(monkeypatch):
    monkeypatch.setitem(sys.modules, "pytetwild", None)
    broken = without((BALL[0] / 1000.0, BALL[1]), range(10))
    with pytest.raises(UnitError, match=r"extent 0\.04: looks like metres; say --unit m"):
        tr.tetrahedralize(broken, -1.0, fixed="plane")


def test_a_missing_mesher_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pytetwild", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'tissuereg\[mesh\]'"):
        tr.tetrahedralize(BALL, 10.0)


@pytest.mark.parametrize(
    ("code", "output", "error", "words"),
    [
        (65, "No module named 'pyvista'", MissingPackageError, r"tissuereg\[mesh\].*No module named 'pyvista'"),
        (67, "the input is odd", MeshingError, "ended with code 67: the input is odd. Try another size"),
        (-11, "", MeshingError, "was ended by signal 11"),
    ],
)
def test_a_mesher_that_ends_badly_is_an_error_of_its_own(monkeypatch, code, output, error, words):
    def run(command, **settings):
        return subprocess.CompletedProcess(command, code, "", output)

    monkeypatch.setattr(fill.subprocess, "run", run)
    with pytest.raises(error, match=words):
        fill.filled(tr.Triangles(*BALL), 10.0, 0.1)


def test_a_mesher_without_memory_is_a_memory_error(monkeypatch):
    monkeypatch.setattr(fill.subprocess, "run", lambda words, **_: subprocess.CompletedProcess(words, 66, "", ""))
    with pytest.raises(MemoryError):
        fill.filled(tr.Triangles(*BALL), 10.0, 0.1)


@pytest.mark.parametrize(
    ("tets", "words"),
    [(np.empty((0, 4), int), "made no tetrahedron"), ([[0, 1, 2, 3], [0, 2, 1, 3]], "1 of 2 that the mesher made")],
)
def test_tetrahedra_without_a_volume_are_no_mesh(monkeypatch, tets, words):
    def run(command, **settings):
        nodes = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9.0]])
        np.savez(command[-1], nodes=nodes, tets=np.asarray(tets), mesher="one that is spoilt")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(fill.subprocess, "run", run)
    with pytest.raises(MeshingError, match=words):
        fill.filled(tr.Triangles(*BALL), 10.0, 0.1)
