"""Rivals of the diagnoser on the same bench: the same bank of columns and noise, none of its model of mesh error.

Only one of them gets the correction by the fine mesh, and that without a model of the remaining mesh error.

All are linear. Modulus and frame are free within their priors (30 %, 0.02 mm, 0.02 degrees), so that either can still
be a finding. The effect of a cause is a least-squares fit of its bank columns, without a prior.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from blind.heldout import by_block
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.correction import Correction, make_correction
from tissuereg.diagnosis.evidence import Null, fit_amplitudes
from tissuereg.diagnosis.noise import Noise, estimate_noise
from tissuereg.diagnosis.nuisances import make_nuisances
from tissuereg.diagnosis.proof import LinearModel
from tissuereg.diagnosis.refined import entry_of, refined_predictions
from tissuereg.diagnosis.screen import make_bank
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout, generic_columns
from tissuereg.experiment.effects import EFFECTS
from tissuereg.io.experiments import read_experiment

#: Error ranking names the best cause where the error falls by this share.
FALL = 0.05

#: The chi-square test of the Gaussian process.
LEVEL = 0.01

#: Predictions of held-out data need a prior, lest undetermined amplitudes diverge: this factor times the bank's.
WIDE = 10.0

#: Directions of a hypothesis with less than this share of the largest squared singular value are dropped.
RANK = 1e-6


@dataclass(frozen=True, eq=False)
class Scene:
    """An experiment as regression sees it.

    Attributes
    ----------
    layout : SignalLayout
        Order of all vectors.
    bench : Bench
        The believed model.
    noise : Noise
        Of the measurement.
    correction : Correction
        Of the mesh's error.
    residual : ndarray of float64, shape (size,)
        Measured less believed, whitened.
    null : Null
        Modulus and frame.
    """

    layout: SignalLayout
    bench: Bench
    noise: Noise
    correction: Correction
    residual: np.ndarray
    null: Null

    @property
    def n(self) -> int:
        """Number of measured values."""
        return int(self.layout.seen.sum())

    def white(self, columns: np.ndarray) -> np.ndarray:
        """Return columns (..., size) corrected and whitened."""
        return self.noise.whitened(self.correction.of_columns(columns.astype(np.float64)), self.layout)


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """All hypotheses of one cause.

    Attributes
    ----------
    id : str
        The cause.
    white : ndarray of float64, shape (n, p, size)
        Whitened.
    left : ndarray of float64, shape (n, p, size)
        Projected off modulus and frame, and off what was chosen before.
    """

    id: str
    white: np.ndarray
    left: np.ndarray

    @property
    def n_columns(self) -> int:
        """Number of columns of each."""
        return self.white.shape[1]

    def cleared_of(self, modes: np.ndarray) -> "Hypotheses":
        """Return the same, projected off orthonormal directions (k, size)."""
        return Hypotheses(self.id, self.white, self.left - (self.left @ modes.T) @ modes)

    def best(self, residual: np.ndarray) -> tuple[int, float]:
        """Return the hypothesis that reduces the sum of squares of a residual (size,) most, and by how much."""
        along = self.left @ residual
        inner = np.linalg.pinv(self.left @ self.left.transpose(0, 2, 1), rcond=RANK, hermitian=True)
        taken = np.einsum("np,npq,nq->n", along, inner, along)
        top = int(np.argmax(taken))
        return top, float(taken[top])


def sparse_regression(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the answer of greedy sparse regression; see `greedy`."""
    return greedy(look_at(folder, threads))


