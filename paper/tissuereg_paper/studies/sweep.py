"""Registrations of all pairs of some cases under many settings, and a row of the answer for each."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import det_f
from tissuereg.registration.learned.model import Gaussian
from tissuereg_paper.latents import error_covariance
from tissuereg_paper.studies.algorithm import assimilate_many
from tissuereg_paper.studies.cases import Cases
from tissuereg_paper.studies.measures import Clusters, Errors, inside90
from tissuereg_paper.studies.points import decoder_at
from tissuereg_paper.studies.settings import Setting
from tissuereg_paper.studies.study import Progress
from tissuereg_paper.studies.subject import Subject

#: Pairs that share the calls of the decoder; the bits of a result depend on it, in the last digits.
_BLOCK = 10


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a setting gives on all pairs.

    Attributes
    ----------
    steps : list of Errors
        Of the decoded mean after each assimilation, or of the last alone; mm.
    inside90 : ndarray of float64, shape (n_pairs,)
        Share of the inner points whose 90 % region holds the truth.
    det_f : ndarray of float64, shape (n_pairs, 2)
        Smallest volume ratio of a registered mesh, and its number of inverted tets; NaN where they were not computed.
    """

    steps: list[Errors]
    inside90: FloatArray
    det_f: FloatArray

    @property
    def end(self) -> Errors:
        """Errors at the end."""
        return self.steps[-1]


