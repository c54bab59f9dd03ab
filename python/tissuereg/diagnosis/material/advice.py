"""Which further test would distinguish two causes that the measured curves cannot."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.answer import to_check
from tissuereg.diagnosis.material.bench import CurveBench
from tissuereg.diagnosis.material.data import data_of
from tissuereg.diagnosis.material.fit import Hypothesis
from tissuereg.diagnosis.material.model import stress_of
from tissuereg.diagnosis.material.noise import CurveNoise, covariance
from tissuereg.diagnosis.material.search import MaterialFinding
from tissuereg.diagnosis.settings import MaterialSettings
from tissuereg.errors import ExperimentError
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


def repeated(experiment: MaterialExperiment, worst: dict[str, Any]) -> dict[str, Any]:
    """Return, for the answer, the advice to repeat the mode and the part of a curve with the largest residual."""
    mode, where, when = worst["under"], worst["where"], worst["when"]
    several = len({curve.specimen for curve in experiment.curves if curve.mode == mode}) > 1
    action = (
        f"measure {mode.replace('-', ' ')} again with {'a further' if several else 'another'} specimen, with more "
        f"rows {when}: the residual is largest there, worst in {' and '.join(where)}; a deviation that does not repeat "
        "is no property of the material"
    )
    return to_check(action, "mode", mode, where=where, when=when)


def next_test(
    bench: CurveBench, experiment: MaterialExperiment, known: Hypothesis, findings: Sequence[MaterialFinding]
) -> dict[str, Any] | None:
    """Return, for the answer, the usual test that separates best the causes of a group, if there is a group."""
    settings = bench.settings.material
    for finding in findings:
        for rival, other in finding.rivals.items():
            tests = {}
            for action, curve in _stock(experiment, settings.advised_rows):
                first, second = (stress_of(fit.model, curve) for fit in (known.fit, other.fit))
                if np.isfinite(first).all() and np.isfinite(second).all():
                    tests[action] = _separability(experiment, curve, first, second, settings)
            if tests:
                best = max(tests, key=lambda action: tests[action])
                return {"action": best, "separates": [[finding.id, rival]], "separability": tests[best]}
    return None


def _separability(
    experiment: MaterialExperiment, curve: Curve, first: FloatArray, second: FloatArray, settings: MaterialSettings
) -> float:
    """Return by how many noise deviations of one more specimen stresses (n,) differ; 0 where `first` are no curve."""
    try:
        measured = replace(curve, stress=first)
    except ExperimentError:
        return 0.0
    data = data_of(replace(experiment, curves=(measured,)), settings.most_rows)
    noise = CurveNoise(np.array([0.005 * float(np.abs(first).max())]), settings.usual_factor, settings.usual_along, 0)
    own = covariance(data, noise, settings) + settings.usual_factor**2 * np.outer(data.stress, data.stress)
    difference = (first - second)[data.rows[0]]
    return float(np.sqrt(difference @ np.linalg.solve(own, difference)))


def _stock(experiment: MaterialExperiment, n_rows: int) -> Iterator[tuple[str, Curve]]:
    """Yield usual tests, in words and as curves: other modes, a hold, another rate, unloading, larger strains."""
    curves, tested = experiment.curves, dict.fromkeys(curve.mode for curve in experiment.curves)
    sheared = max((float(np.abs(c.strains).max()) for c in curves if c.mode == "simple-shear"), default=0.0)
    bars = [float(np.abs(c.strains).max()) for c in curves if c.mode != "simple-shear"]
    bar = min(max(bars), 0.6) if bars else min(0.5 * sheared, 0.3)
    largest = {"tension": bar, "compression": -bar, "simple-shear": sheared or 1.5 * bar}
    rate = min((c.rate for c in curves if not np.isnan(c.rate)), default=0.01)

    def curve(mode: str, times: FloatArray, strains: FloatArray) -> Curve:
        # The stress is a placeholder of the right sign: the models use the path alone.
        return Curve("next", mode, rate, times, strains if mode == "simple-shear" else 1.0 + strains, strains)

    def ramp(mode: str, far: float, faster: float = 1.0) -> Curve:
        strains = np.linspace(0.0, far, n_rows)
        return curve(mode, np.abs(strains) / (faster * rate), strains)

    for mode in [mode for mode in largest if mode not in tested]:
        yield f"{mode.replace('-', ' ')} to a strain of {abs(largest[mode]):.2g}", ramp(mode, largest[mode])
    first = curves[0].mode
    named, far = first.replace("-", " "), largest[first]
    up = ramp(first, far)
    later = up.times[-1] * (1.0 + np.geomspace(0.05, 10.0, n_rows))
    times, strains = np.concatenate([up.times, later]), np.concatenate([up.stress, np.full(n_rows, far)])
    yield f"{named} with a hold of {10 * abs(far) / rate:.3g} s", curve(first, times, strains)
    yield f"{named} ten times as fast", ramp(first, far, 10.0)
    strains = np.concatenate([up.stress, up.stress[-2::-1], up.stress[1:]])
    times = np.cumsum(np.abs(np.diff(strains, prepend=0.0))) / rate
    yield f"{named}, unloaded and loaded again", curve(first, times, strains)
    for mode in tested:
        wide = min(1.5 * abs(largest[mode]), 0.7) if mode == "compression" else 1.5 * abs(largest[mode])
        yield f"{mode.replace('-', ' ')} to a strain of {wide:.2g}", ramp(mode, float(np.sign(largest[mode])) * wide)
