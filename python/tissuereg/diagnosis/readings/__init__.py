"""Detection of misread recordings: other units, axes and signs of markers, commands and forces.

`suspect_recording` runs before the bank of causes is made. A reading is one interpretation of the recording, such as
"forces.csv is in N". All readings (`proposals`) are compared by one likelihood (`weigh`): that of the markers' motion
and of the forces under the linear response of the believed model to the commands.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tissuereg._base.choices import Element
from tissuereg.diagnosis.readings.proposals import AS_GIVEN, proposals
from tissuereg.diagnosis.readings.recording import recorded, responses
from tissuereg.diagnosis.readings.weigh import Agreement, WeighedReading, Weigher
from tissuereg.diagnosis.settings import DEFAULT, RecordingSettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.experiment import Experiment
from tissuereg.registration.readings.settings import COSTS


@dataclass(frozen=True)
class RecordingSuspicion:
    """One reason to suspect that the recording of an experiment is misread.

    `kind`: ``unit``, ``frame``, ``mirrored``, ``sign`` or ``silent`` (forces below their noise where the model predicts
    far larger ones); `sentence`: the reason with its evidence, which starts with the kind; `write`: what to write in
    the files; `files`: those concerned; `log_odds`: of the other reading over the input as given, nats; None where
    there is none.
    """

    kind: str
    sentence: str
    write: str
    files: tuple[str, ...]
    log_odds: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the suspicion as plain data for JSON."""
        return {**asdict(self), "files": list(self.files)}


def suspect_recording(
    experiment: Experiment,
    layout: SignalLayout,
    *,
    element: Element,
    threads: int,
    settings: RecordingSettings = DEFAULT.readings,
) -> list[RecordingSuspicion]:
    """Return the suspicion that the recording of an experiment is misread, with what to write instead.

    `element`: elements of the believed model; averaged ones stand for linear tets, unless these made the data;
    `threads`: 0 for all cores. Result: at most one suspicion; empty if the recording is plausible. A reading is
    reported if it is a thousand times likelier than the input as given, prior odds included, and explains what it
    changes. Readings that leave motion and forces unchanged cannot be distinguished.
    """
    if element == "tet4" and (experiment.simulated is None or experiment.simulated.model != "plain"):
        # Linear tets that lock have forces that are off by a factor, as those in another unit are.
        element = "tet4-averaged"
    known = responses(experiment, element=element, threads=threads, settings=settings)
    cases = recorded(experiment, layout, known, settings)
    if not cases:
        return []
    weigher = Weigher(experiment, cases, settings)
    plain = weigher.weigh(AS_GIVEN)
    kinds = {pad: kind for case in cases for pad, kind in zip(case.response.pads, case.is_motion, strict=True)}
    moved, pulled = ([pad for pad, kind in kinds.items() if kind == motion] for motion in (True, False))
    felt = list(dict.fromkeys(pad for case in cases for pad in case.felt if pad in plain.forces))
    others = [weigher.weigh(one) for one in proposals(moved, pulled, felt)]
    best = max(others, key=lambda one: one.total)
    if best.total > plain.total + COSTS.margin and _explains(best, settings):
        return [_misread(plain, best, others, settings)]
    noise = experiment.force_std or 1.0
    loud = {pad: one for pad, one in plain.forces.items() if one.predicted > settings.loud * noise}
    quiet = {pad: one for pad, one in loud.items() if one.measured < settings.quiet * noise}
    return [_silent(quiet, noise)] if quiet else []


def _explains(one: WeighedReading, settings: RecordingSettings) -> bool:
    reading = one.reading
    changed: list[Agreement] = [own for pad, own in one.forces.items() if pad in reading.forces or reading.commands]
    moves = reading.commands or "markers.csv" in reading.files or "[markers.reference]" in reading.files
    if moves and one.markers is not None:
        changed.append(one.markers)
    return bool(changed) and all(own.explained >= settings.explained for own in changed)


def _misread(
    plain: WeighedReading, best: WeighedReading, others: Sequence[WeighedReading], settings: RecordingSettings
) -> RecordingSuspicion:
    """Return the suspicion that the reading `best` is right, with those of the `others` that fit equally well."""
    reading = best.reading
    changes = [(f"the force on {pad}", plain.forces[pad], new) for pad, new in best.forces.items()]
    if best.markers is not None and plain.markers is not None:
        changes.insert(0, ("the markers' motion", plain.markers, best.markers))
    facts = [fact for change in changes if (fact := _fact(*change, settings.nothing))]
    facts = facts or ["the places without a command are then those at rest"]
    gain = best.total - plain.total
    digits, most = int(gain / np.log(10.0)), settings.most_digits
    odds = f"odds more than 10^{most} to 1" if digits > most else f"odds about 10^{digits} to 1"
    ties = [one for one in others if one is not best and one.total > best.total - COSTS.tie]
    also = f"; as good: {sorted(ties, key=lambda one: one.total)[-1].reading.words}" if ties else ""
    sentence = f"{reading.kind}: {reading.words} fits better: {'; '.join(facts)} ({odds}){also}"
    return RecordingSuspicion(reading.kind, sentence, reading.write, reading.files, gain)


def _silent(pads: Mapping[str, Agreement], noise: float) -> RecordingSuspicion:
    """Return the suspicion that pads felt nothing, for no other reading explains it; `noise`: of a force, mN."""
    predicted = max(one.predicted for one in pads.values())
    sentence = (
        f"silent: the measured force on {', '.join(pads)} is no larger than its noise ({noise:.3g} mN), where the "
        f"believed model predicts {predicted:.3g} mN (rms); no modulus follows from it"
    )
    write = "check sensor, unit and columns of forces.csv, or leave the rows of these pads out"
    return RecordingSuspicion("silent", sentence, write, ("forces.csv",))


def _fact(what: str, before: Agreement, after: Agreement, nothing: float) -> str:
    """Return what a reading changes for one channel, in words; empty where it is as far off as before."""
    if abs(before.off - after.off) < 0.05 * max(before.off, after.off):
        return ""
    told = f"{what} is then {after.off:.0%} off the believed model"
    if before.predicted < nothing * after.predicted:
        return told  # as given, all places are about the origin
    if not -0.3 < before.ratio < 0.3 and not 0.3 < before.ratio < 3.0:
        return f"{told}, as given {before.ratio:.2g} times the believed one"
    scale = f", {before.ratio:.2g} times the believed one" if 0.0 < before.ratio < 0.3 else ""
    return f"{told} instead of {before.off:.0%}{scale}"
