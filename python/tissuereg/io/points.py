"""Named points read from a file, in the file's patient frame (LPS or RAS) or converted to the other one."""

import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Frame
from tissuereg.errors import FormatError

#: Millimetres in one of the UCUM units of length that a file may state.
MM_PER_UNIT = {"nm": 1e-6, "um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3}


@dataclass(frozen=True, eq=False)
class NamedPoints:
    """Named points of one file.

    Attributes
    ----------
    file : Path
        The file from which they were read.
    frame : {"LPS", "RAS"}
        Patient frame of the file.
    names : tuple of str
        Name of each point, as it stands in the file.
    where : tuple of str
        Where each point stands in the file, in words ("line 4").
    places : ndarray of float64, shape (n_points, 3)
        Place of each point in mm, in `frame`; NaN where the file does not define it.
    """

    file: Path
    frame: Frame
    names: tuple[str, ...]
    where: tuple[str, ...]
    places: FloatArray

    @classmethod
    def of(
        cls, file: Path, frame: Frame, points: Sequence[tuple[str, str, tuple[float, float, float]]]
    ) -> "NamedPoints":
        """Make the named points of a file from a list.

        `file`: the file from which they were read; `frame`: ``"LPS"`` or ``"RAS"``; `points`: for each point, where it
        stands in the file in words ("line 4"), its name, and its place in mm, which is NaN if it is not defined. The
        order is kept. Raises `FormatError` if there is none.
        """
        if not points:
            message = f"{file} must hold at least one point; its list is empty"
            raise FormatError(message, where=str(file))
        where, names, places = zip(*points, strict=True)
        # An accent may be a character of its own (as on macOS): such labels look the same and are.
        same = tuple(unicodedata.normalize("NFC", name) for name in names)
        return cls(file, frame, same, where, np.array(places, dtype=np.float64))

    def labelled(self) -> "NamedPoints":
        """Return the points after checking that each has a name of its own; raise `FormatError` otherwise."""
        first: dict[str, str] = {}
        for where, name in zip(self.where, self.names, strict=True):
            if not name:
                message = f"every point must have a label, the one at {where} of {self.file} has none"
                raise FormatError(message, where=f"{self.file}: {where}")
            if name in first:
                message = f"each label must stand in {self.file} once; '{name}' is at {first[name]} and {where}"
                raise FormatError(message, where=f"{self.file}: {where}")
            first[name] = where
        return self

    @property
    def defined(self) -> "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]":
        """Whether the file defines the place of each point, boolean (n_points,)."""
        return np.asarray(np.isfinite(self.places).all(axis=1))

    def places_in(self, frame: Frame | None) -> FloatArray:
        """Return the places of the points in a patient frame, (n_points, 3), in mm.

        `frame`: ``"LPS"`` or ``"RAS"``; None for the frame of the file.
        """
        return turned(self.places, self.frame, frame)


def turned(points: FloatArray, source: str | None, target: str | None) -> FloatArray:
    """Convert points or directions between the patient frames LPS and RAS, which differ by half a turn about z.

    `points` (..., 3): coordinates in the frame `source`, in any unit; `source`, `target`: ``"LPS"`` or ``"RAS"``; if
    one of them is None, nothing is converted. Result: (..., 3), coordinates in the frame `target`, in the same unit.

    Examples
    --------
    >>> import numpy as np
    >>> turned(np.array([1.0, -2.0, 3.0]), "RAS", "LPS")
    array([-1.,  2.,  3.])
    """
    if source is None or target is None or source == target:
        return points
    return np.asarray(points * (-1.0, -1.0, 1.0) + 0.0)  # -0.0 becomes 0.0
