"""A recording of markers: what every reader returns, its clock checked, and its markers joined with a reference."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import Any, NamedTuple, NoReturn

import numpy as np

from tissuereg._base.arguments import check_choice, real, texts
from tissuereg._base.arrays import BoolArray, FloatArray, float_array, frozen
from tissuereg._base.choices import MATCHES, Match
from tissuereg._base.provenance import derived
from tissuereg.errors import FormatError
from tissuereg.io.matching import Labels, finder, partners
from tissuereg.io.points import turned


class ClockSettings(NamedTuple):
    """When a clock is believed, and where a recording begins.

    `jump`: steps of time beyond this many median ones are told; `most_lost`: largest share of frames that may have to
    be left out since the clock ran back or stood still; `told`: most frames that the notes name one by one; `begin`:
    first frames of a recording, whose median is where it begins.
    """

    jump: float = 5.0
    most_lost: float = 0.1
    told: int = 20
    begin: int = 10


CLOCK = ClockSettings()


class ClockFault(NamedTuple):
    """A frame whose time does not follow that of the frame before.

    `frame`: its number in the file, from 1; `time_s`: its time, s; `kind`: ``back`` (behind a time before it) and
    ``repeat`` (the time of the frame before), for which it is left out, or ``jump`` (much later), where it is kept.
    """

    frame: int
    time_s: float
    kind: str


@dataclass(frozen=True, eq=False)
class Recording:
    """Measured places of markers over many frames of a tracker; iterating gives pairs ``(time_s, measured_mm)``.

    `Tracker.run` takes a recording as its frames.

    Attributes
    ----------
    times : ndarray of float64, shape (n_frames,)
        Time of each frame, s, ascending.
    names : tuple of str
        Name of each marker, without repeats.
    places : ndarray of float64, shape (n_frames, n_markers, 3)
        Measured places in mm, in the tracker's frame; NaN where a marker was not measured.
    std : ndarray of float64, shape (n_frames, n_markers), or None
        Standard deviation of a coordinate that the tracker states, mm, NaN where it states none; None if it never does.
    up : {"x", "y", "z"} or None
        Axis that points up in the tracker's frame, where its format says so.
    format : str
        Format of the file, in words.
    clock : tuple of ClockFault
        Frames whose times do not follow those before.
    notes : tuple of str
        What a user should know of how the file was read: what was left out, joined or taken for missing.
    registered : ndarray of bool, shape (n_frames,), or None
        Of a recording of `tissuereg live`: which frames it registered, the others came too fast; None otherwise.
    file : str
        The file, for messages.
    where : tuple of str
        Where each name stands first in the file, in words; empty where that is of no use.
    listed : int
        Number of names that the first frame lists, by which markers are joined by order.
    received : ndarray of float64, shape (n_frames,), or None
        Of a recording of `tissuereg live`: when each frame had come, s, by a clock that never jumps.
    answers : tuple of str or None
        Of such a recording: digest of each frame's answer, ``failed``, or empty; `tissuereg track --replay` compares.
    numbered : tuple of str
        Names that were made up for unlabelled tracks, in the order in which these appear: their numbers say nothing.
    """

    times: FloatArray
    names: tuple[str, ...]
    places: FloatArray
    std: FloatArray | None = None
    up: str | None = None
    format: str = ""
    clock: tuple[ClockFault, ...] = ()
    notes: tuple[str, ...] = ()
    registered: BoolArray | None = None
    file: str = ""
    where: tuple[str, ...] = field(default=(), repr=False)
    listed: int = 0
    received: FloatArray | None = field(default=None, repr=False)
    answers: tuple[str, ...] | None = field(default=None, repr=False)
    numbered: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.times)

    def __iter__(self) -> Iterator[tuple[float, FloatArray]]:
        return zip(self.times.tolist(), self.places, strict=True)

    def of(self, names: Sequence[str], match: Match = "label") -> "Recording":
        """Return the recording of the markers `names`, in this order; those that it does not hold are never seen.

        Parameters
        ----------
        names : sequence of str
            The markers, as the reference names them.
        match : {"label", "order", "number"}
            Which markers of the file these are: those of the same name, the first and so on, or those with the same
            last number in their names.

        Returns
        -------
        Recording
            With these names; what was left out is in its notes.

        Raises
        ------
        FormatError
            If no marker of the file is one of them, two are the same, a table of `tissuereg` holds another one, or they
            would be joined by numbers that were made up.
        ArgumentError
            If `names` are not texts that differ.
        """
        check_choice("match", match, MATCHES, FormatError)
        names = texts("names", names, length=max(len(names), 1) if isinstance(names, list | tuple) else 1)
        sit = Labels("the reference", names)
        taken = list(range(self.listed)) if match == "order" else self._known(sit, match)
        made_up = [self.names[i] for i in taken if self.names[i] in self.numbered]
        if made_up and match == "number":
            taken = [i for i in taken if self.names[i] not in made_up]
            if not taken:
                message = (
                    f"numbers that join markers must be those of names; those of {listed(made_up)} in {self.file} were "
                    "made up, in the order in which unlabelled tracks appear: join them by place with --nearest"
                )
                raise FormatError(message, where=self.file)
        rows = partners(sit, Labels(self.file, [self.names[i] for i in taken], [self._at(i) for i in taken]), match)
        if match == "order" and self.listed < len(self.names):
            message = (
                f"every marker must be one of the first frame ({', '.join(self.names[: self.listed])}), got "
                f"'{self.names[self.listed]}' at {self._at(self.listed)} of {self.file}"
            )
            raise FormatError(message, where=self.file)
        found = self._joined(names, rows, taken)
        if made_up and match != "number":
            note = (
                f"{listed(made_up)} are unlabelled tracks in the order in which they appear, which may be another one "
                "in the next recording: --nearest joins them by place"
            )
            found = replace(found, notes=(*found.notes, note))
        return found

    def nearest(self, names: Sequence[str], reference_mm: Any, within_mm: float) -> "Recording":
        """Return the recording of the markers `names`, each the one that begins near its place in the reference.

        For markers that a tracker does not know by name; the places of the recording are those of the body's frame.

        Parameters
        ----------
        names : sequence of str
            The markers, as the reference names them.
        reference_mm : array_like of float, shape (n_markers, 3)
            Their places on the undeformed body, mm.
        within_mm : float
            Largest distance of a marker's first places from there, mm.

        Returns
        -------
        Recording
            With these names; those without a marker of the file near them are never seen, which its notes say.

        Raises
        ------
        FormatError
            If no marker begins near one of them, or two of either side are so near that they may be exchanged.
        ArgumentError, ShapeError
            If an argument has the wrong type or shape, or is out of its range.
        """
        names = texts("names", names, length=max(len(names), 1) if isinstance(names, list | tuple) else 1)
        reference = float_array("reference_mm", reference_mm, (len(names), 3))
        within = real("within_mm", within_mm, above=0.0, unit="mm")
        away = np.linalg.norm(reference[:, None] - self.first_places()[None], axis=2)
        near = np.nan_to_num(away, nan=np.inf) <= within
        for i in np.flatnonzero(near.sum(axis=1) > 1):
            self._refuse_near(f"'{names[i]}'", [self.names[k] for k in np.flatnonzero(near[i])], within)
        for k in np.flatnonzero(near.sum(axis=0) > 1):
            self._refuse_near(f"'{self.names[k]}' of the file", [names[i] for i in np.flatnonzero(near[:, k])], within)
        rows, taken = (found.tolist() for found in np.nonzero(near))
        if not rows:
            closest = "" if np.isnan(away).all() else f"; the closest is {np.nanmin(away):.3g} mm away"
            message = f"a marker of {self.file} must begin within {within:g} mm of one of the reference{closest}"
            raise FormatError(message, where=self.file)
        pairs = listed([f"{names[i]} is {self.names[k]}" for i, k in zip(rows, taken, strict=True)])
        found = self._joined(names, rows, taken)
        return replace(found, notes=(*found.notes, f"joined by place, within {within:g} mm: {pairs}"))

    def first_places(self) -> FloatArray:
        """Return the median place (n_markers, 3) of each marker in the first ten frames, mm, NaN where not seen."""
        begin = self.places[: CLOCK.begin]
        found = np.full(begin.shape[1:], np.nan)
        for i in range(begin.shape[1]):
            seen = begin[np.isfinite(begin[:, i]).all(axis=1), i]
            if len(seen):
                found[i] = np.median(seen, axis=0)
        return found

    def _refuse_near(self, one: str, others: list[str], within: float) -> NoReturn:
        message = f"{one} must have one partner within {within:g} mm, got {listed(others)}: choose a smaller distance"
        raise FormatError(message, where=self.file)

    def _joined(self, names: tuple[str, ...], rows: list[int], taken: list[int]) -> "Recording":
        """Return the recording of `names`, where those of the numbers `rows` are the file's of the numbers `taken`."""
        places = np.full((len(self), len(names), 3), np.nan)
        places[:, rows] = self.places[:, taken]
        std = None if self.std is None else np.full((len(self), len(names)), np.nan)
        if std is not None and self.std is not None:
            std[:, rows] = self.std[:, taken]
        left = [name for i, name in enumerate(self.names) if i not in taken]
        told = [f"left out, since the reference does not name them: {listed(left)}"] if left else []
        absent = [name for i, name in enumerate(names) if i not in rows]
        told += [f"never seen, since the file does not name them: {listed(absent)}"] if absent else []
        joined = replace(
            self,
            names=names,
            places=frozen(places),
            std=std,
            notes=(*self.notes, *told),
            where=(),
            listed=len(names),
            numbered=(),
        )
        return derived(joined, self)

    def placed(self, places: FloatArray, *notes: str) -> "Recording":
        """Return the recording with other `places` (n_frames, n_markers, 3), mm, and further notes."""
        return derived(replace(self, places=frozen(places), notes=(*self.notes, *notes)), self)

    def in_frame(self, frame: str | None, own: str | None) -> "Recording":
        """Return the recording in the patient frame `frame`, its numbers being in `own`; itself if one is None."""
        return self if frame in (None, own) or own is None else self.placed(turned(self.places, own, frame))

    def only(self, kept: BoolArray) -> "Recording":
        """Return the recording of the frames that a mask (n_frames,) selects."""
        std = None if self.std is None else self.std[kept]
        live = None if self.registered is None else self.registered[kept]
        received = None if self.received is None else self.received[kept]
        answers = None if self.answers is None else tuple(compress(self.answers, kept))
        part = replace(
            self,
            times=self.times[kept],
            places=self.places[kept],
            std=std,
            registered=live,
            received=received,
            answers=answers,
        )
        return derived(part, self)

    def _known(self, sit: Labels, match: Match) -> list[int]:
        """Return the numbers of the markers of the file that the reference names; all, if it must name all."""
        if self.where:
            return list(range(len(self.names)))
        find = finder(sit, match)
        known = [i for i, name in enumerate(self.names) if find(name) is not None]
        return known or list(range(len(self.names)))  # of which the first is refused

    def _at(self, i: int) -> str:
        return self.where[i] if self.where else "its columns"


