"""What all methods of the comparison share, and those that know the markers alone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tissuereg as tr
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ArgumentError, MarkerError, ShapeError
from tissuereg_paper.rivals import (
    RIVALS,
    Estimate,
    MeanAbout,
    MeanOfMarkers,
    Rigid,
    RigidAbout,
    Rival,
    Setting,
    Spline,
    SplineAbout,
    spline_displacement,
)

PLACES = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 30.0], [15.0, 20.0, 35.0], [30.0, 5.0, 20.0]])


def setting(mesh, **parts) -> Setting:
    """Return a setting with five markers."""
    given = {"reference_mm": PLACES, "std_mm": np.full(5, 0.1), "material": tr.Material()}
    return Setting(mesh, **{**given, **parts})


class NeedsAll(Rival):
    """A method that needs everything and says that nothing moves."""

    name = "needs all"
    needs = frozenset({"simulation", "fields"})

    def register(self, measured_mm, simulation_mm=None):
        return Estimate(np.zeros_like(self.moment(measured_mm, simulation_mm).start_mm))


def test_every_method_is_listed_under_the_name_that_it_prints():
    assert {name: rival.name for name, rival in RIVALS.items()} == {name: name for name in RIVALS}


def test_the_mean_of_the_markers_leaves_out_those_that_were_not_seen(block_mesh):
    measured = PLACES + np.array([1.0, 2.0, 3.0])
    measured[1] = np.nan
    measured[3] += 4.0
    found = MeanOfMarkers(setting(block_mesh)).register(measured)
    # Three markers moved by (1, 2, 3), one by 4 more: the mean of four is 1 more.
    np.testing.assert_allclose(found.displacement_mm, np.tile([2.0, 3.0, 4.0], (block_mesh.n_nodes, 1)), atol=1e-13)


@pytest.mark.parametrize("unseen", [[], [0], [2, 4]])
def test_a_rigid_motion_is_found_exactly_from_any_three_markers(block_mesh, unseen):
    turn, shift = Rotation.from_rotvec([0.3, -0.2, 0.5]), np.array([1.0, 2.0, -3.0])
    measured = turn.apply(PLACES) + shift
    measured[unseen] = np.nan
    found = Rigid(setting(block_mesh)).register(measured)
    expected = turn.apply(np.array(block_mesh.nodes)) + shift - block_mesh.nodes
    np.testing.assert_allclose(found.displacement_mm, expected, atol=1e-12)  # rounding at 50 mm


def test_an_affine_motion_is_found_exactly_by_the_spline(block_mesh):
    gradient = np.array([[0.1, 0.0, 0.2], [0.0, -0.1, 0.0], [0.3, 0.0, 0.05]])
    found = Spline(setting(block_mesh)).register(PLACES + PLACES @ gradient.T)
    # Kernel values at 50 mm are about 1e4, so the system loses four digits of 1e-16 times 50 mm.
    np.testing.assert_allclose(found.displacement_mm, block_mesh.nodes @ gradient.T, atol=1e-10)


def test_two_markers_give_the_rigid_motion_without_rotation(block_mesh):
    measured = PLACES + np.array([0.0, 0.0, 1.0])
    measured[2:] = np.nan
    found = Rigid(setting(block_mesh)).register(measured)
    np.testing.assert_allclose(found.displacement_mm, np.tile([0.0, 0.0, 1.0], (block_mesh.n_nodes, 1)), atol=1e-13)


def test_a_smoothed_spline_passes_markers_by(block_mesh):
    moved = np.random.default_rng(0).standard_normal(PLACES.shape)

    def misfit(smoothing):
        alone = spline_displacement(PLACES, PLACES + moved, PLACES, smoothing * np.full(len(PLACES), 0.01))
        rival = Spline(setting(block_mesh), smoothing=smoothing).register(PLACES + moved)
        again = spline_displacement(PLACES, PLACES + moved, block_mesh.nodes, smoothing * 0.01)
        np.testing.assert_allclose(rival.displacement_mm, again, atol=1e-12)  # rounding at 50 mm
        return np.linalg.norm(alone - moved)

    # Kernel values at 50 mm are about 1e4.
    assert misfit(0.0) < 1e-10 < misfit(1e3) < misfit(1e6)


@pytest.mark.parametrize(
    ("about", "alone", "constants"),
    [(MeanAbout, MeanOfMarkers, {}), (RigidAbout, Rigid, {}), (SplineAbout, Spline, {"smoothing": 1e5})],
)
def test_a_simple_method_about_the_simulation_carries_on_what_that_leaves(block_mesh, about, alone, constants):
    simulation = 1e-3 * block_mesh.nodes[:, [1, 2, 0]] ** 2
    made, rest = about(setting(block_mesh), **constants), np.random.default_rng(1).standard_normal(PLACES.shape)
    observed = MarkerObservation(block_mesh, PLACES, tuple("abcde"))
    there = PLACES + observed.predict(simulation[observed.nodes])
    there[2] = np.nan
    np.testing.assert_allclose(made.register(there, simulation).displacement_mm, simulation, atol=1e-12)
    changed = made.register(there + rest, simulation).displacement_mm - simulation
    seen = PLACES + rest
    seen[2] = np.nan
    expected = alone(setting(block_mesh), **constants).register(seen)
    np.testing.assert_allclose(changed, expected.displacement_mm, atol=1e-10)  # rounding over the kernel's condition


@pytest.mark.parametrize("rival", [MeanOfMarkers, Rigid, Spline])
def test_a_moment_without_markers_is_refused(block_mesh, rival):
    with pytest.raises(MarkerError, match="at least one of 5 markers must be seen"):
        rival(setting(block_mesh)).register(PLACES * np.nan)


def test_a_method_is_refused_a_setting_that_lacks_what_it_needs(block_mesh):
    with pytest.raises(ArgumentError, match=r"`setting\.fields` must be given for the method 'needs all'"):
        NeedsAll(setting(block_mesh))


def test_a_moment_without_simulation_is_refused_where_one_is_needed(block_mesh):
    rival = NeedsAll(setting(block_mesh, fields=np.zeros((1, block_mesh.n_nodes, 3))))
    with pytest.raises(ArgumentError, match="`simulation_mm` must be given for the method 'needs all'"):
        rival.register(PLACES)


@pytest.mark.parametrize(
    ("parts", "error", "says"),
    [
        ({"mesh": None}, ArgumentError, "`mesh`"),
        ({"reference_mm": PLACES[:, :2]}, ShapeError, "`reference_mm`"),
        ({"std_mm": np.full(4, 0.1)}, ShapeError, "`std_mm`"),
        ({"std_mm": np.zeros(5)}, MarkerError, "`std_mm` must be positive and finite, in mm; marker 0 has 0.0"),
        ({"reference_mm": PLACES * np.nan}, MarkerError, "`reference_mm` must be finite"),
        ({"material": 10.0}, ArgumentError, "`material`"),
        ({"load": 1.0}, ArgumentError, "`load`"),
        ({"model": 1.0}, ArgumentError, "`model` must know the mesh's 120 nodes"),
        ({"fields": np.zeros((2, 3, 3))}, ShapeError, "`fields`"),
        ({"fields": np.full((2, 120, 3), np.nan)}, ShapeError, "field 0 is not"),
        ({"driven": [1.5]}, ShapeError, "`driven`"),
        ({"driven": [3, 120]}, ShapeError, "`driven` must name nodes from 0 to 119, got 3 to 120"),
        ({"frame_s": 0.0}, ArgumentError, "`frame_s`"),
        ({"seed": -1}, ArgumentError, "`seed`"),
        ({"threads": 1.5}, ArgumentError, "`threads`"),
    ],
)
def test_a_wrong_part_of_a_setting_is_refused(block_mesh, parts, error, says):
    with pytest.raises(error, match=says):
        setting(**{"mesh": block_mesh, **parts})