def sparse_regression_on_fine_mesh(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return its answer when predictions are corrected by the fine mesh, as the diagnoser's are."""
    return greedy(look_at(folder, threads, fine=True))


def greedy(scene: Scene) -> dict:
    """Return the answer of greedy sparse regression.

    Group-wise orthogonal matching pursuit: the hypothesis that lowers BIC = n log(RSS / n) + k log n most is added,
    as long as one does, three at most. The variance of the noise is free, which absorbs some of the mesh's error.
    Probabilities are exp(-BIC / 2), normalised over all causes and none; causes within 8 nats form a group (the
    diagnoser's own limit). It does not test the misfit: no answer is "unexplained".
    """
    causes, n = list(hypotheses(scene)), scene.n
    residual, chosen, found = scene.null.reduced(scene.residual), [], []
    power = residual @ residual
    while len(found) < DEFAULT.search.most_causes:
        now = n * np.log(power / n)
        taken = {cause["id"] for cause in found}
        tried = {}
        for cause in causes:
            if cause.id not in taken or EFFECTS[cause.id].repeatable:
                top, fall = cause.best(residual)
                price = cause.n_columns * np.log(n)
                tried[cause.id] = (n * np.log(max(power - fall, 1e-9) / n) + price, cause, top)
        lowest, cause, top = min(tried.values(), key=lambda one: one[0])
        if lowest >= now:
            break
        bics = {name: one[0] for name, one in tried.items()}
        chosen.append(cause.white[top])
        modes = _directions(cause.left[top])
        residual = residual - (residual @ modes.T) @ modes
        power = residual @ residual
        causes = [other.cleared_of(modes) for other in causes]
        close = [name for name, bic in sorted(bics.items(), key=lambda one: one[1]) if _as_good(bic, lowest, now)]
        weights = np.exp(-0.5 * (np.array([now, *bics.values()]) - lowest))
        found.append(
            {"id": cause.id, "group": close[: DEFAULT.search.most_in_group], "probability": float(1.0 / weights.sum())}
        )
    return _answer(scene, found, chosen)


def error_ranking(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return the single cause whose fit has the least error, named if the error falls by `FALL`.

    The error is the root mean square over all measured values, in units of noise. The probability is always one, the
    group the cause alone, and no answer is "unexplained".
    """
    scene = look_at(folder, threads)
    residual = scene.null.reduced(scene.residual)
    power = residual @ residual
    best = {cause.id: (*cause.best(residual), cause) for cause in hypotheses(scene)}
    top, fall, cause = max(best.values(), key=lambda one: one[1])
    if np.sqrt(max(power - fall, 0.0) / power) > 1.0 - FALL:
        return _answer(scene, [], [])
    found = {"id": cause.id, "group": [cause.id], "probability": 1.0}
    return _answer(scene, [found], [cause.white[top]])


def gaussian_process(folder: Path, ids: Collection[str] = (), *, threads: int = 0) -> dict:
    """Return whether the believed model fits, by a chi-square test, and the prediction of a smooth patch.

    It never names a cause. The patch is the diagnoser's generic rival with the prior size of highest evidence (a fit
    without a prior would predict nothing).
    """
    scene = look_at(folder, threads)
    reduced = scene.null.reduced(scene.residual)
    p = float(chi2.sf(reduced @ reduced, scene.n))
    bench = scene.bench
    marker_std = float(scene.noise.marker_std.mean())
    sizes = scene.white(generic_columns(bench.layout, bench.base, bench.extent, marker_std, bench.settings))
    gains = [fit_amplitudes(reduced, scene.null.reduced(columns))[0] for columns in sizes]
    patch = sizes[int(np.argmax(gains))]
    return {
        "verdict": "consistent" if p > LEVEL else "unexplained",
        "causes": [],
        "p_misfit": p,
        "by_block": _by_block(scene, patch),
    }


def look_at(folder: Path, threads: int, *, fine: bool = False) -> Scene:
    """Return an experiment with the free columns of all regressions; predictions corrected by the fine mesh or not."""
    experiment = read_experiment(folder)
    layout = SignalLayout(experiment)
    noise = estimate_noise(experiment, layout)
    bench = Bench(experiment, layout, threads=threads)
    correction = Correction(layout)
    if fine:
        correction = make_correction(layout, bench.base, refined_predictions(bench, entry_of(experiment))[0])
    nuisances = make_nuisances(bench, np.zeros((1, layout.size)), correction)
    free = [i for i, name in enumerate(nuisances.names) if name == "stiffness" or name.startswith("frame ")]
    null = Null(noise.whitened(correction.at_modulus(nuisances.columns[free]), layout))
    residual = np.where(layout.seen, layout.measured - correction.corrected(bench.base), 0.0)
    return Scene(layout, bench, noise, correction, noise.whitened(residual, layout), null)


def hypotheses(scene: Scene) -> Iterator[Hypotheses]:
    """Yield all causes of the bank, from the cache where they were made before."""
    for name, variants in make_bank(scene.bench).items():
        white = scene.white(np.stack([variant.columns for variant in variants]))
        yield Hypotheses(name, white, scene.null.reduced(white))


def _as_good(bic: float, lowest: float, now: float) -> bool:
    """Return whether a cause is better than none, and within the diagnoser's own limit of the best."""
    return bic < now and bic - lowest < DEFAULT.search.separable**2


def _directions(columns: np.ndarray) -> np.ndarray:
    """Return orthonormal directions of columns (p, size), those of no length left out."""
    _, spread, modes = np.linalg.svd(columns, full_matrices=False)
    return modes[spread**2 > RANK * spread[0] ** 2]


def _answer(scene: Scene, found: list[dict], chosen: list[np.ndarray]) -> dict:
    """Return the answer, with the errors on held-out blocks of all that was chosen."""
    columns = WIDE * np.concatenate([np.zeros((0, scene.layout.size)), *chosen])
    tied = any(len(cause["group"]) > 1 for cause in found)
    verdict = "group" if tied else "named" if found else "consistent"
    return {"verdict": verdict, "causes": found, "by_block": _by_block(scene, columns)}


def _by_block(scene: Scene, columns: np.ndarray) -> dict[str, list[float]]:
    free = scene.null.nuisances
    base, final = LinearModel(scene.residual, free), LinearModel(scene.residual, np.concatenate([free, columns]))
    return by_block(base, final, scene.layout)
