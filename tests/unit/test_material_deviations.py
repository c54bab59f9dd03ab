"""Stated deviations: as wide as numbers scatter where a form is right, and where it is wrong."""

from functools import partial

import numpy as np
import pytest

import support.material_curves as made
from support.material_curves import believed, histories, in_modes, with_lasting_errors, with_smooth_misfit
from support.material_fits import both
from tissuereg.diagnosis.material import diagnose_material

#: Deviations wrong by a factor of 2 leave these limits of the root mean square of errors over deviations.
LEAST, MOST = 0.6, 1.5
FUNG = ("fung", 1.0)
TRUTH = {"young_kpa": 10.0, "b": 1.0}


def spread(curves_of, n, weighting, truth=TRUTH, cause="stiffening", label="fung"):
    """Return errors over the deviations stated, over those of a right form, and the form's errors found."""
    stated, plain, sizes = [], [], []
    for seed in range(n):
        answer, right, size = both(believed(curves_of(np.random.default_rng(seed))), cause, label, weighting)
        stated.append([(answer[key][0] - value) / answer[key][1] for key, value in truth.items()])
        plain.append([(right[key][0] - value) / right[key][1] for key, value in truth.items()])
        sizes.append(size)
    return np.array(stated), np.array(plain), np.array(sizes)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("weighting", ["lasting errors", "rows alike"])
def test_deviations_of_a_right_form_are_those_of_the_noise(weighting):
    z, _, sizes = spread(lambda rng: with_lasting_errors(in_modes(rng, FUNG), rng), 40, weighting)
    assert LEAST < rms(z) < MOST
    assert np.mean(np.abs(z) < 2) > 0.88
    # Noise that is as expected is no error of the form.
    assert np.median(sizes) < 0.02


def test_rows_that_count_alike_do_not_make_errors_that_last_along_a_curve_white():
    z, plain, _ = spread(lambda rng: with_lasting_errors(in_modes(rng, FUNG), rng), 20, "rows alike")
    assert rms(plain) > 2 * MOST
    assert rms(z) < MOST


@pytest.mark.parametrize("size", [0.05, 0.1])
def test_deviations_carry_a_misfit_that_the_form_cannot_follow(size):
    for weighting in ("lasting errors", "rows alike"):
        z, plain, sizes = spread(partial(_misfitting, size), 40, weighting)
        assert LEAST < rms(z) < MOST
        assert np.mean(np.abs(z) < 2) > 0.85
        assert np.median(sizes) == pytest.approx(size, rel=0.4)
        # Curvature alone states too little: rows that count alike make it that of white noise.
        assert rms(plain) > (4.0 if weighting == "rows alike" else 1.0) * rms(z)


def _misfitting(size, rng):
    return with_smooth_misfit(with_lasting_errors(in_modes(rng, FUNG), rng), rng, size)


def test_deviations_of_right_relaxation_times_are_those_of_the_noise():
    truth = {"g_1": 0.25, "g_2": 0.2, "tau_s_1": 1.5, "tau_s_2": 20.0}
    kernel = made.prony((0.25, 1.5), (0.2, 20.0))

    def curves_of(rng):
        relaxing = histories(rng, lambda m, t, e: made.relaxed(("plain",), m, t, e, kernel))
        return with_lasting_errors(relaxing, rng)

    z, _, _ = spread(curves_of, 12, "lasting errors", truth, "relaxation", "prony-2")
    assert LEAST < rms(z) < MOST


def test_numbers_of_one_rate_lie_within_the_deviations_of_others_where_relaxation_follows_a_power_of_time():
    worst, plain = [], []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        kernel = lambda t: (1.0 + t / 0.3) ** -0.12  # noqa: E731
        curves = histories(
            rng, lambda m, t, e, k=kernel: made.relaxed(("plain",), m, t, e, k), rates=(0.003, 0.03, 0.3)
        )
        parts = [[c for c in curves if c.rate == rate] for rate in (0.003, 0.03, 0.3)]
        answers = [both(believed(part), "relaxation", "prony-3") for part in parts]
        for one, other in ((0, 1), (0, 2), (1, 2)):
            worst += _apart(answers[one][0], answers[other][0])
            plain += _apart(answers[one][1], answers[other][1])
    assert np.mean(np.array(worst) < 2.0) > 0.93
    assert rms(np.array(worst)) > 0.4


def _apart(one, other):
    return [abs(one[key][0] - other[key][0]) / np.hypot(one[key][1], other[key][1]) for key in one]


def test_the_answer_and_the_extended_model_state_these_deviations():
    curves = with_lasting_errors(in_modes(np.random.default_rng(1), FUNG), np.random.default_rng(2))
    diagnosis = diagnose_material(believed(curves))
    refined = diagnosis.outcome.refined
    (cause,) = diagnosis.to_json()["causes"]
    (part,) = refined.fit.parts
    stated, _, size = both(believed(curves), cause["id"], part.free_parameters.label, refined.weighting)
    assert refined.form_error == pytest.approx(size, rel=0.05)
    for key, (value, deviation) in cause["parameters"].items():
        assert value == pytest.approx(stated[key][0], rel=0.02)
        assert deviation == pytest.approx(stated[key][1], rel=0.05)
    assert diagnosis.extended.young_std == pytest.approx(stated["young_kpa"][1], rel=0.05)
