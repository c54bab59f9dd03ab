"""Static experiments: cases of one frame, no pads, no measured forces, no rest case, markers on what holds the body."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.body.material import GRAVITY_MM_PER_S2
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.nuisances import make_nuisances
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.effects import Effect, Gravity, MarkerSlip
from tissuereg.experiment.experiment import Actuator, Boundary, Case, Experiment
from tissuereg.experiment.experiment import BodyWeight as Weight
from tissuereg.simulation.experiment import simulate_plain

STD = 0.05
DOWN = (0.0, 0.0, -1.0)
NAMES = tuple(f"P{i}" for i in range(6))
PLACES = np.array([[40, 0, 15], [40, 10, 15], [40, 5, 0], [20, 0, 8], [20, 10, 8], [0, 0, 15]], np.float64)


def shelf(*effects: Effect, weight: Weight | None = None, trial_share: float = 0.0) -> Experiment:
    """A shelf that stands out from a wall: alone, alone once more, and loaded at its edge; measured with effects."""
    mesh = block((40.0, 10.0, 15.0), (6, 2, 2))
    wall, edge = (np.flatnonzero(mesh.nodes[:, 0] == x) for x in (0.0, 40.0))
    mesh = tr.Mesh(mesh.nodes, mesh.tets, {"wall": wall, "edge": edge, "fixed": wall})
    pull = {"load": np.array([[0.0, 0.0, -60.0]])}
    cases = {
        name: Case(name, np.array([10.0 * i]), np.empty((1, 6, 3)), applied_forces=given)
        for i, (name, given) in enumerate({"one": {}, "two": {}, "loaded": pull}.items())
    }
    believed = Experiment(
        "shelf", Path(), Path("mesh.vtu"), mesh, tr.Material(40.0, 0.4, density=1.0), 4.0, None, weight,
        (Boundary("wall", wall),), (Actuator("load", edge, "force"),), NAMES, PLACES, STD, {}, cases,
        trial_share=trial_share,
    )  # fmt: skip
    said = simulate_plain(replace(believed, effects=effects), element="tet10")
    rng = np.random.default_rng(3)
    measured = {
        name: replace(case, markers=said[name].markers + STD * rng.standard_normal((1, 6, 3)))
        for name, case in cases.items()
    }
    return replace(believed, cases=measured)


def diagnosed(experiment: Experiment):
    return tr.diagnose(experiment, element="tet10", threads=1, keep=False)


def test_a_weight_that_was_left_out_is_named_where_nothing_else_moves_the_body():
    found = diagnosed(shelf(Gravity(direction=DOWN)))
    assert [finding.id for finding in found.findings] == ["gravity"]
    (weight,) = found.findings
    pull = np.array(weight.parameters["direction"]) * weight.parameters["g_mm_per_s2"] / GRAVITY_MM_PER_S2
    # The one case with a load distinguishes weight and modulus, which is known to a tenth.
    assert pull == pytest.approx(DOWN, abs=0.2)
    assert weight.held_out["rms_named_mm"] < 2.0 * STD < 0.2 * weight.held_out["rms_base_mm"]


def test_a_slip_in_the_only_frame_of_the_last_case_is_named_given_the_weight():
    slip = MarkerSlip(marker="P5", offset_mm=(0.9, 0.0, 0.2), from_time_s=20.0)
    found = diagnosed(shelf(slip, weight=Weight(np.array(DOWN), in_reference=False)))
    assert [finding.group for finding in found.findings] == [("marker_slip",)]
    (finding,) = found.findings
    assert (finding.parameters["marker"], finding.parameters["from_time_s"]) == ("P5", 20.0)
    assert finding.held_out["cases"] == ["loaded"]
    assert finding.parameters["offset_mm"] == pytest.approx((0.9, 0.0, 0.2), abs=4 * STD)


def test_the_difference_between_trials_grows_with_the_motion_and_is_smooth():
    experiment = shelf(weight=Weight(np.array(DOWN), in_reference=False), trial_share=0.04)
    layout = SignalLayout(experiment)
    none = np.zeros((0, layout.size))
    nuisances = make_nuisances(Bench(experiment, layout, element="tet10", threads=1), none, Correction(layout))
    chosen = np.array([name.startswith("trial loaded 1") for name in nuisances.names])
    part = layout["loaded"]
    columns = part.markers(nuisances.columns[chosen])[:, 0, :, 1]
    covariance = columns.T @ columns
    moved = np.linalg.norm(part.markers(layout.measured)[0], axis=1)
    assert np.sqrt(np.diag(covariance)) == pytest.approx(0.04 * moved, rel=1e-6)
    correlation = covariance / np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    away = np.linalg.norm(PLACES[:, None] - PLACES, axis=2)
    assert correlation == pytest.approx(
        np.exp(-0.5 * (away / (DEFAULT.nuisances.pattern_length * experiment.mesh.extent)) ** 2), abs=1e-6
    )
    plain = replace(experiment, trial_share=0.0)
    without = make_nuisances(Bench(plain, layout, element="tet10", threads=1), none, Correction(layout))
    assert not any(name.startswith("trial") for name in without.names)


def test_frames_without_neighbours_have_no_step():
    experiment = shelf()
    assert Bench(experiment, SignalLayout(experiment)).frame_step == 0.0
