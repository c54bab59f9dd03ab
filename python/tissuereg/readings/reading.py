"""One way to read the input: what the numbers would mean, and how unlikely such a mistake is beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg._arrays import BoolArray, FloatArray, IntArray
from tissuereg.markers import Markers
from tissuereg.mesh import Mesh
from tissuereg.readings.skin import Skin, skin_of

#: The noise of a coordinate is taken to be at most this many mm: beyond it a statement about units is likelier wrong.
_LARGEST_NOISE_MM = 2.0


@dataclass(frozen=True, eq=False)
class Given:
    """The input as it was given, with what readings of it need.

    Attributes
    ----------
    skin : Skin
        Surface of the body.
    held_nodes : ndarray of float64, shape (n_held, 3)
        Places of the held nodes, mm.
    names : tuple of str
        Of the markers.
    reference, measured : ndarray of float64, shape (n_markers, 3)
        mm; NaN = not seen.
    motion : ndarray of float64, shape (n_markers, 3)
        Measured minus reference, mm.
    noise : float
        Median standard deviation of a measured coordinate, mm.
    """

    skin: Skin
    held_nodes: FloatArray
    names: tuple[str, ...]
    reference: FloatArray
    measured: FloatArray
    motion: FloatArray
    noise: float

    @classmethod
    def of(cls, mesh: Mesh, markers: Markers, rows: IntArray) -> "Given":
        """Return the input of some of the markers."""
        skin = skin_of(mesh)
        return cls(
            skin,
            mesh.nodes[skin.held],
            tuple(markers.names[i] for i in rows),
            markers.reference[rows],
            markers.measured[rows],
            markers.displacement[rows],
            min(float(np.median(markers.std[rows])), _LARGEST_NOISE_MM),
        )

    @property
    def complete(self) -> BoolArray:
        """Which markers were seen with all three coordinates, shape (n_markers,)."""
        return np.asarray(np.isfinite(self.measured).all(axis=1))


@dataclass(frozen=True, eq=False)
class Reading:
    """One candidate.

    Attributes
    ----------
    kind : str
        First word of the sentence.
    words : str
        What to do with the input.
    cost : float
        Minus the logarithm of the odds of such a mistake beforehand.
    places : ndarray of float64, shape (n_markers, 3)
        Places beside the undeformed body under this reading, mm.
    motion : ndarray of float64, shape (n_markers, 3)
        Displacements under this reading, mm, possibly in a turned frame; NaN = not seen.
    arms : ndarray of float64, shape (n_markers, 3)
        The places in that frame.
    log_scale : float
        Logarithm of the factor on measured coordinates.
    rigid : bool
        Whether the body may move as a whole.
    rows : sequence of int
        Markers that are read otherwise; empty = all.
    """

    kind: str
    words: str
    cost: float
    places: FloatArray
    motion: FloatArray
    arms: FloatArray
    log_scale: float = 0.0
    rigid: bool = False
    rows: Sequence[int] = field(default_factory=tuple)


def as_given(given: Given) -> Reading:
    """Return the input taken at its word."""
    return Reading("", "", 0.0, given.reference, given.motion, given.reference)
