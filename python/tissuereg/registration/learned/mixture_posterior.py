"""The answer of a trained model given the markers: kinds and sizes of events, and the model's own errors.

The posterior at markers and targets is that of the ensembles of `tissuereg.registration.learned.smoother`, with the
factor on covariances that rehearsals gave. Whole fields are computed for the answer alone, from the same members and
from the errors that the markers tell of them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.machine import n_cores
from tissuereg.body.mesh import Mesh
from tissuereg.registration.deviations import Deviations
from tissuereg.registration.inputs import RegisterInput
from tissuereg.registration.learned.calibration import FieldErrors, PointCalibration, Rehearsal, RowErrors
from tissuereg.registration.learned.mixture import Component
from tissuereg.registration.learned.model import rms_displacement
from tissuereg.registration.learned.points import PointsAround
from tissuereg.registration.learned.repair import repaired
from tissuereg.registration.learned.smoother import Screening, Smoothed, normals, smooth
from tissuereg.registration.learned.statistics import Statistics, statistics_of
from tissuereg.registration.learned.variants import Variants

#: Posterior fields that the spread of nodes is taken from, and how many are decoded at once.
_DRAWS, _BATCH = 64, 32


@dataclass(frozen=True, eq=False)
class _Anchor:
    """The simulation about which the prior of a registration lies; zero displacement without one.

    `field` (n_nodes, 3) is the simulated displacement at the nodes, and `rows` (n_rows,) its components at markers and
    targets, in mm (zero for a model without a simulation's code); `size` is its root mean square displacement, in mm.
    `forms` holds, for each component of the prior about the simulation, the number of its kind of change (way in which
    truths differ from simulations) and the variance of the factor on the whole simulation. `variants` is the covariance
    of the simulation's variants where it is their mean, else None.
    """

    field: FloatArray
    rows: FloatArray
    size: float
    forms: tuple[tuple[int, float], ...]
    variants: RowErrors | None


@dataclass(frozen=True, eq=False)
class CalibratedPosterior:
    """The posterior of one registration with a trained model: moments of a mixture of ensembles; lengths in mm.

    Attributes
    ----------
    mesh : Mesh
        Undeformed body.
    model : PointsAround
        The model of this moment at markers and targets.
    at : PointCalibration
        What its answers are worth there; the rows of the used markers come first.
    order : ndarray of int64, shape (n_markers,)
        Markers in the order of the rows.
    prior : list of Component
        Of the mixture.
    screening : Screening
        Evidence of its pairs of component and scale.
    found : Smoothed
        The posterior ensembles at markers and targets.
    observed, noise : ndarray of float64, shape (3 n_used,) and (3 n_used, 3 n_used)
        Measured displacements, and the covariance of the tracker's noise.
    seed : int
        Of draws.
    anchor : _Anchor
        The simulation, and what its components say of it.
    rehearsal : Rehearsal
        What it is compared with.
    """

    mesh: Mesh
    model: PointsAround
    at: PointCalibration
    order: IntArray
    prior: list[Component]
    screening: Screening
    found: Smoothed
    observed: FloatArray
    noise: FloatArray
    seed: int
    anchor: _Anchor
    rehearsal: Rehearsal

    @classmethod
    def of(
        cls,
        given: RegisterInput,
        model: PointsAround,
        used: IntArray,
        simulation: FloatArray | None,
        variants: Variants | None = None,
    ) -> "CalibratedPosterior":
        """Return the posterior of one registration.

        `given`: body, measured markers and seed; `model`: the model of this moment at markers and targets; `used` int64
        (n_used,): markers that are used; `simulation` (n_nodes, 3) or None: simulated displacement, mm; `variants`:
        whose mean the simulation is. Cost: two decodes of about 2 n_latent columns at markers and targets (three
        without a simulation), then one of the ensembles of all pairs in every step and one more.
        """
        markers, calibration = given.markers, model.calibration
        order = np.concatenate([used, np.setdiff1d(np.arange(len(markers)), used)])
        rows = np.arange(calibration.errors.patterns.shape[1])
        rows[: 3 * len(order)] = (3 * order[:, None] + np.arange(3)).ravel()
        at = calibration if np.array_equal(order, np.arange(len(order))) else calibration.of(rows)
        size = 0.0 if simulation is None else float(rms_displacement(simulation[None])[0])
        simulated, start = np.zeros(len(rows)), at.whole.kinds.centre
        prior, forms = at.prior(), list[tuple[int, float]]()
        varied = None if variants is None else variants.spread.at(model.at_rows).of(rows)
        if model.code is not None and simulation is not None:
            simulated, start = model.at_rows(simulation[None])[0, rows], model.code
            prior, forms = at.prior_about(start, size, simulated, varied)
        observed = markers.displacement[used].ravel()
        noise = np.diag((markers.axis_std[used] ** 2).ravel())

        def decode(latents: FloatArray) -> FloatArray:
            return model.decode(np.ascontiguousarray(latents))[:, rows]

        spread = at.whole.kinds.spread
        screening = Screening.of(decode, prior, observed, noise, start, spread, simulated=bool(forms))
        how, threads = given.settings.smoother, given.settings.threads or n_cores()
        draws = normals(given.seed, len(start), how.n_members)
        found = smooth(decode, prior, screening.kept(), observed, noise, draws, how.alphas(), threads)
        rehearsal = at.rehearsal(bool(forms), varied is not None)
        field = np.zeros_like(given.mesh.nodes) if simulation is None else simulation
        anchor = _Anchor(field, simulated, size, tuple(forms), varied)
        return cls(
            given.mesh, model, at, order, prior, screening, found, observed, noise, given.seed, anchor, rehearsal
        )

    @cached_property
    def _covariance(self) -> FloatArray:
        return self.found.covariance

    @cached_property
    def _decoded(self) -> FloatArray:
        field: FloatArray = self.model.latent.decode(self.found.mean_latents[:, None])[0]
        return field

    @cached_property
    def _correction(self) -> FloatArray:
        """Posterior mean (n_nodes, 3), in mm, of the decoded field's error, given the residuals at the markers."""
        told: dict[int, tuple[FieldErrors, FloatArray]] = {}
        factor = 0.0
        for pair in self.found.pairs:
            pull, square = pair.pulls.mean(axis=0), pair.scale**2
            for errors, covariance in self._errors(pair.component):
                coefficients = pair.weight * square * covariance @ (errors.patterns[:, : len(pull)] @ pull)
                _, before = told.get(id(errors), (errors.whole, 0.0))
                told[id(errors)] = errors.whole, before + coefficients
            factor += pair.weight * square * self._factor(pair.component) * float(self.anchor.rows[: len(pull)] @ pull)
        fields = (whole.sum(coefficients) for whole, coefficients in told.values())
        return np.asarray(sum(fields, factor * self.anchor.field))

    @cached_property
    def _whole(self) -> tuple[FloatArray, FloatArray]:
        return repaired(self.mesh, self._decoded + self._correction)

    @property
    def displacement(self) -> FloatArray:
        """Displacement (n_nodes, 3) of every node, in mm: the decoded field plus the posterior mean of its error.

        Neither of the two obeys mechanics, so the field is smoothed where tetrahedra are inverted.
        """
        return self._whole[0]

    @property
    def ratios(self) -> FloatArray:
        """Volume ratio (n_tets,) of every tetrahedron, deformed over undeformed."""
        return self._whole[1]

    def deviations(self, start: FloatArray) -> Deviations:
        """Return the uncertainty of the displacement of every node, from 64 posterior fields.

        `start` (n_nodes, 3): the displacement by the simulation, or zero, in mm.
        """
        away = np.concatenate(self._drawn()) - self.displacement
        away -= away.mean(axis=0)
        roots = np.sqrt(self.rehearsal.widening / (_DRAWS - 1)) * away
        doubt = self._gains(self.displacement - start, np.einsum("eni,eni->n", roots, roots))[1]
        return Deviations.of(roots, doubt, self.tail)

    @property
    def _n_markers(self) -> int:
        return len(self.order)

    @cached_property
    def marker_mean(self) -> FloatArray:
        """Mean displacement (n_markers, 3) of every marker, used or not, in mm."""
        mean = np.empty((self._n_markers, 3))
        mean[self.order] = self.found.mean[: 3 * self._n_markers].reshape(-1, 3)
        return mean

    @cached_property
    def marker_covariance(self) -> FloatArray:
        """Covariance (3 n_markers, 3 n_markers) of the markers' displacement, the model's error included, in mm^2."""
        rows = (3 * self.order[:, None] + np.arange(3)).ravel()
        covariance = np.empty((len(rows), len(rows)))
        covariance[np.ix_(rows, rows)] = self._covariance[: len(rows), : len(rows)]
        return self.rehearsal.widening * covariance

    @property
    def target_mean(self) -> FloatArray:
        """Mean displacement (n_targets, 3) of every target, in mm."""
        return self.found.mean[3 * self._n_markers :].reshape(-1, 3)

    @property
    def target_covariance(self) -> FloatArray:
        """Covariance (n_targets, 3, 3) of every target's displacement, the model's own error included, in mm^2."""
        first = range(3 * self._n_markers, len(self._covariance), 3)
        blocks = [self._covariance[i : i + 3, i : i + 3] for i in first]
        return self.rehearsal.widening * np.array(blocks).reshape(-1, 3, 3)

    def gains(self, start: FloatArray) -> list[tuple[float, bool]]:
        """Return for each target the share of the start's squared error that the answer removes, and whether it is low.

        `start` (n_targets, 3) is the displacement by the simulation, or zero, in mm. The share is ``|mean - start|^2 /
        (|mean - start|^2 + trace C)``, with the posterior mean and covariance C of the target. It is low if it is less
        than half and trace C exceeds the tracker's noise variance, summed over the axes.
        """
        left = np.trace(self.target_covariance, axis1=1, axis2=2)
        shares, doubt = self._gains(self.target_mean - start, left)
        return [(float(share), bool(one > 0.0)) for share, one in zip(shares, doubt, strict=True)]

    def _gains(self, moved: FloatArray, left: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the shares (n,) of `gains`, and doubts (n,), mm^2, of points moved by (n, 3), mm, with variance (n,).

        A doubt is above zero where more is left than was removed, and than the noise.
        """
        removed = (moved**2).sum(axis=1)
        noise = 3.0 * float(np.diag(self.noise).mean())
        return removed / np.maximum(removed + left, 1e-300), left - np.maximum(removed, noise)

    @property
    def tail(self) -> float | None:
        """Degrees of freedom of the t law of the targets about their means; None for a Gaussian."""
        return self.rehearsal.tail

    @cached_property
    def statistics(self) -> Statistics:
        """Test statistics, to be compared with those of calibration events."""
        n_own = len(self.anchor.forms) or len(self.prior)
        return statistics_of(self.at.whole, self.prior, self.screening, self.observed, self.noise, n_own)

    def _factor(self, number: int) -> float:
        """Return the variance of the factor on the whole simulation in the component of the prior with this number."""
        forms = self.anchor.forms
        return forms[number][1] if number < len(forms) else 0.0

    def _errors(self, number: int) -> list[tuple[RowErrors, FloatArray]]:
        """Return the sources of error in the component of the prior with this number.

        Each is a set of patterns, with the covariance (n_patterns, n_patterns) of its coefficients at scale one.
        """
        forms, change, variants = self.anchor.forms, self.at.change_errors, self.anchor.variants
        if number >= len(forms) or change is None:
            return [(self.at.errors, self.at.errors.whole.covariances[number - len(forms)])]
        square = self.at.squared_size(self.anchor.size, variants is not None)
        general = (change, square * change.whole.covariances[forms[number][0]])
        return [general] if variants is None else [general, (variants, variants.whole.covariances[0])]

    def _drawn(self) -> list[FloatArray]:
        """Return posterior fields (n, n_nodes, 3), mm, in batches: members, with errors conditioned on the markers.

        A drawn error is conditioned by the residual that it leaves (A. G. Journel, C. J. Huijbregts, 1978).
        """
        rng, n_obs = np.random.default_rng([self.seed, 5]), len(self.observed)
        weights = self.found.weights
        chosen = np.searchsorted(np.cumsum(weights), (np.arange(_DRAWS) + rng.random()) / _DRAWS * 0.999999)
        tracker = np.linalg.cholesky(self.noise)
        codes, corrections = [], []
        for number in chosen:
            pair = self.found.pairs[number]
            one, scale, member = self.prior[pair.component], pair.scale, rng.integers(pair.latents.shape[1])
            errors = self._errors(pair.component)
            sources = [_Source.drawn(error, scale**2 * known, n_obs, rng) for error, known in errors]
            variance, simulated = scale**2 * self._factor(pair.component), self.anchor.rows[:n_obs]
            factor = np.sqrt(variance) * rng.standard_normal()
            explained = variance * simulated**2 + sum(source.variance for source in sources)
            rest = np.maximum(scale**2 * np.diag(one.errors[:n_obs, :n_obs]) - explained, 0.0)
            drawn = factor * simulated + sum(source.coefficients @ source.seen for source in sources)
            drawn += np.sqrt(rest) * rng.standard_normal(n_obs) + tracker @ rng.standard_normal(n_obs)
            pull = pair.pulls[member] - np.linalg.solve(pair.noise, drawn)
            codes.append(pair.latents[:, member])
            changed = (factor + variance * float(simulated @ pull)) * self.anchor.field
            corrections.append(sum((source.given(pull) for source in sources), changed))
        return [
            self.model.latent.decode(np.array(codes[i : i + _BATCH]).T) + np.array(corrections[i : i + _BATCH])
            for i in range(0, _DRAWS, _BATCH)
        ]


@dataclass(frozen=True, eq=False)
class _Source:
    """A draw of the pattern coefficients of one source of errors, with their covariance.

    `errors` is the source, an error that is a sum of patterns times random coefficients; `covariance` (n_patterns,
    n_patterns) is that of the coefficients; `seen` (n_patterns, n_obs) are the patterns at the components of the used
    markers; `coefficients` (n_patterns,) are those drawn. A pattern times a coefficient is in mm.
    """

    errors: RowErrors
    covariance: FloatArray
    seen: FloatArray
    coefficients: FloatArray

    @classmethod
    def drawn(cls, errors: RowErrors, covariance: FloatArray, n_obs: int, rng: np.random.Generator) -> "_Source":
        """Return a draw of coefficients from N(0, covariance); `n_obs` is three times the number of used markers."""
        values, vectors = np.linalg.eigh(covariance)
        roots = vectors * np.sqrt(np.maximum(values, 0.0))
        return cls(errors, covariance, errors.patterns[:, :n_obs], roots @ rng.standard_normal(len(roots)))

    @property
    def variance(self) -> FloatArray:
        """Variance (n_obs,) of the used markers' displacement components that this source of errors causes, in mm^2."""
        return np.asarray(np.einsum("po,pq,qo->o", self.seen, self.covariance, self.seen, optimize=True))

    def given(self, pull: FloatArray) -> FloatArray:
        """Return the error field (n_nodes, 3), in mm, of the draw, conditioned on the markers.

        `pull` (n_obs,), in 1/mm, is S^-1 times measured minus drawn marker displacements, with their covariance S.
        """
        return np.tensordot(self.coefficients + self.covariance @ (self.seen @ pull), self.errors.whole.basis, 1)
