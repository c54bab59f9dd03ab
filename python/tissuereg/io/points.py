"""Points with names, as read from a file: in the file's frame, or converted to a given one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError

#: Millimetres in one of the UCUM units of length that a file may state.
MM_PER_UNIT = {"nm": 1e-6, "um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3}


@dataclass(frozen=True, eq=False)
class NamedPoints:
    """Points of one file.

    `file`: where they were read; `frame`: ``"LPS"`` or ``"RAS"``, that of the file; `names`: one per point, no repeats;
    `places` (n_points, 3): mm, in `frame`; NaN where a point is not defined in the file.
    """

    file: Path
    frame: str
    names: tuple[str, ...]
    places: FloatArray

    @classmethod
    def of(cls, file: Path, frame: str, points: Sequence[tuple[str, str, tuple[float, float, float]]]) -> "NamedPoints":
        """Gather points and check their names.

        `file`: where they were read; `frame`: ``"LPS"`` or ``"RAS"``; `points`: where each stands in the file in words
        ("line 4"), its name, and its place in mm; NaN = not defined. Result: in file order. Raises `FormatError` if
        there is none, or a name is empty or stands twice.
        """
        if not points:
            message = f"{file} must hold at least one point; its list is empty"
            raise FormatError(message, where=str(file))
        first: dict[str, str] = {}
        for where, name, _ in points:
            if not name:
                message = f"every point must have a label, the one at {where} of {file} has none"
                raise FormatError(message, where=f"{file}: {where}")
            if name in first:
                message = f"each label must stand in {file} once; '{name}' is at {first[name]} and {where}"
                raise FormatError(message, where=f"{file}: {where}")
            first[name] = where
        return cls(file, frame, tuple(first), np.array([place for _, _, place in points], dtype=np.float64))

    @property
    def defined(self) -> "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]":
        """Which points have a place, shape (n_points,)."""
        return np.asarray(np.isfinite(self.places).all(axis=1))

    def places_in(self, frame: str | None) -> FloatArray:
        """Return the places in another frame.

        `frame`: ``"LPS"`` or ``"RAS"``; None leaves them as they are. Result: (n_points, 3), mm.
        """
        return turned(self.places, self.frame, frame)


def turned(points: FloatArray, source: str | None, target: str | None) -> FloatArray:
    """Return points of one frame in another: LPS and RAS differ by half a turn about z.

    `points` (..., 3): places or directions in `source`; `source`, `target`: ``"LPS"`` or ``"RAS"``; None: the same as
    the other one, nothing is converted. Result: (..., 3), in `target`.

    Examples
    --------
    >>> import numpy as np
    >>> turned(np.array([1.0, -2.0, 3.0]), "RAS", "LPS")
    array([-1.,  2.,  3.])
    """
    if source is None or target is None or source == target:
        return points
    return np.asarray(points * (-1.0, -1.0, 1.0) + 0.0)  # -0.0 becomes 0.0
