"""Decision whether a recording is misread: `suspect_recording` weighs all readings against the input as given."""

from tissuereg._base.choices import Element
from tissuereg.diagnosis.readings.proposals import AS_GIVEN, proposals
from tissuereg.diagnosis.readings.recording import recorded
from tissuereg.diagnosis.readings.response import responses
from tissuereg.diagnosis.readings.settings import RECORDINGS, RecordingSettings
from tissuereg.diagnosis.readings.weigh import Agreement, WeighedReading, Weigher
from tissuereg.diagnosis.readings.words import RecordingSuspicion, misread, silent
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.experiment import Experiment
from tissuereg.registration.readings.settings import COSTS


def suspect_recording(
    experiment: Experiment,
    layout: SignalLayout,
    *,
    element: Element,
    threads: int,
    settings: RecordingSettings = RECORDINGS,
) -> list[RecordingSuspicion]:
    """Return the suspicion that the recording of an experiment is misread, with what to write instead.

    `experiment`: the believed model and the measurements; `layout`: order of the measurements; `element`: elements of
    the believed model; `threads`: threads to use, 0 for all cores; `settings`: how readings are weighed. Result: at
    most one suspicion; empty if the recording is plausible. A reading is reported if it is a thousand times likelier
    than the input as given, prior odds included, and explains what it changes. Readings that leave motion and forces
    unchanged cannot be distinguished.
    """
    cases = recorded(
        experiment, layout, responses(experiment, element=element, threads=threads, settings=settings), settings
    )
    if not cases:
        return []
    weigher = Weigher(experiment, cases, settings)
    plain = weigher.weigh(AS_GIVEN)
    kinds = {
        name: kind for case in cases for name, kind in zip(case.response.pads, case.is_motion.tolist(), strict=True)
    }
    felt = tuple(dict.fromkeys(pad for case in cases for pad in case.felt if pad in plain.forces))
    moved = [name for name, kind in kinds.items() if kind]
    others = [weigher.weigh(one) for one in proposals(moved, [name for name in kinds if name not in moved], felt)]
    best = max(others, key=lambda one: one.total)
    if best.total > plain.total + COSTS.margin and _explains(best, settings):
        return [misread(plain, best, others, settings)]
    noise = experiment.force_std or 1.0
    quiet = [
        pad
        for pad, one in plain.forces.items()
        if one.predicted > settings.loud * noise and one.measured < settings.quiet * noise
    ]
    return [silent(quiet, plain, noise)] if quiet else []


def _explains(one: WeighedReading, settings: RecordingSettings) -> bool:
    reading = one.reading
    changed: list[Agreement] = [own for pad, own in one.forces.items() if pad in reading.forces or reading.commands]
    moves = reading.commands or "markers.csv" in reading.files or "[markers.reference]" in reading.files
    if moves and one.markers is not None:
        changed.append(one.markers)
    return bool(changed) and all(own.explained >= settings.explained for own in changed)