class Sweep:
    """Runs settings on cases; each is run once.

    Parameters
    ----------
    subject : Subject
        Body and model.
    cases : Cases
        Pairs, markers, inner points.
    seed : int
        Of the ensembles. Each pair has its own, the same under every setting.
    thorough : bool
        Whether the mean is decoded after each assimilation, and volume ratios of the registered meshes are found.

    Attributes
    ----------
    start : ndarray of float64, shape (n_pairs,)
        Mean distance of the nodes of start and target, mm.
    clusters : Clusters
        Of the pairs.
    encoder_spread : float
        Standard deviation of q over that of all training codes, the median over latents and start meshes.
    """

    def __init__(self, subject: Subject, cases: Cases, seed: int, *, thorough: bool = False) -> None:
        self.cases = cases
        self.start = cases.start_errors
        self.clusters = Clusters(cases.starts, cases.targets)
        self._mesh, self._model, self._seed, self._thorough = subject.held_out.mesh, subject.model, seed, thorough
        shapes, self._which = np.unique(cases.starts, return_inverse=True)
        codes = [self._model.encode(np.asarray(cases.fields[shape], np.float64)) for shape in shapes]
        family = self._model.prior()
        self._priors: dict[str, list[Gaussian]] = {
            "encoder": [Gaussian(mean, np.diag(variance)) for mean, variance in codes],
            "encoder-std": [Gaussian(mean, np.diag(np.sqrt(variance))) for mean, variance in codes],
            "family": [family] * len(codes),
        }
        spread = np.sqrt(np.array([variance for _, variance in codes]))
        self.encoder_spread = float(np.median(spread / np.sqrt(np.diag(family.covariance))))
        self._markers, self._inner = (decoder_at(self._model, nodes) for nodes in (cases.markers, cases.inner))
        own = self._model.errors()
        self._at_markers = error_covariance(own[:, cases.markers].reshape(len(own), -1))
        self._at_inner = np.array([error_covariance(own[:, node]) for node in cases.inner]).reshape(-1, 3, 3)
        self._done: dict[Any, Outcome] = {}

    def run(self, settings: Sequence[Setting], threads: int = 0, progress: Progress | None = None) -> None:
        """Run settings that have not been run.

        Parameters
        ----------
        settings : sequence of Setting
            What to run.
        threads : int
            Lots of pairs side by side; 0 takes all cores. The result does not depend on it.
        progress : callable of (int, int), optional
            Called with the number of lots that are done, and of all.
        """
        new = {one.key: one for one in settings if one.key not in self._done}
        lots = [slice(first, first + _BLOCK) for first in range(0, self.cases.n_pairs, _BLOCK)]
        jobs = [(setting, lot) for setting in new.values() for lot in lots]
        parts: list[Outcome] = []
        with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
            for part in pool.map(lambda job: self._lot(*job), jobs):
                parts.append(part)
                if progress is not None:
                    progress(len(parts), len(jobs))
        for number, key in enumerate(new):
            of_setting = parts[number * len(lots) : (number + 1) * len(lots)]
            steps = [Errors.joined(list(step)) for step in zip(*(part.steps for part in of_setting), strict=True)]
            inside, ratios = (np.concatenate([getattr(p, name) for p in of_setting]) for name in ("inside90", "det_f"))
            self._done[key] = Outcome(steps, inside, ratios)

    def outcome(self, setting: Setting) -> Outcome:
        """Return what a setting gave that has been run."""
        return self._done[setting.key]

    def row(self, study: str, setting: Setting) -> dict[str, Any]:
        """Return a setting's row of the answer.

        Parameters
        ----------
        study : str
            Name of the study.
        setting : Setting
            Has been run.

        Returns
        -------
        dict
            As `pages/paper.md` states; ``paper_mm`` is None.
        """
        found = self.outcome(setting)
        end = found.end
        return {
            "study": study,
            "method": setting.method.name,
            "prior": setting.method.prior,
            "cd": setting.cd,
            "reading": setting.reading,
            "cd_mm2": setting.cd_mm2,
            "n_e": setting.n_e,
            "n_a": setting.n_a,
            "n_pairs": self.cases.n_pairs,
            "start_mean_mm": float(self.start.mean()),
            "end_mean_mm": float(end.mean.mean()),
            "end_mean_interval95_mm": list(self.clusters.interval(end.mean)),
            "end_rms_mm": float(np.sqrt((end.rms**2).mean())),
            "end_max_mm": float(end.largest.max()),
            "end_max_median_mm": float(np.median(end.largest)),
            "coverage90": float(found.inside90.mean()),
            "worse": int((end.mean > self.start).sum()),
            "paper_mm": None,
            **(
                {"min_det_f": found.det_f[:, 0].min(), "inverted_tets": int(found.det_f[:, 1].sum())}
                if self._thorough
                else {}
            ),
        }

    def _lot(self, setting: Setting, lot: slice) -> Outcome:
        cases, method, model = self.cases, setting.method, self._model
        targets = cases.fields[cases.targets[lot]].astype(np.float64)
        pairs = range(*lot.indices(cases.n_pairs))
        priors = [self._priors[method.prior][self._which[pair]] for pair in pairs]
        noise = setting.cd_mm2 * np.eye(3 * len(cases.markers))
        if method.own_errors:
            noise = noise + self._at_markers
        found = assimilate_many(
            lambda latents: self._markers(latents).reshape(latents.shape[1], -1),
            targets[:, cases.markers].reshape(len(targets), -1),
            noise,
            priors,
            rngs=[np.random.default_rng([self._seed, 22, pair]) for pair in pairs],
            n_members=setting.n_e,
            n_steps=setting.n_a,
            balanced=method.balanced,
        )
        means = found.means if self._thorough else found.means[-1:]
        fields = [model.decode(np.ascontiguousarray(mean.T)) for mean in means]
        ratios = np.full((len(targets), 2), np.nan)
        if self._thorough:
            of_tets = det_f(self._mesh, fields[-1])
            ratios = np.stack([of_tets.min(axis=1), (of_tets <= 0.0).sum(axis=1)], axis=1)
        points = self._inner(np.concatenate(list(found.latents), axis=1))
        points = points.reshape(len(targets), setting.n_e, len(cases.inner), 3)
        own = self._at_inner if method.own_errors else None
        inside = inside90(points, targets[:, cases.inner], found.spread_factor, own)
        return Outcome([Errors.of(field, targets) for field in fields], inside, ratios)
