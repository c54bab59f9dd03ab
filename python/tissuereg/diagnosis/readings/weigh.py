"""The likelihood of a reading: how far the recording is then from the linear response of the believed model.

A channel of a case (its markers, or the force on one pad) differs from the prediction by noise and by an error of the
model, which is a share of the prediction's root mean square. The share is unknown and integrated out, as is the factor
on the modulus, with its prior. Frames, and markers beyond a few, count as one: the model's error is the same in them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.observe import MarkerObservation
from tissuereg.diagnosis.readings.proposals import RecordingReading
from tissuereg.diagnosis.readings.recording import Recorded
from tissuereg.diagnosis.settings import RecordingSettings
from tissuereg.errors import MarkerError
from tissuereg.experiment.experiment import Experiment
from tissuereg.registration.readings.likelihood import standoff
from tissuereg.registration.readings.skin import skin_of


@dataclass(frozen=True)
class Agreement:
    """Agreement of one kind of channel, over all cases, with the prediction under a reading.

    `explained`: share of the squares beyond the noise that the prediction explains; 0 where they are not above it;
    `off`: root mean square of measured minus predicted, over that of the prediction; `ratio`: factor by which the
    measured numbers are those at the believed modulus, by least squares; `predicted`, `measured`: root mean squares, mm
    or mN.
    """

    explained: float
    off: float
    ratio: float
    predicted: float
    measured: float


@dataclass(frozen=True, eq=False)
class WeighedReading:
    """A reading with its log likelihood plus log prior odds (`total`, nats), and the agreement by kind of channel.

    `markers` is None where no motion was measured; `forces` is by pad.
    """

    reading: RecordingReading
    total: float
    markers: Agreement | None
    forces: dict[str, Agreement]


@dataclass(frozen=True, eq=False)
class _Compared:
    """One channel of one case as sums over its `n` numbers, which count as `weight`.

    `products`: of measured (y), moved (m) and pulled (p) predictions: yy, ym, yp, mm, mp, pp.
    """

    n: int
    weight: float
    log_factor: float
    products: tuple[float, ...]

    def at(self, moved: FloatArray | float, pulled: FloatArray | float) -> tuple[FloatArray, FloatArray]:
        """Return squares of measured minus predicted, and of predicted, for factors on both predictions."""
        yy, ym, yp, mm, mp, pp = self.products
        power = np.asarray(moved**2 * mm + 2.0 * moved * pulled * mp + pulled**2 * pp)
        return np.maximum(yy - 2.0 * (moved * ym + pulled * yp) + power, 0.0), power

    def nats(self, noise: float, moved: FloatArray, pulled: FloatArray, errors: Sequence[float]) -> FloatArray:
        """Return the log likelihood (n_factors, n_shares); `noise`: standard deviation, mm or mN."""
        rest, power = self.at(moved, pulled)
        variance = noise**2 + np.square(errors) * power[:, None] / self.n
        nats = -0.5 * (rest[:, None] / self.n / variance + np.log(variance))
        return np.asarray(self.weight * (nats + self.log_factor))


class Weigher:
    """Weighs readings of one experiment; `cases`: what was recorded in its cases."""

    def __init__(self, experiment: Experiment, cases: Sequence[Recorded], settings: RecordingSettings) -> None:
        self._settings = settings
        self._experiment, self._cases = experiment, cases
        self._extent = experiment.mesh.extent
        self._force_std = experiment.force_std or 1.0
        believed = float(experiment.material.young_array.mean())
        spread = max((experiment.young_std or 0.0) / believed, settings.modulus_std)
        steps = np.linspace(-settings.moduli_within, settings.moduli_within, settings.n_moduli)
        self._factors = np.exp(spread * steps)
        self._prior = -0.5 * steps**2 - np.logaddexp.reduce(-0.5 * steps**2)
        self._seen: dict[bytes, tuple[float, list[FloatArray] | None]] = {}

    def weigh(self, reading: RecordingReading) -> WeighedReading:
        """Return a reading with its log likelihood, prior odds included, and the agreement of its channels."""
        near, fields = self._at(reading.places)
        markers: list[_Compared] = []
        forces: dict[str, list[_Compared]] = {}
        for number, case in enumerate(self._cases):
            pairs = zip(case.response.pads, case.commands, strict=True)
            turned = [given @ reading.commands[pad].T if pad in reading.commands else given for pad, given in pairs]
            field, commands = None if fields is None else fields[number], np.stack(turned)
            markers += _markers(case, commands, field, reading.markers, self._settings.markers)
            for pad, one in _forces(case, commands, reading):
                forces.setdefault(pad, []).append(one)
        nats, ones = self._prior.copy(), np.ones_like(self._factors)
        felt = [one for parts in forces.values() for one in parts]
        # A stiffer body moves less under given forces, and needs larger forces for a given motion.
        for parts, noise, moved, pulled in (
            (markers, self._experiment.marker_std, ones, 1.0 / self._factors),
            (felt, self._force_std, self._factors, ones),
        ):
            if parts:
                each = [one.nats(noise, moved, pulled, self._settings.errors) for one in parts]
                nats += np.logaddexp.reduce(sum(each), axis=1)
        factor = float(self._factors[np.argmax(nats)])
        return WeighedReading(
            reading,
            float(np.logaddexp.reduce(nats)) + near + self._resting(reading) - reading.cost,
            _agreement(markers, self._experiment.marker_std, 1.0, 1.0 / factor) if markers else None,
            {pad: _agreement(parts, self._force_std, factor, 1.0) for pad, parts in forces.items()},
        )

    def _at(self, turn: FloatArray) -> tuple[float, list[FloatArray] | None]:
        """Return the log likelihood of places turned by (3, 3), and the response at them by case, None off the body."""
        key = turn.tobytes()
        if key not in self._seen:
            places = self._experiment.marker_reference @ turn.T
            outside = np.maximum(skin_of(self._experiment.mesh).closest(places).distance, 0.0)
            off = float(np.mean((outside / standoff(self._extent)) ** 2))
            near = -min(0.5 * min(len(places), self._settings.markers) * off, self._settings.most_nats)
            self._seen[key] = near, self._observed(places) if near > -self._settings.most_nats else None
        return self._seen[key]

    def _observed(self, places: FloatArray) -> list[FloatArray] | None:
        try:
            seen = MarkerObservation(self._experiment.mesh, places, self._experiment.marker_names)
        except MarkerError:
            return None
        found = []
        for fields in (case.response.fields for case in self._cases):
            # The motion of a marker off the surface is linear for small commands alone.
            small = 1e-6 * self._extent / max(float(np.abs(fields).max()), 1e-300)
            flat = (small * fields).reshape(-1, *fields.shape[2:])
            found.append(seen.predict(flat[:, seen.nodes]).reshape(*fields.shape[:2], -1, 3) / small)
        return found

    def _resting(self, reading: RecordingReading) -> float:
        """Return the log likelihood of the measured places without a command."""
        size, worst = self._settings.places * self._extent, 0.0
        for case in self._cases:
            off = case.rest @ reading.markers.T - self._experiment.marker_reference @ reading.places.T
            off = off[np.isfinite(case.rest).all(axis=1)]
            if len(off):
                mean = float(np.mean((off / size) ** 2))
                worst = max(worst, 1.5 * min(len(off), self._settings.markers) * mean)
        return -min(worst, self._settings.most_nats)


def _markers(
    case: Recorded, commands: FloatArray, field: FloatArray | None, turn: FloatArray, most: int
) -> list[_Compared]:
    measured = case.motion @ turn.T
    seen = np.isfinite(measured)
    if not seen.any():
        return []
    counted = 3.0 * min(int(seen.any(axis=(0, 2)).sum()), most)
    if field is None:
        # Markers off the body move for no reason that the model knows.
        power = float(measured[seen] @ measured[seen])
        return [_Compared(int(seen.sum()), counted, _log_factor(turn), (power, 0.0, 0.0, power, 0.0, 0.0))]
    return [_compared(case, measured, np.einsum("pfa,pamx->pfmx", commands, field), counted, turn)]


def _forces(case: Recorded, commands: FloatArray, reading: RecordingReading) -> list[tuple[str, _Compared]]:
    found = []
    for i, pad in enumerate(case.felt):
        turn = reading.forces.get(pad, np.eye(3))
        measured = case.forces[:, i] @ turn.T
        if np.isfinite(measured).any():
            by_pad = np.einsum("pfa,pax->pfx", commands, case.response.forces[pad])
            found.append((pad, _compared(case, measured, by_pad, 3.0, turn)))
    return found


def _compared(case: Recorded, measured: FloatArray, by_pad: FloatArray, counted: float, turn: FloatArray) -> _Compared:
    """Return a channel as sums; `by_pad` (n_pads, ...): what the command of each pad changes in it."""
    seen = np.isfinite(measured)
    y = measured[seen]
    m, p = (by_pad[rows].sum(axis=0)[seen] for rows in (case.is_motion, ~case.is_motion))
    products = tuple(float(a @ b) for a, b in ((y, y), (y, m), (y, p), (m, m), (m, p), (p, p)))
    return _Compared(y.size, counted, _log_factor(turn), products)


def _agreement(parts: Sequence[_Compared], noise: float, moved: float, pulled: float) -> Agreement:
    n, measured = sum(one.n for one in parts), sum(one.products[0] for one in parts)
    rest, power = (float(sum(each)) for each in zip(*(one.at(moved, pulled) for one in parts), strict=True))
    at_believed = float(sum(one.at(1.0, 1.0)[1] for one in parts))
    common = sum(one.products[1] + one.products[2] for one in parts)
    above = measured > 4.0 * n * noise**2
    return Agreement(
        1.0 - max(rest - n * noise**2, 0.0) / (measured - n * noise**2) if above else 0.0,
        float(np.sqrt(rest / power)) if power > 0.0 else np.inf,
        common / at_believed if at_believed > 0.0 else np.inf,
        float(np.sqrt(power / n)),
        float(np.sqrt(measured / n)),
    )


def _log_factor(turn: FloatArray) -> float:
    return float(np.log(abs(np.linalg.det(turn)))) / 3.0
