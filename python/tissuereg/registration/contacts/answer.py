"""Assembly of the result of a registration by contacts, from the fitted load and its uncertainty."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.clock import Clock
from tissuereg.body.mesh import det_f
from tissuereg.registration.contacts.draws import DeviationsOfContacts, Draws
from tissuereg.registration.contacts.evidence import MarkerEvidence
from tissuereg.registration.contacts.explained import explained, reasons
from tissuereg.registration.contacts.fit import ContactFit
from tissuereg.registration.contacts.found import FoundContact, find_contacts
from tissuereg.registration.contacts.measured import MarkerData
from tissuereg.registration.contacts.result import ContactRegistration
from tissuereg.registration.contacts.spread import Points, Spread
from tissuereg.registration.contacts.state import BodyState
from tissuereg.registration.contacts.surface_fit import SurfaceFit
from tissuereg.registration.contacts.surface_points import PointData
from tissuereg.registration.inputs import RegisterInput, rms_length
from tissuereg.registration.result import MarkerFit
from tissuereg.registration.target import NO_MARKER, Target
from tissuereg.registration.trust import GAVE, LEVEL, NOISY, Trust, judge, lone_motion


@dataclass(frozen=True, eq=False)
class Known:
    """The registered displacement of targets and markers, with the uncertainty of the targets and of unused markers.

    `used`, `lost` int64 (n_used,), (n_lost,): numbers of the markers that were used, and of those that were not seen or
    were found wrong; `displacement` (n_targets + n_markers, 3): displacement of the targets, then of all markers, in
    the tracker's frame, mm; `points`: uncertainty of the n_targets + n_lost places of the targets, then of the lost
    markers.
    """

    used: IntArray
    lost: IntArray
    displacement: FloatArray
    points: Points


def known_of(given: RegisterInput, fit: ContactFit, spread: Spread) -> Known:
    """Return the registered displacement of all targets and markers in mm, with the uncertainty of the unmeasured ones.

    `given`: checked input; `fit`: contacts and equilibrium that were found; `spread`: uncertainty of the fit. A marker
    is used if a coordinate of it was measured and it is wrong with less than the probability in the settings. Cost:
    three right-hand sides for each target and each marker that is not used; no more for many targets than for some.
    """
    state, observed, inner = fit.state, given.observed, given.targets
    n_targets = len(inner.names)
    measured = np.isfinite(given.markers.measured).any(axis=1)
    counts = np.asarray(measured & (fit.wrong < given.settings.contacts.report.wrong))
    used, lost = np.flatnonzero(counts), np.flatnonzero(~counts)
    here = state.moved[observed.nodes]
    moved = np.concatenate([inner.predict(state.moved[inner.nodes]), observed.predict(here)])
    reference = np.concatenate([inner.reference.reshape(-1, 3), given.markers.reference])
    # Where the tangent is, as those of other markers: then later moments ask for the same rows.
    moved_there = fit.tangent.moved if fit.tangent.moved is not None else state.moved[: given.mesh.n_nodes]
    of_markers = observed.rows_of(moved_there) if len(lost) else []
    rows = [*inner.rows(), *(of_markers[3 * marker + axis] for marker in lost for axis in range(3))]
    some = np.concatenate([np.arange(n_targets), n_targets + lost])
    points = spread.points(rows, (reference + moved)[some], given.seed)
    return Known(used, lost, state.frame.apply(reference + moved) - reference, points)


@dataclass(frozen=True, eq=False)
class Answer:
    """All parts from which the result of a registration by contacts is assembled.

    `given`: checked input: body, markers, targets and settings; `fit`: the contacts that were found, and the
    equilibrium under them; `start`: the body under the believed load alone (at rest without one), from which the search
    started; `knows`: whether a load is believed, so that the targets have a predicted place; `known`: registered
    displacement of targets and markers, with its uncertainty; `deviations`: function without arguments that returns the
    uncertainty of the displacement of every node; `draw`: function of a number of draws that returns displacement
    fields from the posterior, mm; `surface`: fit of the measured points of the surface; None if no points were given;
    `kept`: reasons of the moment before, whose verdict on noise and supports is kept; None to weigh them.
    """

    given: RegisterInput
    fit: ContactFit
    start: BodyState
    knows: bool
    known: Known
    deviations: DeviationsOfContacts
    draw: Draws
    surface: SurfaceFit | None
    kept: tuple[str, ...] | None = None

    def contacts(self) -> tuple[FoundContact, ...]:
        """Return the contacts that were found, described by drawn coefficients, one draw a sample."""
        rng = np.random.default_rng([self.given.seed, 10])
        drawn = self.draw.spread.coefficients(rng, len(self.fit.samples[0]))
        return find_contacts(self.fit, self.given.settings.contacts.report, drawn)

    def registration(self, clock: Clock) -> ContactRegistration:
        """Return the result that a user receives: registered displacement, uncertainty, contacts and tests of trust.

        `clock`: holds the wall time of each stage in s, which is copied into the result.
        """
        given, fit, markers = self.given, self.fit, self.given.markers
        mesh, state, names = given.mesh, fit.state, given.markers.names
        body = state.moved[: mesh.n_nodes]
        fitted = self._of_markers(self.known.displacement)
        used, lost = self.known.used, self.known.lost
        some = np.asarray(np.isfinite(markers.measured).any(axis=1))
        start_displacement, ratios = self._start_displacement(), det_f(mesh, body)
        unseen = [self._unseen(k, start_displacement[i]) for k, i in enumerate(lost)]
        return ContactRegistration(
            body=given.body,
            displacement=state.frame.apply(mesh.nodes + body) - mesh.nodes,
            deviations=self.deviations,
            targets=self._targets(),
            unseen={names[i]: target for i, target in zip(lost, unseen, strict=True)},
            markers=MarkerFit(
                used=tuple(names[i] for i in used),
                dropped=tuple((names[i], "wrong" if some[i] else self.given.why_unseen(int(i))) for i in lost),
                before_rms_mm=rms_length(markers.displacement[used] - start_displacement[used]),
                after_rms_mm=rms_length(markers.displacement[used] - fitted[used]),
                residual_mm={names[i]: markers.displacement[i] - fitted[i] for i in used},
                inner=tuple(names[i] for i in np.flatnonzero(given.observed.inner)),
            ),
            all_markers=markers,
            start_markers=markers.reference + start_displacement,
            min_det_f=float(ratios.min()),
            inverted_tets=int((ratios <= 0).sum()),
            trust=self._trust(unseen, float(ratios.min())),
            surface=self.surface,
            model={"kind": "contacts", "source": "fitted here", "patches": fit.columns.n_patches},
            seconds=clock.seconds,
            settings=given.settings,
            seed=given.seed,
            search=self.contacts,
            work=dict(fit.counters),
            forces=_forces(fit),
            explained_mm=explained(fit),
            tracker="drifts" if fit.columns.moves else "fixed",
            draw=self.draw,
        )

    def _of_markers(self, both: FloatArray) -> FloatArray:
        """Return the markers' rows (n_markers, 3) of an array (n_targets + n_markers, 3) that has the targets first."""
        return both[len(self.given.targets.names) :]

    def _start_displacement(self) -> FloatArray:
        """Return the markers' displacement under the believed load, (n_markers, 3), in the tracker's frame, mm."""
        observed, reference, start = self.given.observed, self.given.markers.reference, self.start
        start_displacement = observed.predict(start.moved[observed.nodes])
        return start.frame.apply(reference + start_displacement) - reference

    def _targets(self) -> dict[str, Target]:
        inner, start = self.given.targets, self.start
        predicted = start.frame.apply(inner.reference + inner.predict(start.moved[inner.nodes]))
        covariance = self.known.points.covariance
        return {
            name: self._target(i, inner.reference[i], self.known.displacement[i], covariance[i], predicted[i])
            for i, name in enumerate(inner.names)
        }

    def _unseen(self, position: int, start_displacement: FloatArray) -> Target:
        """Return the predicted measurement of a marker that was not used: its mean place, mm, and covariance, mm^2.

        `position`: number of the marker among those not used; `start_displacement` (3,): its displacement under the
        believed load, mm. The covariance contains the tracker's noise.
        """
        markers, marker = self.given.markers, int(self.known.lost[position])
        index = len(self.given.targets.names) + position
        covariance = self.known.points.covariance[index] + np.diag(markers.axis_std[marker] ** 2)
        moved = self._of_markers(self.known.displacement)[marker]
        reference = markers.reference[marker]
        return self._target(index, reference, moved, covariance, reference + start_displacement)

    def _target(
        self, index: int, reference: FloatArray, moved: FloatArray, covariance: FloatArray, predicted: FloatArray
    ) -> Target:
        share = float(self.known.points.constrained[index])
        return Target(
            reference,
            reference + moved,
            covariance,
            predicted if self.knows else None,
            share,
            NO_MARKER if share < self.given.settings.contacts.report.least_constrained else None,
        )

    def _wrong(self, unseen: list[Target]) -> list[str]:
        """Return one sentence for every dropped marker that lies outside the region predicted from the other markers.

        `unseen`: predicted measurement of each marker that was not used, in the order of `known.lost`. A dropped marker
        inside its region gets no sentence: it contradicts nothing, since no sampled contact reaches it and the region
        is wide.
        """
        markers, limit = self.given.markers, LEVEL / max(len(self.given.markers), 1)
        return [
            f"wrong marker: {markers.names[i]} does not fit the others (probability {self.fit.wrong[i]:.2f})"
            for i, target in zip(self.known.lost, unseen, strict=True)
            if _chance(markers.measured[i] - target.mean, target.covariance) < limit
        ]

    def _residual_variance(self, moved: FloatArray) -> FloatArray:
        """Return the variance of the markers' residuals, (n_markers, 3), mm^2: tracker's noise plus model's error.

        At the rim of a contact the motion varies strongly across an element and the mesh cannot resolve it; the model's
        error is therefore enlarged there, in this test alone. `moved` (n_markers,): length of each marker's motion, mm.
        """
        settings, observed = self.given.settings.contacts, self.given.observed
        local = observed.variation(self.fit.state.moved[observed.nodes])
        model = (settings.model_error * moved) ** 2 + (settings.local_error * local) ** 2
        return np.asarray(self.given.markers.axis_std**2 + model[:, None])

    def _unlike_stated(self) -> list[str]:
        """Return sentences that the noise is larger than stated, or a support gave, where the markers surely say so.

        Where there are so many observations that they are projected, the misfit tells it.
        """
        if self.kept is not None:
            return [sentence for sentence in (NOISY, GAVE) if sentence in self.kept]
        markers, problem = self.given.markers, self.fit.observations
        marker, axis = np.nonzero(np.isfinite(markers.measured))
        if not problem.groups or len(marker) != len(problem.innovation):
            return []
        kept = np.isin(marker, self.known.used)
        tracker = (markers.axis_std**2)[marker, axis][kept]
        evidence = self.given.settings.contacts.evidence
        if not kept.any():
            return []
        found, problem, surely = [], problem.only(kept), -float(np.log(LEVEL))
        weighed = MarkerEvidence(self.fit, problem, evidence)
        if weighed.log_noise_odds(tracker) > (0.0 if kept.sum() >= evidence.many else surely):
            found.append(NOISY)
        if weighed.log_support_odds() > surely:
            found.append(GAVE)
        return found

    def _trust(self, unseen: list[Target], min_det_f: float) -> Trust:
        used = self.known.used
        given, fit, markers, surface = self.given, self.fit, self.given.markers, self.surface
        notes = [*given.notes, *self._wrong(unseen)]
        notes += reasons(fit, given.settings.contacts.report)
        notes += self._unlike_stated() if surface is None else surface.reasons(given.settings.contacts.report)
        points = (0.0, 0) if surface is None else (surface.misfit, surface.used)
        residual = markers.displacement[used] - self._of_markers(self.known.displacement)[used]
        moved = MarkerData(given.observed, markers, given.settings.contacts.model_error).moved(fit.state.frame)
        variance = self._residual_variance(moved)[used].ravel()
        if surface is None:
            places, std = markers.reference[used], markers.std[used]
            notes += lone_motion(tuple(markers.names[i] for i in used), places, moved[used], std, given.mesh.extent)
        # Wrong markers were detected with the contacts; here each residual is compared with its noise alone.
        spread = np.zeros((3 * len(used), 3 * len(used)))
        names = tuple(markers.names[i] for i in used)
        # The misfit of the innovation contains the data term; the rest is the prior's.
        prior_term = max(0.0, fit.misfit - float(np.nansum(residual.ravel() ** 2 / variance)))
        return judge(names, residual, np.diag(variance), spread, prior_term, min_det_f, notes, points)


