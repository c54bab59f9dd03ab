"""Options of commands that read a tracker's recording: how it is read, aligned to the body, and what its noise is."""

import argparse
import contextlib
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.fields import choice, number
from tissuereg.cli.body_input import only_given
from tissuereg.cli.options import add_option, refuse
from tissuereg.io.points import MM_PER_UNIT
from tissuereg.report.words import counted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tissuereg._base.choices import Frame
    from tissuereg.body.markers import Markers
    from tissuereg.io.recordings import Recording
    from tissuereg.tracking import Alignment, Tracker


def add_recording_options(group: Any) -> None:
    """Add the options for files of trackers to an argparse group."""
    text = (
        "what the columns of another table hold, such as 'time=Time (Seconds) x=X y=Y z=Z unit=mm', with marker=NAME "
        "where each row is one marker's, or tip.x=X1 tip.y=Y1 tip.z=Z1 where a row holds several"
    )
    group.add_argument("--columns", metavar="MAP", help=text)
    add_offset_option(group)
    text = "join markers without names by place: each marker of the reference is the one that begins as near to it"
    add_option(group, "--nearest", number(text, unit="mm", above=0.0, default=None, otherwise="by --match"), "MM")
    text = "frames a second of a file that numbers its frames"
    add_option(group, "--rate", number(text, unit="1/s", above=0.0, default=None, otherwise="its times"), "HZ")
    text = "unit of length of a file that states none"
    add_option(group, "--unit", choice(tuple(MM_PER_UNIT), text, default=None, otherwise="that stated"))
    text = (
        "align the tracker's frame to the body's: 'first', by the reference markers of the first frames, of the "
        "undeformed body; or table point,x_mm,y_mm,z_mm,tracker_x_mm,tracker_y_mm,tracker_z_mm of three points or more"
    )
    group.add_argument("--align", metavar="first|FILE", help=text)


def add_offset_option(group: Any) -> None:
    """Add the option ``--offset``: where the marker sits on a tool, by its name."""
    text = (
        "place of the marker on a tool, in the tool's coordinates, mm; may be given for several (default: its origin)"
    )
    group.add_argument("--offset", action="append", type=_offset, metavar="'TOOL X Y Z'", help=text, default=[])


def read_recorded(
    args: argparse.Namespace, markers: "Markers", frames: "Mapping[str, Frame | None]"
) -> "tuple[Recording, Markers, Alignment | None]":
    """Return the recording of the markers in the body's frame, the markers with their noise, and the alignment.

    `frames`: patient frames of the answer and of tables.
    """
    found = _whole(args)
    if args.nearest is None:
        found = found.of(markers.names, **only_given(match=args.match))
        markers = _noise_of(args, found, markers)
        found, alignment = _aligned(args, found, markers, frames)
        return found, markers, alignment
    if args.match is not None or args.align == "first":
        refuse("--nearest must come without --match and with points for --align: markers without names", "--nearest")
    found, alignment = _aligned(args, found, markers, frames)
    found = found.nearest(markers.names, markers.reference, args.nearest)
    return found, _noise_of(args, found, markers), alignment


def read_replayed(args: argparse.Namespace, markers: "Markers") -> "Recording":
    """Return the frames that ``tissuereg live`` registered, of its recording ``--replay``, in the mesh's frame."""
    from tissuereg.io.recordings import read_recording

    given = [name for name in _OF_OTHERS if getattr(args, name) not in (None, False, [])]
    if given:
        option = f"--{given[0]}"
        refuse(f"--replay must come without {option}: what 'live' recorded is in the mesh's frame, and of it", option)
    found = read_recording(args.replay)
    if found.registered is None:
        refuse("--replay must be a recording of 'tissuereg live'; others are MARKERS", "--replay")
    if not found.registered.any():
        refuse("--replay must hold a frame that was registered, got none", "--replay")
    left = int((~found.registered).sum())
    kept = found.of(markers.names).only(found.registered)
    return (
        kept.placed(kept.places, f"{counted(left, 'frame')} left out, which 'live' did not register") if left else kept
    )


#: Options of recordings that a replay cannot have.
_OF_OTHERS = ("columns", "offset", "nearest", "rate", "unit", "align", "match", "live", "simulations")


def warm_up(tracker: "Tracker") -> None:
    """Register the body at rest and forget it, so that the first frame does not wait for what is made once."""
    from tissuereg.tracking.tracker import CANNOT_BE_REGISTERED

    with contextlib.suppress(*CANNOT_BE_REGISTERED):
        tracker.step(tracker.registrar.markers.reference, 0.0)
    tracker.reset()


def _whole(args: argparse.Namespace) -> "Recording":
    """Return all that a file records; of one that was made live, the frames that were registered then."""
    from tissuereg.io.recordings import read_recording

    offsets = dict(args.offset)
    found = read_recording(args.recording, columns=args.columns, offsets=offsets, rate_hz=args.rate, unit=args.unit)
    if found.registered is None or found.registered.all():
        return found
    left = int((~found.registered).sum())
    return found.only(found.registered).placed(
        found.places[found.registered], f"{left} frames that came too fast to be registered live are left out"
    )


def _noise_of(args: argparse.Namespace, recording: "Recording", markers: "Markers") -> "Markers":
    """Return the markers with the noise that the tracker states, where neither ``--std`` nor their file states one."""
    from tissuereg.body.markers import Markers
    from tissuereg.io.bounds import FILES
    from tissuereg.io.tables import read_reference

    if recording.std is None or args.std is not None:
        return markers
    spread = markers.axis_std.copy()
    # What the file states itself does not depend on what stands for the rest.
    open_to = read_reference(args.reference, 2.0 * FILES.std_mm).axis_std != spread
    for i in range(len(markers)):
        stated = recording.std[np.isfinite(recording.std[:, i]), i]
        if len(stated):
            spread[i, open_to[i]] = np.sqrt(np.mean(stated**2))
    return Markers(markers.reference, markers.measured, spread, markers.names)


def _aligned(
    args: argparse.Namespace, recording: "Recording", markers: "Markers", frames: "Mapping[str, Frame | None]"
) -> "tuple[Recording, Alignment | None]":
    """Return the recording in the body's frame, and how the tracker's was aligned to it, if ``--align`` says so.

    `frames`: patient frames of the answer and of tables; a recording that is aligned is in neither.
    """
    from tissuereg.io.tables import read_pairs
    from tissuereg.tracking.align import rigid_alignment

    if args.align is None:
        return recording.in_frame(frames["frame"], frames["table_frame"]), None
    noise = float(np.sqrt(np.mean(markers.axis_std**2)))
    if args.align == "first":
        found = rigid_alignment(recording.first_places(), markers.reference, markers.names, std=noise)
    else:
        names, tracker, body = read_pairs(args.align, **frames)
        found = rigid_alignment(tracker, body, names, std=noise)
    count = len(found.residual_mm)
    text = f"the tracker's frame was aligned to the body's by {count} points, rms residual {found.rms_mm:.3g} mm"
    return recording.placed(found.apply(recording.places), text), found


def _offset(text: str) -> tuple[str, tuple[float, ...]]:
    words = text.split()
    try:
        place = tuple(float(word) for word in words[-3:])
    except ValueError:
        place = ()
    if len(words) < 4 or len(place) != 3 or not np.isfinite(place).all():
        message = f"must be a tool and three numbers, 'TOOL X Y Z', got '{text}'"
        raise argparse.ArgumentTypeError(message)
    return " ".join(words[:-3]), place
