"""The accuracy of a trained model's answers, measured on fields not used in training: the file ``calibration.npz``.

`tissuereg.registration.learned.calibrate` makes it, and a registration reads it. It holds the kinds of events (a
Gaussian mixture of the latents of the training fields) with the model's errors for each kind, the differences of true
fields from simulations, and the test statistics of trial registrations.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError
from tissuereg.io.fields import Archive, open_npz
from tissuereg.registration.learned.calibration_set import STATISTICS, CalibrationSet
from tissuereg.registration.learned.card import is_covariance
from tissuereg.registration.learned.components import Components
from tissuereg.registration.learned.digits import in_digits, table_in
from tissuereg.registration.learned.mixture import Component

#: Form of ``calibration.npz``.
VERSION = 5

#: Fields (n_fields, n_nodes, 3) to their rows at markers and targets, (n_fields, n_rows).
RowsOf = Callable[[FloatArray], FloatArray]

#: Least size of a simulated event, mm: a tiny one does not make the truth certain.
LEAST_SIZE_MM = 0.3

#: Probability that a simulation is not of this event at all.
UNRELATED = 0.02

#: By how much probabilities in a file may miss a sum of one.
_ROUNDING = 1e-3

#: Share of the variance of changes from simulations in general that stays where variants of the simulation are given.
BESIDE_VARIANTS = 0.25


@dataclass(frozen=True, eq=False)
class FieldErrors:
    """Covariances of a model's error fields (true minus decoded), expressed by a few patterns.

    An error field is a sum of patterns times random coefficients, and an independent rest at each node. `basis`
    (n_patterns, n_nodes, 3) holds the patterns; a pattern times a coefficient is in mm. `covariances` (n_kinds,
    n_patterns, n_patterns) are the second moments of the coefficients for each kind of event (component of a Gaussian
    mixture). `rest` (n_nodes, 3) is the standard deviation of the rest, in mm.
    """

    basis: FloatArray
    covariances: FloatArray
    rest: FloatArray

    def sum(self, coefficients: FloatArray) -> FloatArray:
        """Return the sum (n_nodes, 3), in mm, of the patterns times `coefficients` (n_patterns,), in float32."""
        return np.asarray(coefficients.astype(np.float32) @ self._single).reshape(self.basis.shape[1:])

    @cached_property
    def _single(self) -> Any:
        return self.basis.reshape(len(self.basis), -1).astype(np.float32)

    def project(self, fields: FloatArray) -> FloatArray:
        """Return the projection of `fields` (n_fields, n_nodes, 3), mm, on the patterns."""
        patterns = self.basis.reshape(len(self.basis), -1)
        rows = fields.reshape(len(fields), -1)
        found = np.linalg.solve(patterns @ patterns.T, patterns @ rows.T)
        return np.asarray((found.T @ patterns).reshape(fields.shape))

    def at(self, rows_of: RowsOf) -> "RowErrors":
        """Return the covariances of the errors at the markers and targets of one registration.

        `rows_of` maps fields (n_fields, n_nodes, 3) to components at markers and targets, (n_fields, n_rows), in mm.
        """
        patterns = rows_of(self.basis)
        rest = rows_of(self.rest[None])[0] ** 2
        return RowErrors(self, patterns, np.asarray(patterns.T @ self.covariances @ patterns + np.diag(rest)))


@dataclass(frozen=True, eq=False)
class RowErrors:
    """Covariances of a model's errors at the markers and targets of one registration.

    A row is a displacement component of a marker or target. `whole` describes the errors at all nodes. `patterns`
    (n_patterns, n_rows) are the values of its patterns at the rows; times a coefficient they are in mm. `covariances`
    (n_kinds, n_rows, n_rows) are the covariances of the errors at the rows for each kind of event, in mm^2.
    """

    whole: FieldErrors
    patterns: FloatArray
    covariances: FloatArray

    def of(self, rows: IntArray) -> "RowErrors":
        """Return the errors at the displacement components with numbers `rows` int64 (k,), in that order."""
        return RowErrors(self.whole, self.patterns[:, rows], self.covariances[:, rows[:, None], rows])


@dataclass(frozen=True, eq=False)
class Change:
    """Statistics of the difference (change) between the true field of an event and its simulation.

    The truth is modelled as ``(1 + a)`` times the simulation, because forces or the modulus may be off, plus a
    difference of its latents and of what the decoder cannot represent, both in proportion to the size (root mean square
    displacement, mm) of the simulated event. `factors` (n_factors,) are candidate variances of ``a``, from zero on, of
    which one holds. `covariances` (n_kinds, n_latent, n_latent) are those of the difference of latents, in 1/mm^2, for
    each kind of change (one way in which truths differ from simulations, such as another stiffness). `errors` are
    covariances of what the decoder cannot represent, for each kind of change, in mm per mm of size.
    """

    factors: FloatArray
    covariances: FloatArray
    errors: FieldErrors


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """Outcome of trial registrations of events that were not used in training, with random markers and targets.

    `scales` (n_scales,) are candidate factors on the standard deviations of a prior component, because events differ in
    size. `scale_weights` (n_forms, n_scales) are their probabilities, which sum to one: without a simulation in one row
    for all components, with one in a row for each kind of change (way in which truths differ from simulations) with
    each variance of the factor on the simulation. `widening` is the factor on posterior covariances with which 90 %
    regions hold 90 % of the targets. `tail` is the degrees of freedom of the t law of the targets about their means,
    with which 50 % regions hold half of them, None for a Gaussian. `calibration_set` holds the trials' test statistics.
    """

    scales: FloatArray
    scale_weights: FloatArray
    widening: float = 1.0
    tail: float | None = None
    calibration_set: CalibrationSet = field(default_factory=CalibrationSet.none)

    @property
    def beside_variants(self) -> "Rehearsal":
        """The outcome where variants of the simulation are given: the law of targets for the share that stays.

        `widening` and `tail` say how badly a covariance of changes in general knows one event. Of that covariance the
        share `BESIDE_VARIANTS` stays, the rest is that of the variants, which are of this event.
        """
        share = BESIDE_VARIANTS
        tail = None if self.tail is None or share <= 0.0 else self.tail / share
        return replace(self, widening=1.0 + share * (self.widening - 1.0), tail=tail)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Measured accuracy of a trained model: kinds of events, errors of the model, outcomes of trial registrations.

    `kinds` is the Gaussian mixture of the training set's latents, of which each component is called a kind of event;
    `errors` are covariances of truth minus decoder(encoder(truth)), for each kind of event; `alone` is the outcome of
    trials without a simulation; `change` describes differences of truths from simulations, and `anchored` is the
    outcome of trials that start from a simulation, both None if no pairs of simulation and truth were given.
    """

    kinds: Components
    errors: FieldErrors
    alone: Rehearsal
    change: Change | None = None
    anchored: Rehearsal | None = None

    def at(self, rows_of: RowsOf) -> "PointCalibration":
        """Return the calibration at the markers and targets of one registration.

        `rows_of` maps fields (n_fields, n_nodes, 3) to their components at markers and targets, (n_fields, n_rows), in
        mm. Cost: a product of n_patterns^2 n_rows for every kind of event.
        """
        change = None if self.change is None else self.change.errors.at(rows_of)
        return PointCalibration(self, self.errors.at(rows_of), change)

    @cached_property
    def _roots(self) -> FloatArray:
        return np.asarray(np.linalg.cholesky(self.kinds.covariances), np.float64)

    def distance(self, code: FloatArray) -> float:
        """Return the least Mahalanobis distance of a code (n_latent,) from the kinds of events in the training set."""
        off = code - self.kinds.means
        white = np.linalg.solve(self._roots, off[:, :, None])
        return float(np.sqrt((white**2).sum(axis=(1, 2)).min()))

    def save(self) -> dict[str, FloatArray]:
        """Return the arrays that ``calibration.npz`` holds, by their names in the file."""
        arrays = {
            "version": np.array(VERSION),
            "kind_weights": self.kinds.weights,
            "kind_means": self.kinds.means,
            "kind_covariances": self.kinds.covariances,
            **_error_arrays("error", self.errors),
            **_rehearsal_arrays("alone", self.alone),
        }
        if self.change is not None and self.anchored is not None:
            arrays["change_factors"] = self.change.factors
            arrays["change_covariances"] = self.change.covariances
            arrays |= _error_arrays("change_error", self.change.errors)
            arrays |= _rehearsal_arrays("anchored", self.anchored)
        return arrays

    @classmethod
    def read(cls, path: object, n_latent: int, n_nodes: int) -> "Calibration":
        """Return the calibration in the file `path` of a model with `n_latent` latents on a mesh of `n_nodes` nodes.

        Raises `FormatError` if it is of another version, or an array is missing, of another shape, or holds numbers
        that cannot be what they stand for, such as variances of 0.
        """
        with open_npz(str(path)) as file:
            version = int(file.indices("version").item()) if "version" in file else 1
            if version != VERSION:
                message = (
                    f"{path} must be a calibration of version {VERSION}, got {version}; "
                    "`tissuereg calibrate MODEL --data DATA` makes it anew"
                )
                raise FormatError(message, where=str(path))
            weights = file.floats("kind_weights", None)
            n_kinds = len(weights)
            kinds = Components(
                weights,
                file.floats("kind_means", n_kinds, n_latent),
                file.floats("kind_covariances", n_kinds, n_latent, n_latent),
            )
            _must(file, "kind_weights", "probabilities that sum to one", _is_distribution(weights))
            _must(file, "kind_covariances", "positive definite", all(map(_is_definite, kinds.covariances)))
            errors = _errors_in(file, "error", None, n_nodes)
            _must(file, "error_covariances", "some for every kind", len(errors.covariances) >= n_kinds > 0)
            alone = _rehearsal_in(file, "alone", len(errors.covariances) // n_kinds)
            if "change_factors" not in file:
                return cls(kinds, errors, alone)
            factors, covariances = (
                file.floats("change_factors", None),
                file.floats("change_covariances", None, n_latent, n_latent),
            )
            _must(file, "change_factors", "variances, one at least", len(factors) > 0 and bool((factors >= 0.0).all()))
            known = len(covariances) > 0 and all(map(is_covariance, covariances))
            _must(file, "change_covariances", "covariances, one at least", known)
            change = Change(factors, covariances, _errors_in(file, "change_error", len(covariances), n_nodes))
            return cls(kinds, errors, alone, change, _rehearsal_in(file, "anchored", len(factors) * len(covariances)))


@dataclass(frozen=True, eq=False)
class PointCalibration:
    """A calibration restricted to the markers and targets of one registration.

    `whole` is the calibration at all nodes. `errors` are the covariances of the model's errors at the displacement
    components of markers and targets, for each kind of event. `change_errors` are those of the part of the truth's
    change from a simulation that the decoder cannot represent, for each kind of change, in mm per mm of the event's
    size; None if the model was calibrated without pairs of simulation and truth.
    """

    whole: Calibration
    errors: RowErrors
    change_errors: RowErrors | None

    def of(self, rows: IntArray) -> "PointCalibration":
        """Return the calibration at the displacement components with numbers `rows` int64 (k,), in that order."""
        change = None if self.change_errors is None else self.change_errors.of(rows)
        return PointCalibration(self.whole, self.errors.of(rows), change)

    def rehearsal(self, anchored: bool, varied: bool = False) -> Rehearsal:
        """Return the outcome of trials from a simulation, if `anchored` and there were any, else of those without.

        `varied`: whether variants of the simulation are given, of which trials without one know nothing.
        """
        known = self.whole.anchored if anchored else None
        if known is None:
            return self.whole.alone
        return known.beside_variants if varied else known

    @staticmethod
    def squared_size(size: float, varied: bool) -> float:
        """Return the factor, in mm^2, that scales the covariances of a relative change to an event of a given size.

        A relative change is the difference of the truth from the simulation, divided by `size`, the root mean square
        displacement of the simulated event, in mm. If variants of the simulation are given (`varied`), only a share of
        the factor is returned, because they explain the rest.
        """
        return (BESIDE_VARIANTS if varied else 1.0) * max(size, LEAST_SIZE_MM) ** 2

    def prior(self, share: float = 1.0) -> list[Component]:
        """Return the mixture of an event without a simulation; weights sum to `share`.

        A component for each kind of event with errors as in the training set's physics, then, where the calibration
        knows another physics, one for each kind with the errors of that.
        """
        kinds, law = self.whole.kinds, self.whole.alone
        n_kinds = len(kinds.weights)
        return [
            Component(share * kinds.weights[k] * weights, law.scales, kinds.means[k], kinds.covariances[k], errors)
            for weights, block in zip(law.scale_weights, _blocks(self.errors.covariances, n_kinds), strict=True)
            for k, errors in enumerate(block)
        ]

    def prior_about(
        self, code: FloatArray, size: float, simulated: FloatArray, variants: RowErrors | None = None
    ) -> tuple[list[Component], list[tuple[int, float]]]:
        """Return the prior of a simulated event: components about the simulation, then those of an unrelated event.

        `code` (n_latent,) are the simulation's latents; `size` is its root mean square displacement, in mm; `simulated`
        (n_rows,) are its displacement components at markers and targets, in mm; `variants` is the covariance of
        variants of the simulation, if it is their mean: truths then differ from it by this covariance and a share of
        that which they have in general, and by no factor. Components about the simulation are ordered by kind of change
        (way in which truths differ from simulations), then by variance of the factor on the whole simulation. The
        second result holds both for each of these; it is empty where the model was calibrated without pairs of
        simulation and truth, and the prior is then that of an event without a simulation.
        """
        change, law = self.whole.change, self.whole.anchored
        if change is None or law is None or self.change_errors is None:
            return self.prior(), []
        square, known = self.squared_size(size, variants is not None), 0.0
        factors, weights = change.factors, law.scale_weights.reshape(len(change.covariances), -1, len(law.scales))
        if variants is not None:
            # Variants say by which factor all may move more or less.
            factors, weights = np.zeros(1), weights.sum(axis=1, keepdims=True)
            known = variants.covariances[0]
        forms = [(kind, float(factor)) for kind in range(len(change.covariances)) for factor in factors]
        of_factor = np.outer(simulated, simulated)
        about = [
            Component(
                (1.0 - UNRELATED) * of_form,
                law.scales,
                code,
                square * change.covariances[kind],
                square * self.change_errors.covariances[kind] + factor * of_factor + known,
            )
            for (kind, factor), of_form in zip(forms, weights.reshape(len(forms), -1), strict=True)
        ]
        return [*about, *self.prior(UNRELATED)], forms


def _blocks(covariances: FloatArray, n_kinds: int) -> list[FloatArray]:
    """Return covariances of errors in blocks of `n_kinds`: of the physics of the training set, then of another."""
    return [covariances[i : i + n_kinds] for i in range(0, len(covariances), n_kinds)]


def _error_arrays(name: str, errors: FieldErrors) -> dict[str, FloatArray]:
    return {
        **in_digits(f"{name}_patterns", errors.basis),
        f"{name}_covariances": errors.covariances[:, *np.tril_indices(len(errors.basis))].astype(np.float32),
        f"{name}_rest_mm": errors.rest.astype(np.float16),
    }


def _errors_in(file: Archive, name: str, n_kinds: int | None, n_nodes: int) -> FieldErrors:
    basis = table_in(file, f"{name}_patterns", None, n_nodes, 3)
    triangles = file.floats(f"{name}_covariances", n_kinds, len(basis) * (len(basis) + 1) // 2)
    rows, columns = np.tril_indices(len(basis))
    covariances = np.empty((len(triangles), len(basis), len(basis)))
    covariances[:, rows, columns] = covariances[:, columns, rows] = triangles
    _must(file, f"{name}_covariances", "covariances", all(map(is_covariance, covariances)) if len(basis) else True)
    rest = file.floats(f"{name}_rest_mm", n_nodes, 3)
    _must(file, f"{name}_rest_mm", "standard deviations of at least 0", bool((rest >= 0.0).all()))
    return FieldErrors(basis, covariances, rest)


def _must(file: Archive, name: str, rule: str, holds: bool) -> None:
    if not holds:
        message = f"array '{name}' in {file.path} must hold {rule}; it holds other numbers"
        raise FormatError(message, where=f"{file.path}:{name}")


def _is_distribution(weights: FloatArray) -> bool:
    return bool((weights >= 0.0).all() and abs(float(weights.sum()) - 1.0) < _ROUNDING)


def _is_definite(matrix: FloatArray) -> bool:
    try:
        np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return False
    return is_covariance(matrix)


def _rehearsal_arrays(name: str, rehearsal: Rehearsal) -> dict[str, Any]:
    return {
        f"{name}_scales": rehearsal.scales,
        f"{name}_scale_weights": rehearsal.scale_weights,
        f"{name}_signs": rehearsal.calibration_set.statistics.astype(np.float32),
        f"{name}_groups": rehearsal.calibration_set.groups,
        f"{name}_tail": np.array(rehearsal.tail or 0.0),
        f"{name}_widening": np.array(rehearsal.widening),
    }


def _rehearsal_in(file: Archive, name: str, n_forms: int) -> Rehearsal:
    scales = file.floats(f"{name}_scales", None)
    statistics, tail = file.floats(f"{name}_signs", None, len(STATISTICS)), float(file.floats(f"{name}_tail"))
    weights, widening = file.floats(f"{name}_scale_weights", n_forms, len(scales)), file.floats(f"{name}_widening")
    _must(file, f"{name}_scales", "positive, one at least", len(scales) > 0 and bool((scales > 0.0).all()))
    _must(file, f"{name}_scale_weights", "probabilities that sum to one", _is_distribution(weights))
    _must(file, f"{name}_widening", "a positive factor", bool(widening > 0.0))
    _must(file, f"{name}_tail", "degrees of freedom, or 0 for none", tail >= 0.0)
    return Rehearsal(
        scales,
        weights,
        float(widening),
        tail or None,
        CalibrationSet(statistics, file.indices(f"{name}_groups", len(statistics))),
    )
