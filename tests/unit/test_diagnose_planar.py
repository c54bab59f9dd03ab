"""A thin slab in one load case, seen by one camera: depth is never measured, forces along the pull alone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.meshes import block
from tissuereg.body.material import Material
from tissuereg.diagnosis.answer import BodyDiagnosis
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import FitTarget, FittedCause, fit
from tissuereg.diagnosis.noise import Noise, estimate_noise
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Stiffening
from tissuereg.experiment.experiment import Actuator, Boundary, Case, Experiment

LENGTH, WIDTH, DEPTH = 40.0, 16.0, 1.5


def strip(pull=4.0, n_frames=6) -> Experiment:
    """A strip held at one end and pulled at the other; nothing measured moves."""
    mesh = block((LENGTH, WIDTH, DEPTH), (10, 4, 1))
    held, pulled = (np.flatnonzero(mesh.nodes[:, 0] == x) for x in (0.0, LENGTH))
    mesh = mesh.with_node_set("fixed", held).with_node_set("end", held).with_node_set("pad", pulled)
    reference = np.array([[x, y, DEPTH] for x in (8.0, 16.0, 24.0, 32.0) for y in (4.0, 8.0, 12.0)])
    share = np.arange(n_frames) / (n_frames - 1.0)
    markers = np.tile(reference, (n_frames, 1, 1))
    markers[..., 2] = np.nan
    motion = share[:, None] * np.array([pull, 0.0, 0.0])
    force = np.column_stack([np.zeros(n_frames), np.full((n_frames, 2), np.nan)])
    case = Case("pull", share, markers, {"pad": motion}, forces={"pad": force})
    return Experiment(
        "strip", Path(), Path("mesh.vtu"), mesh, Material(young=20.0, poisson=0.4), 20.0, None, None,
        (Boundary("end", held),), (Actuator("pad", pulled, "displacement"),),
        tuple(f"P{i}" for i in range(len(reference))), reference, 0.02, {}, {"pull": case}, force_std=2.0,
    )  # fmt: skip


def measured_as(experiment, *effects) -> Experiment:
    """Return the experiment with predictions of a model with effects in place of its measured numbers."""
    layout = SignalLayout(experiment)
    part, predicted = layout.parts[0], Bench(experiment, layout).predictor.predict(effects)
    case = experiment.cases["pull"]
    markers = np.where(np.isfinite(case.markers), experiment.marker_reference + part.markers(predicted), np.nan)
    force = np.where(np.isfinite(case.forces["pad"]), part.forces(predicted)[:, 0], np.nan)
    return replace(experiment, cases={"pull": replace(case, markers=markers, forces={"pad": force})})


@pytest.mark.parametrize("common", [0.0, 0.05])
def test_whitened_noise_of_one_camera_is_white_in_its_plane_and_nothing_in_depth(common):
    experiment = strip()
    layout = SignalLayout(experiment)
    noise = Noise(np.full(12, 0.02), common, 0.5, 0.5, 0.2, 2.0, True)
    rng = np.random.default_rng(1)
    part, draws = layout.parts[0], 3000

    def faded(shape):
        values = rng.standard_normal(shape)
        for frame in range(1, shape[1]):
            values[:, frame] = 0.5 * values[:, frame - 1] + np.sqrt(0.75) * values[:, frame]
        return values

    flat = np.zeros((draws, layout.size))
    frames = part.n_frames
    part.markers(flat)[:] = 0.02 * faded((draws, frames, 12, 3)) + common * faded((draws, frames, 1, 3))
    part.markers(flat)[..., 2] = 1e3
    part.forces(flat)[:] = 2.0 * rng.standard_normal((draws, frames, 1, 3))
    white = noise.whitened(flat, layout)
    assert not white[:, ~layout.seen].any()
    seen = white[:, layout.seen]
    assert seen.shape[1] == frames * (12 * 2 + 1)
    assert np.abs(seen.T @ seen / draws - np.eye(seen.shape[1])).max() < 0.13


def test_rest_frames_of_one_camera_show_its_noise():
    experiment = strip()
    rng = np.random.default_rng(2)
    shape = (60, 12, 3)
    places = experiment.marker_reference + 0.2 * rng.standard_normal(shape) + 0.3 * rng.standard_normal((60, 1, 3))
    places[..., 2] = np.nan
    rest = Case("rest", np.arange(60.0) - 100.0, places)
    experiment = replace(experiment, cases={"rest": rest, **experiment.cases}, rest_case="rest")
    noise = estimate_noise(experiment, SignalLayout(experiment))
    assert noise.marker_std == pytest.approx(np.full(12, 0.2), rel=0.1)
    assert noise.common_std == pytest.approx(0.3, rel=0.25)


def test_markers_exchanged_in_a_plane_are_the_first_pair_that_is_tried():
    experiment = measured_as(strip())
    case = experiment.cases["pull"]
    markers = case.markers.copy()
    markers[:, [2, 7]] = markers[:, [7, 2]]
    experiment = replace(experiment, cases={"pull": replace(case, markers=markers)})
    bench = Bench(experiment, SignalLayout(experiment))
    first = next(iter(CAUSES["marker_swap"].variants(bench)))
    assert set(first.settings["pair"]) == {"P2", "P7"}


def test_a_body_thinner_than_any_ball_has_places_for_inclusions_in_the_middle_of_its_depth():
    experiment = strip()
    bench = Bench(experiment, SignalLayout(experiment))
    variants = list(CAUSES["inclusion"].variants(bench))
    assert len(variants) > 20
    assert {variant.settings["centre"][2] for variant in variants} == {0.5 * DEPTH}
    assert all(variant.columns.any() for variant in variants)
    free_parameters = CAUSES["inclusion"].free_parameters(bench, variants[0], np.ones(1))
    assert free_parameters.deviation[2] <= 0.5 * DEPTH
    assert free_parameters.step[2] <= 0.1 * DEPTH


def test_stiffening_far_beyond_the_bank_is_fitted():
    experiment = measured_as(strip(), Stiffening(law="fung", b=90.0, volumetric="coupled"))
    layout = SignalLayout(experiment)
    bench = Bench(experiment, layout)
    same = Correction(layout)
    target = FitTarget(bench, estimate_noise(experiment, layout), same, Null(np.zeros((0, layout.size))))
    cause = CAUSES["stiffening"]
    variant = max(
        (v for v in cause.variants(bench) if v.settings["law"] == "fung"), key=lambda v: float(v.settings["size"])
    )
    part = FittedCause("stiffening", cause.free_parameters(bench, variant, np.ones(1)))
    found = fit(target, [part])
    assert found is not None
    assert found.values(0, bench.young)[0]["b"] == pytest.approx(90.0, rel=0.03)
    assert found.young(bench.young) == pytest.approx(20.0, rel=0.03)
    assert np.abs(found.residual).max() < 0.3


def test_a_verdict_on_fewer_than_three_load_cases_is_provisional():
    one = strip()
    case = one.cases["pull"]
    three = replace(one, cases={name: replace(case, name=name) for name in ("a", "b", "c")})
    answers = [_answer(rig) for rig in (one, three)]
    assert [answer.to_json()["provisional"] for answer in answers] == [True, False]


def _answer(rig):
    return BodyDiagnosis(
        verdict="consistent",
        findings=(),
        candidates=(),
        p_misfit=0.5,
        discrepancy={},
        extended=rig,
        next_experiment=None,
        seed=0,
        versions={},
    )
