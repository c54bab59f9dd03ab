"""Methods that are given variants of a simulation, and variants of rigs."""

import numpy as np
import pytest

import tissuereg as tr
from support.varied import STD, calibrated, drawn, measured, places
from tissuereg.errors import ArgumentError, FormatError
from tissuereg.io.fields import write_npz
from tissuereg_paper.rivals import EnsembleOfSimulations, Setting, VariedNetwork
from tissuereg_paper.studies.rigs import Pad, Rig
from tissuereg_paper.studies.variants import N_MODULI, STORED_KPA, YOUNG_KPA, RigVariants, read_variants


@pytest.fixture(scope="module")
def mesh():
    return tr.phantom.phantom_mesh("small")


@pytest.fixture(scope="module")
def variants(mesh):
    return drawn(mesh)


# --- methods of the comparison ---


def setting_of(mesh, markers, model=None):
    return Setting(
        mesh, np.asarray(markers.reference), np.full(12, STD), tr.Material(10.0, 0.45), model=model, threads=1
    )


def test_an_ensemble_of_simulations_is_updated_by_bayes_rule(mesh, variants):
    _, markers = measured(mesh, variants)
    found = EnsembleOfSimulations(setting_of(mesh, markers), error_mm=0.12).register(
        markers.measured, variants_mm=variants
    )
    seen, _ = places(mesh)
    mean = variants.mean(axis=0)
    fields = (variants - mean).reshape(len(variants), -1) / 3.0
    at_markers = fields.reshape(len(variants), -1, 3)[:, seen].reshape(len(variants), -1)
    total = at_markers.T @ at_markers + (STD**2 + 0.12**2) * np.eye(36)
    gain = fields.T @ np.linalg.solve(total, at_markers.T).T
    moved = mean + (gain @ (markers.displacement - mean[seen]).ravel()).reshape(mean.shape)
    variance = (fields**2).sum(axis=0) - (gain * (fields.T @ at_markers)).sum(axis=1)
    np.testing.assert_allclose(found.displacement_mm, moved, atol=1e-9)
    np.testing.assert_allclose(found.spread_mm.ravel() ** 2, variance, rtol=1e-7, atol=1e-9)


def test_the_network_with_variants_is_that_of_a_registrar(mesh, variants):
    _, markers = measured(mesh, variants)
    model = calibrated(mesh, 0.3)
    expected = tr.Registrar(mesh, markers, model, settings=tr.RegisterSettings(threads=1)).register(
        markers, tr.SimulationVariants(variants)
    )
    found = VariedNetwork(setting_of(mesh, markers, model)).register(markers.measured, variants_mm=variants)
    np.testing.assert_array_equal(found.displacement_mm, expected.displacement)
    with pytest.raises(ArgumentError, match="`variants_mm` must be given for the method 'tissuereg, network with"):
        VariedNetwork(setting_of(mesh, markers, model)).register(markers.measured, 0.0 * variants[0])


# --- variants of rigs ---


def rig_named(name):
    pad = Pad(np.array([50.0, 0.0, 20.0]), np.array([-10.0, 0.0, 0.0]), 14.0)
    none = {"marker": (2, 0, 3), "sensor": (2, 3), "inner": (2, 0, 3)}
    return Rig(
        name=name,
        scenario=1,
        seed=0,
        pads=(pad,),
        frame_s=0.025,
        motion=np.array([0.5, 1.0]),
        reference_mm=np.zeros((0, 3)),
        sensor_mm=np.zeros(3),
        inner_mm=np.zeros((0, 3)),
        shares=np.array([0.5, 1.0]),
        pad_forces=np.zeros((2, 1, 3)),
        truth={},
        **{f"{part}_levels_mm": np.zeros(shape) for part, shape in none.items()},
    )


def test_a_variant_is_taken_with_moduli_from_the_softest_to_the_stiffest():
    # Bodies that move in proportion to their push: by 1 mm and by 2 mm per 100 mN.
    pushes = np.array([[100.0, 200.0, 300.0, 400.0], [100.0, 200.0, 300.0, 400.0]])
    slopes = np.array([0.01, 0.02])
    fields = (slopes[:, None] * pushes)[:, :, None, None] * np.ones((1, 1, 2, 3))
    softer = RigVariants(fields, pushes, (5.0, 10.0)).at(50.0)
    assert softer.shape == (2 * N_MODULI, 2, 3)
    assert softer.max() < 0.02 * 50.0 * STORED_KPA / 5.0
    assert softer.min() > 0.01 * 50.0 * STORED_KPA / 10.0
    found = RigVariants(fields, pushes).at(100.0)
    assert found.shape == (2 * N_MODULI, 2, 3)
    for slope, of_body in zip(slopes, np.split(found[:, 0, 0], 2), strict=True):
        moduli = STORED_KPA * slope * 100.0 / of_body
        assert (moduli > YOUNG_KPA[0]).all()
        assert (moduli < YOUNG_KPA[1]).all()
        # One in each of five equal parts of the logarithm.
        parts = np.floor(N_MODULI * np.log(moduli / YOUNG_KPA[0]) / np.log(YOUNG_KPA[1] / YOUNG_KPA[0]))
        assert parts.tolist() == [0, 1, 2, 3, 4]


def test_variants_that_would_be_pressed_too_far_are_left_out():
    pushes = np.array([[100.0, 200.0, np.nan], [100.0, np.nan, np.nan]])
    fields = 0.01 * pushes[:, :, None, None] * np.ones((1, 1, 2, 3))
    found = RigVariants(fields, pushes).at(150.0)[:, 0, 0]
    # Of the first body moduli below 10 * 150 / (1.1 * 200) are missing, of the second, with one equilibrium, all.
    assert 0 < len(found) < N_MODULI
    assert found.max() <= 1.1 * 2.0 + 1e-12
    assert np.isfinite(found).all()


def test_variants_are_read_by_the_name_of_their_rig(tmp_path):
    write_npz(
        tmp_path / "scenario1-00.npz", {"push_mN": np.ones((2, 3)), "field_mm": np.ones((2, 3, 7, 3), np.float16)}
    )
    assert read_variants(tmp_path, rig_named("scenario1-00"), 7).fields_mm.shape == (2, 3, 7, 3)
    with pytest.raises(FormatError, match=r"scenario1-01\.npz"):
        read_variants(tmp_path, rig_named("scenario1-01"), 7)
    with pytest.raises(FormatError, match="field_mm"):
        read_variants(tmp_path, rig_named("scenario1-00"), 8)
