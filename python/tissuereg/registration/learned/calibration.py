"""What a trained model's answers are worth, measured on fields it never saw: ``calibration.npz`` of its folder.

`tissuereg.registration.learned.calibrate` makes it, a registration reads it: kinds of events with the errors of each
kind, how the truth differs from a simulation, and how improbable calibration events look.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import FormatError
from tissuereg.io.fields import Archive, open_npz
from tissuereg.registration.learned.calibration_set import STATISTICS, CalibrationSet
from tissuereg.registration.learned.components import Components
from tissuereg.registration.learned.mixture import Component

#: Form of ``calibration.npz``.
VERSION = 4

#: Fields (n_fields, n_nodes, 3) to their rows at markers and targets, (n_fields, n_rows).
RowsOf = Callable[[FloatArray], FloatArray]

#: Least size of a simulated event, mm: a tiny one does not make the truth certain.
LEAST_SIZE_MM = 0.3

#: Probability that a simulation is not of this event at all.
UNRELATED = 0.02

#: Share of the variance of changes from simulations in general that stays where variants of the simulation are given.
BESIDE_VARIANTS = 0.25


@dataclass(frozen=True, eq=False)
class FieldErrors:
    """Covariances of a model's error fields, expressed by few orthogonal patterns.

    `basis` (n_patterns, n_nodes, 3): the patterns; `covariances` (n_kinds, n_patterns, n_patterns): second moments of
    the patterns' coefficients for each kind of event, mm^2; `rest` (n_nodes, 3): standard deviation of what the
    patterns leave, mm.
    """

    basis: FloatArray
    covariances: FloatArray
    rest: FloatArray

    def sum(self, coefficients: FloatArray) -> FloatArray:
        """Return the sum (n_nodes, 3) of the patterns times coefficients (n_patterns,), mm, in single precision."""
        return np.asarray(coefficients.astype(np.float32) @ self._single).reshape(self.basis.shape[1:])

    @cached_property
    def _single(self) -> Any:
        return self.basis.reshape(len(self.basis), -1).astype(np.float32)

    def project(self, fields: FloatArray) -> FloatArray:
        """Return the part of fields (n_fields, n_nodes, 3) that is a sum of the patterns."""
        patterns = self.basis.reshape(len(self.basis), -1)
        squares = np.einsum("pi,pi->p", patterns, patterns)
        rows = fields.reshape(len(fields), -1)
        return np.asarray((((rows @ patterns.T) / squares) @ patterns).reshape(fields.shape))

    def at(self, rows_of: RowsOf) -> "RowErrors":
        """Return the errors at markers and targets; `rows_of`: takes fields and returns their components there, mm."""
        patterns = rows_of(self.basis)
        rest = rows_of(self.rest[None])[0] ** 2
        return RowErrors(self, patterns, np.asarray(patterns.T @ self.covariances @ patterns + np.diag(rest)))


@dataclass(frozen=True, eq=False)
class RowErrors:
    """Errors at the markers and targets of one registration.

    `whole`: at all nodes; `patterns` (n_patterns, n_rows): its patterns at the points; `covariances` (n_kinds, n_rows,
    n_rows): of the errors of each kind, mm^2.
    """

    whole: FieldErrors
    patterns: FloatArray
    covariances: FloatArray

    def of(self, rows: IntArray) -> "RowErrors":
        """Return the errors at the components with numbers `rows`, in their order."""
        return RowErrors(self.whole, self.patterns[:, rows], self.covariances[:, rows[:, None], rows])


@dataclass(frozen=True, eq=False)
class Change:
    """How truths differ from simulations of the same event.

    A truth is ``(1 + a)`` times the simulation, and a change of its code and of what the decoder misses besides, both
    relative to the size of the simulated event: forces or modulus may be off, so that all moves more or less. `factors`
    (n_factors,): variances of ``a``, of which one holds; from none on; `covariances` (n_kinds, n_latent, n_latent): of
    the difference of codes for each kind of change, 1/mm^2; `errors`: what the decoder misses of the change, by kind;
    per mm of the event's size.
    """

    factors: FloatArray
    covariances: FloatArray
    errors: FieldErrors


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """Outcome of trial registrations of events that the model never saw, with random markers and targets.

    `scales` (n_scales,): candidate factors on the standard deviations of a component, because events differ in size;
    `scale_weights` (n_forms, n_scales): their probabilities, which sum to one: without a simulation one row for all
    components, with one a row for each kind of change with each variance of its factor; `widening`: factor on
    covariances with which 90 % regions hold 90 % of the targets; `tail`: degrees of freedom of the t law of the targets
    about their means, with which 50 % regions hold their share too, None for a Gaussian; `calibration_set`: test
    statistics of the trials.
    """

    scales: FloatArray
    scale_weights: FloatArray
    widening: float = 1.0
    tail: float | None = None
    calibration_set: CalibrationSet = field(default_factory=CalibrationSet.none)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a trained model's answers are worth: kinds of events, the model's errors, outcomes of trial registrations.

    `kinds`: Gaussian mixture of the training set's codes; `errors`: truth minus decoder(encoder(truth)), for each kind;
    `alone`: trials without a simulation; `change`: differences of truths from simulations, None if the model has seen
    no pairs; `anchored`: trials with a simulation.
    """

    kinds: Components
    errors: FieldErrors
    alone: Rehearsal
    change: Change | None = None
    anchored: Rehearsal | None = None

    def at(self, rows_of: RowsOf) -> "PointCalibration":
        """Return the calibration at the markers and targets of one registration.

        `rows_of`: takes fields and returns their components there, mm. Cost: a product of n_patterns^2 n_rows for every
        kind.
        """
        change = None if self.change is None else self.change.errors.at(rows_of)
        return PointCalibration(self, self.errors.at(rows_of), change)

    @cached_property
    def _roots(self) -> FloatArray:
        return np.asarray(np.linalg.cholesky(self.kinds.covariances), np.float64)

    def distance(self, code: FloatArray) -> float:
        """Return how far a code (n_latent,) lies from the training set: least distance from a kind, in its spread."""
        off = code - self.kinds.means
        white = np.linalg.solve(self._roots, off[:, :, None])
        return float(np.sqrt((white**2).sum(axis=(1, 2)).min()))

    def save(self) -> dict[str, FloatArray]:
        """Return the arrays of ``calibration.npz``."""
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
        """Return the content of ``calibration.npz``.

        Raises `FormatError` if it is of another version, or an array is missing or of another shape.
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
            errors = _errors_in(file, "error", None, n_nodes)
            alone = _rehearsal_in(file, "alone", len(errors.covariances) // n_kinds)
            if "change_factors" not in file:
                return cls(kinds, errors, alone)
            factors, covariances = (
                file.floats("change_factors", None),
                file.floats("change_covariances", None, n_latent, n_latent),
            )
            change = Change(factors, covariances, _errors_in(file, "change_error", len(covariances), n_nodes))
            return cls(kinds, errors, alone, change, _rehearsal_in(file, "anchored", len(factors) * len(covariances)))


@dataclass(frozen=True, eq=False)
class PointCalibration:
    """A calibration at the markers and targets of one registration.

    `whole`: at all nodes; `errors`: the model's errors, for each kind of event; `change_errors`: what the decoder
    misses of the change from a simulation, for each kind of change, per mm of the event's size; None without pairs.
    """

    whole: Calibration
    errors: RowErrors
    change_errors: RowErrors | None

    def of(self, rows: IntArray) -> "PointCalibration":
        """Return the calibration at the components with numbers `rows`, in their order."""
        change = None if self.change_errors is None else self.change_errors.of(rows)
        return PointCalibration(self.whole, self.errors.of(rows), change)

    def rehearsal(self, anchored: bool) -> Rehearsal:
        """Return the outcome of trial registrations with a simulation (`anchored`), or without one."""
        known = self.whole.anchored if anchored else None
        return self.whole.alone if known is None else known

    @staticmethod
    def squared_size(size: float, varied: bool) -> float:
        """Return the factor on covariances of changes, mm^2, for an event of a size in mm, with variants or without."""
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

        `code` (n_latent,): of the simulation; `size`: root mean square displacement of the simulation, mm; `simulated`
        (n_rows,): the simulation at markers and targets, mm; `variants`: covariance of variants of the simulation,
        which is their mean; changes then have it beside a share of what they have in general, and no factor. Result:
        components, those about the simulation ordered by kind of change and within a kind by the variance of the
        factor; and for each of these (kind of change, variance of the factor). The second list is empty where the model
        knows no changes.
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
        f"{name}_patterns": errors.basis.astype(np.float16),
        f"{name}_covariances": errors.covariances.astype(np.float32),
        f"{name}_rest_mm": errors.rest.astype(np.float16),
    }


def _errors_in(file: Archive, name: str, n_kinds: int | None, n_nodes: int) -> FieldErrors:
    basis = file.floats(f"{name}_patterns", None, n_nodes, 3)
    covariances = file.floats(f"{name}_covariances", n_kinds, len(basis), len(basis))
    return FieldErrors(basis, covariances, file.floats(f"{name}_rest_mm", n_nodes, 3))


def _rehearsal_arrays(name: str, rehearsal: Rehearsal) -> dict[str, FloatArray]:
    return {
        f"{name}_scales": rehearsal.scales,
        f"{name}_scale_weights": rehearsal.scale_weights,
        f"{name}_signs": rehearsal.calibration_set.statistics,
        f"{name}_groups": rehearsal.calibration_set.groups,
        f"{name}_tail": np.array(rehearsal.tail or 0.0),
        f"{name}_widening": np.array(rehearsal.widening),
    }


def _rehearsal_in(file: Archive, name: str, n_forms: int) -> Rehearsal:
    scales = file.floats(f"{name}_scales", None)
    statistics, tail = file.floats(f"{name}_signs", None, len(STATISTICS)), float(file.floats(f"{name}_tail"))
    return Rehearsal(
        scales,
        file.floats(f"{name}_scale_weights", n_forms, len(scales)),
        float(file.floats(f"{name}_widening")),
        tail or None,
        CalibrationSet(statistics, file.indices(f"{name}_groups", len(statistics))),
    )