def _chance(residual: FloatArray, covariance: FloatArray) -> float:
    """Return the probability of a Gaussian offset at least as far from zero as `residual` (3,), in mm.

    Distances are Mahalanobis distances under `covariance` (3, 3), mm^2. Components of `residual` that are NaN are
    ignored.
    """
    from scipy.stats import chi2

    measured = np.flatnonzero(np.isfinite(residual))
    score = residual[measured] @ np.linalg.solve(covariance[np.ix_(measured, measured)], residual[measured])
    return float(chi2.sf(score, max(len(measured), 1)))


def surface_fit(given: RegisterInput, points: PointData | None, start: BodyState, end: BodyState) -> SurfaceFit | None:
    """Return how far the measured surface points lie from the body before and after registration; None without points.

    `given`: checked input; `points`: the same points as data of the fit; `start`, `end`: the body before and after.
    """
    if given.surface is None or points is None:
        return None
    return SurfaceFit.of(points, given.surface, start, end)


def _forces(fit: ContactFit) -> FloatArray:
    """Return the nodal forces (n_nodes, 3), mN, of the estimated load, body forces excluded, in the tracker's frame."""
    forces = np.asarray(fit.columns.load(fit.state.coefficients).forces)
    return np.asarray(forces[: fit.columns.body.mesh.n_nodes] @ fit.state.frame.rotation.T)


__all__ = ["Answer", "Known", "known_of", "surface_fit"]
