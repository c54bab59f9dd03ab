"""Flat vectors, noise and sensitivities of measured numbers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from support.rigs import rig
from tissuereg.body.material import GRAVITY_MM_PER_S2
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.causes.base import Variant
from tissuereg.diagnosis.causes.tracker import changed_by
from tissuereg.diagnosis.correction import Correction, make_correction
from tissuereg.diagnosis.noise import Noise, estimate_noise
from tissuereg.diagnosis.nuisances import make_nuisances
from tissuereg.diagnosis.predictor import fingerprint
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout, load_history
from tissuereg.errors import ExperimentError, NoiseError
from tissuereg.experiment.effects import ActuatorDirection, ActuatorGain, ActuatorOffset, Gravity, Latency, Poisson
from tissuereg.experiment.effects.regions import Ellipsoid, share_inside
from tissuereg.experiment.experiment import BodyWeight
from tissuereg.simulation.sensitivity import Parameter


@pytest.fixture(scope="module")
def bench() -> Bench:
    experiment = rig()
    return Bench(experiment, SignalLayout(experiment))


def central(bench, effect, step):
    ahead, back = (bench.predictor.predict([effect(side * step)]) for side in (1.0, -1.0))
    return (ahead - back) / (2.0 * step)


def assert_alike(found, expected, rel=2e-3):
    assert np.abs(expected).max() > 0.0
    assert np.abs(found - expected).max() < rel * np.abs(expected).max()


def test_what_goes_in_comes_out_of_the_flat_vector():
    experiment = rig()
    layout = SignalLayout(experiment)
    case = experiment.cases["in"]
    assert np.allclose(layout["in"].markers(layout.measured), case.markers - experiment.marker_reference)
    assert np.array_equal(layout["in"].forces(layout.measured)[:, 0], case.forces["side"])
    assert layout.of_markers().sum() == 3 * 6 * (8 + 5 + 5)
    assert layout.size == 3 * 6 * 18 + 2 * 3 * 5
    assert np.array_equal(layout["in"].forces(layout.times())[:, 0, 0], case.times)


def test_the_file_of_forces_may_name_actuators_in_any_order():
    # Banks are cached by model and loads, so that measured numbers must have the same order every time.
    experiment = rig()
    case = experiment.cases["in"]
    both = {"side": case.forces["side"], "top": 2.0 * case.forces["side"]}
    moved = {**case.displacements, "top": np.zeros((len(case.times), 3))}
    pair = [
        replace(
            experiment, cases={"in": replace(case, displacements=moved, forces={name: both[name] for name in order})}
        )
        for order in (("side", "top"), ("top", "side"))
    ]
    assert fingerprint(pair[0], "tet4") == fingerprint(pair[1], "tet4")
    assert [SignalLayout(one)["in"].pads for one in pair] == [("top", "side"), ("top", "side")]
    assert np.array_equal(*(SignalLayout(one).measured for one in pair))


def test_a_prediction_depends_on_the_nodes_that_the_mesh_holds():
    experiment = rig()
    mesh = experiment.mesh
    fewer = mesh.with_node_set("fixed", mesh.fixed_nodes[1:])
    assert fingerprint(replace(experiment, mesh=fewer), "tet4") != fingerprint(experiment, "tet4")


def test_an_experiment_without_measurements_is_refused():
    experiment = rig()
    blind = {n: replace(c, markers=np.full_like(c.markers, np.nan), forces={}) for n, c in experiment.cases.items()}
    with pytest.raises(ExperimentError, match="must have measured"):
        SignalLayout(replace(experiment, cases=blind))


def test_forces_without_a_stated_noise_are_refused():
    experiment = replace(rig(), force_std=None)
    with pytest.raises(NoiseError, match="std_mN"):
        estimate_noise(experiment, SignalLayout(experiment))


@pytest.mark.parametrize(("common", "memory"), [(0.0, 0.0), (0.08, 0.0), (0.0, 0.6), (0.05, 0.5)])
def test_whitened_noise_is_white(common, memory):
    experiment = rig()
    layout = SignalLayout(experiment)
    noise = Noise(np.linspace(0.03, 0.06, 6), common, memory, memory, 1.0, 2.0, True)
    rng = np.random.default_rng(1)
    draws = 4000
    flat = np.zeros((draws, layout.size))

    def faded(shape):
        values = rng.standard_normal(shape)
        for frame in range(1, shape[1]):
            values[:, frame] = memory * values[:, frame - 1] + np.sqrt(1.0 - memory**2) * values[:, frame]
        return values

    for part in layout.parts:
        own = noise.marker_std[:, None] * faded((draws, part.n_frames, 6, 3))
        part.markers(flat)[:] = own + common * faded((draws, part.n_frames, 1, 3))
        part.forces(flat)[:] = 2.0 * rng.standard_normal((draws, part.n_frames, len(part.pads), 3))
    white = noise.whitened(flat, layout)[:, layout.size // 2 :]
    covariance = white.T @ white / draws
    assert np.abs(covariance - np.eye(len(covariance))).max() < 0.12


def test_rest_frames_show_noise_that_is_not_as_stated():
    experiment = rig()
    rng = np.random.default_rng(2)
    cases = {}
    for name, case in experiment.cases.items():
        times = np.arange(60.0) - 60.0 if name == "rest" else case.times
        own, common = rng.standard_normal((len(times), 6, 3)), rng.standard_normal((len(times), 1, 3))
        cases[name] = replace(case, times=times, markers=experiment.marker_reference + 0.2 * own + 0.3 * common)
    changed = replace(experiment, cases=cases)
    noise = estimate_noise(changed, SignalLayout(changed))
    assert noise.marker_std == pytest.approx(np.full(6, 0.2), rel=0.1)
    assert noise.common_std == pytest.approx(0.3, rel=0.25)
    plain = estimate_noise(experiment, SignalLayout(experiment))
    assert np.array_equal(plain.marker_std, np.full(6, 0.05))
    assert plain.common_std == plain.memory == 0.0


def test_derivatives_are_those_of_the_simulation(bench):
    by_ratio = bench.by(lambda state: [Parameter("poisson")], 1)[0]
    assert_alike(by_ratio, central(bench, lambda h: Poisson(poisson=0.4 + h), 1e-3))
    weighed = rig(gravity=BodyWeight(np.array([0.0, 0.0, -1.0]), in_reference=False))
    for one in (bench, Bench(weighed, SignalLayout(weighed))):  # pads move with a body that sags
        central_of = (one.predictor.predict(young=1.01) - one.predictor.predict(young=0.99)) / 0.02
        assert_alike(one.by_young[0], central_of)
    assert not one.scales_forces


def test_actuators_change_what_their_columns_say(bench):
    gain = next(v for v in CAUSES["actuator_gain"].variants(bench) if v.label == "side")
    assert_alike(gain.columns[0], 0.08 * central(bench, lambda h: ActuatorGain(actuator="side", gain=1.0 + h), 1e-3))
    turn = next(v for v in CAUSES["actuator_direction"].variants(bench) if v.label == "top")
    axis = turn.settings["across"][0]
    expected = 3.0 * central(bench, lambda h: ActuatorDirection(actuator="top", rotation_deg=tuple(h * axis)), 1e-2)
    assert_alike(turn.columns[0], expected)
    offset = next(v for v in CAUSES["actuator_offset"].variants(bench) if v.label == "top motion")
    expected = 0.7 * central(bench, lambda h: ActuatorOffset(actuator="top", offset_mm=(h, 0.0, 0.0)), 1e-3)
    assert_alike(offset.columns[0], expected)


def test_weight_acts_on_the_body_before_its_pads_are_bonded(bench):
    column = next(iter(CAUSES["gravity"].variants(bench))).columns[2]

    def weight(h):
        return Gravity(direction=(0.0, 0.0, 1.0 if h > 0 else -1.0), g_mm_per_s2=abs(h) * GRAVITY_MM_PER_S2)

    assert_alike(column, 0.6 * central(bench, weight, 1e-2))


def test_an_inclusion_is_a_sum_of_adjoints(bench):
    ball, mesh = Ellipsoid((14.0, 9.0, 26.0), (8.0, 8.0, 8.0)), bench.experiment.mesh
    share = share_inside(ball, mesh)
    found = bench.by_fields(sparse.csr_array(share[:, None]))[0]
    material, h = bench.experiment.material, 1e-3
    ends = []
    for side in (1.0, -1.0):
        harder = replace(bench.experiment, material=material.scaled(1.0 + side * h * share))
        ends.append(Bench(harder, bench.layout).base)
    assert_alike(found, (ends[0] - ends[1]) / (2.0 * h))


def test_the_tracker_changes_places_and_nothing_else(bench):
    changed = changed_by(bench, Latency(latency_s=0.25))
    expected = bench.predictor.predict([Latency(latency_s=0.25)]) - bench.base
    assert np.allclose(changed, expected, atol=1e-9)


def test_a_correction_makes_the_coarse_prediction_the_fine_one(bench):
    rng = np.random.default_rng(5)
    fine = bench.base * (1.0 + 0.1 * rng.random(bench.layout.size)) + 0.01
    correction = make_correction(bench.layout, bench.base, fine)
    assert np.allclose(correction.corrected(bench.base), fine)
    forces = ~bench.layout.of_markers()
    doubled = np.where(forces, 2.0 * bench.base, bench.base)
    assert np.allclose(correction.corrected(doubled, 2.0), np.where(forces, 2.0 * fine, fine))
    # Forces that are larger for another reason than the modulus have an error as much larger.
    loaded = forces & (bench.base != 0.0)
    assert loaded.any()
    assert np.allclose(correction.corrected(doubled)[loaded], 2.0 * fine[loaded])


def test_a_correction_with_an_effect_is_right_with_and_without_it(bench):
    rng = np.random.default_rng(6)
    fine = bench.base * (1.0 + 0.1 * rng.random(bench.layout.size))
    plain = make_correction(bench.layout, bench.base, fine)
    coarse = bench.predictor.predict([Poisson(poisson=0.3)])
    fine_with = fine + (coarse - bench.base) * (1.0 + 0.3 * rng.random(bench.layout.size))
    std = np.where(bench.layout.of_markers(), 0.05, 2.0)
    both = plain.with_effect(bench.base, coarse, fine_with, std)
    assert np.allclose(both.corrected(bench.base), fine)
    assert np.allclose(both.corrected(coarse), fine_with)
    # Half of an effect has half of its discretisation error, at any modulus.
    half = 0.5 * (bench.base + coarse)
    assert np.allclose(both.corrected(half), 0.5 * (fine + fine_with))
    forces = ~bench.layout.of_markers()
    doubled = np.where(forces, 2.0 * coarse, coarse)
    assert np.allclose(both.corrected(doubled, 2.0), np.where(forces, 2.0 * fine_with, fine_with))
    assert plain.with_effect(bench.base, bench.base, fine, std) is plain
    again = both.with_effect(bench.base, coarse, fine_with, std)
    assert np.allclose(again.corrected(half), both.corrected(half))


def test_forces_have_the_mean_mesh_error_in_all_components(bench):
    errors = np.zeros((2, bench.layout.size))
    pads = [(part, part.forces(bench.base)[:, 0]) for part in bench.layout.parts if part.pads]
    for part, force in pads:
        part.forces(errors)[:, :, 0, 0] = 0.03 * np.linalg.norm(force, axis=1)
    made = make_nuisances(bench, errors, Correction(bench.layout))
    for part, force in pads:
        strength = np.linalg.norm(force, axis=1)
        top = load_history(part, bench.base) > 0.5
        size = DEFAULT.nuisances.force_share * np.sqrt(((0.03 * strength[top] / strength.max()) ** 2).mean() / 3.0)
        for axis in range(3):
            grows, bends = (
                part.forces(made.columns[made.names.index(f"{word} {part.name} {part.pads[0]} {axis}")])[:, 0, axis]
                for word in ("mesh", "bent")
            )
            assert np.allclose(grows, size * strength)
            # The rest grows with the square of the force.
            assert np.allclose(bends, DEFAULT.nuisances.force_bent * strength**2 / strength.max())


def test_all_forces_may_bend_alike_along_themselves(bench):
    made = make_nuisances(bench, np.zeros((2, bench.layout.size)), Correction(bench.layout))
    (column,) = made.columns[[name == "bent alike" for name in made.names]]
    assert not column[bench.layout.of_markers()].any()
    some = 0
    for part in bench.layout.parts:
        for pad in range(len(part.pads)):
            force = part.forces(bench.base)[:, pad]
            strength = np.linalg.norm(force, axis=1)
            expected = DEFAULT.nuisances.force_bent_alike * (strength / strength.max())[:, None] * force
            assert np.allclose(part.forces(column)[:, pad], expected)
            some += int(strength.max() > 0.0)
    assert some >= 2


def test_an_inclusion_has_the_contrast_of_its_parameters(bench):
    variant = Variant("", np.zeros((1, bench.layout.size)), {"centre": (14.0, 9.0, 26.0), "radius": 8.0})
    stiff, soft = (CAUSES["inclusion"].free_parameters(bench, variant, np.array([a])) for a in (0.4, -0.4))
    for free_parameters, expected in ((stiff, 1.0 + 0.6 / 0.76), (soft, 1.0 - 0.6 / 1.24)):
        (effect,) = free_parameters.effects(free_parameters.start, 10.0)
        assert effect.contrast == pytest.approx(expected)
        assert free_parameters.values(free_parameters.start, 10.0)["contrast"] == effect.contrast
        assert effect.centre_mm == (14.0, 9.0, 26.0)
    far = np.array([14.0, 9.0, 26.0, np.log(8.0), 9.0])
    assert 0.0 < soft.values(far, 10.0)["contrast"] < 0.01


def test_every_cause_that_fits_has_columns_of_its_own(bench):
    for name in ("stiffness", "poisson", "layer", "sliding", "frame", "scale", "latency"):
        variants = list(CAUSES[name].variants(bench))
        assert variants, name
        for variant in variants:
            assert variant.columns.shape[1] == bench.layout.size
            assert np.isfinite(variant.columns).all()
            free_parameters = CAUSES[name].free_parameters(bench, variant, np.full(len(variant.columns), 0.5))
            assert free_parameters.effects(free_parameters.start, bench.young)
            assert CAUSES[name].sentence(free_parameters.values(free_parameters.start, bench.young)).endswith(".")
    assert not list(CAUSES["reference"].variants(bench))  # no gravity is believed