def checked_clock(times: FloatArray) -> tuple[BoolArray, tuple[ClockFault, ...]]:
    """Return which frames are kept, boolean (n_frames,), and those whose times do not follow; `times` (n_frames,), s.

    Raises `FormatError` if a time is not finite, or the clock runs back or stands still so often that it is no clock.
    """
    if not np.isfinite(times).all():
        message = f"every frame must have a finite time; frame {int(np.argmin(np.isfinite(times))) + 1} has none"
        raise FormatError(message)
    latest = np.concatenate([[-np.inf], np.maximum.accumulate(times)[:-1]])
    kept = np.asarray(times > latest)
    faults = [
        ClockFault(int(i) + 1, float(times[i]), "repeat" if times[i] == latest[i] else "back")
        for i in np.flatnonzero(~kept)
    ]
    if len(faults) > CLOCK.most_lost * len(times):
        first = faults[0]
        message = (
            f"time must advance from frame to frame; {len(faults)} of {len(times)} frames are not later than one "
            f"before them, the first is frame {first.frame} at {first.time_s:.9g} s: cut the recording where its clock "
            "begins anew"
        )
        raise FormatError(message)
    rows = np.flatnonzero(kept)
    steps = np.diff(times[rows])
    late = rows[1:][steps > CLOCK.jump * np.median(steps)] if len(steps) else rows[:0]
    faults += [ClockFault(int(i) + 1, float(times[i]), "jump") for i in late]
    return kept, tuple(sorted(faults))


def clock_notes(faults: Sequence[ClockFault]) -> list[str]:
    """Return what a user should know of the clock, frame by frame, and how many more there are."""
    words = {
        "back": "runs back behind a frame before it; the frame is left out",
        "repeat": "repeats the time of the frame before; the frame is left out",
        "jump": "jumps ahead",
    }
    told = [f"clock: frame {one.frame} at {one.time_s:.9g} s {words[one.kind]}" for one in faults[: CLOCK.told]]
    more = len(faults) - len(told)
    return [*told, f"clock: {more} more such frames"] if more else told


def listed(names: Sequence[str]) -> str:
    """Return names in a row, the first of many."""
    return ", ".join(names[: CLOCK.told]) + (f" and {len(names) - CLOCK.told} more" if len(names) > CLOCK.told else "")
