"""Measured places that are no measurements, as the frames before tell: an old pose, a jump that no body makes."""

from math import sqrt

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.body.markers import Markers
from tissuereg.registration.readings.lost import repeated_poses

#: Fastest motion of one marker beside the others, mm/s: strains of order one travel with the shear waves of soft
#: tissue, some metres a second.
FASTEST_MM_S = 1000.0

#: Standard deviations of the tracker's noise, and of a predicted place, that a jump exceeds.
_SURELY, _PREDICTED = 6.0, 3.0

_OLD = "lost: the pose of the frame before to the last digit, while other markers move"
_JUMP = "lost: a jump that no body makes in the time since"


class Watch:
    """Memory of where each marker was measured last, of markers that are attached to one body.

    A marker that jumped is believed again where it is found near the registered body, not when enough time has passed.
    `places`: names and noise of the markers, mm.
    """

    def __init__(self, places: Markers) -> None:
        n = len(places)
        self._names, self._std = places.names, places.std
        self._raw, self._place = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
        self._time, self._reach = np.full(n, np.nan), np.zeros(n)
        self._jumped: BoolArray = np.zeros(n, dtype=bool)

    def lost(self, measured: FloatArray, time_s: float) -> dict[str, str]:
        """Return the markers whose places are no measurements, by name, each with the reason.

        `measured` (n_markers, 3): places in mm, NaN = not seen, at `time_s`, s.
        """
        found = dict.fromkeys(repeated_poses(self._raw, measured), _OLD)
        change = measured - self._place
        rows = [i for i in np.flatnonzero(np.isfinite(change).all(axis=1)) if int(i) not in found]
        if rows:
            apart = np.linalg.norm(change[rows] - np.median(change[rows], axis=0), axis=1)
            limit = FASTEST_MM_S * (time_s - self._time[rows]) + _SURELY * sqrt(6.0) * self._std[rows]
            jumps = np.flatnonzero(apart > limit + _PREDICTED * self._reach[rows])
            # If most jump, the body was moved.
            if 2 * len(jumps) < len(rows):
                found |= {int(rows[i]): _JUMP for i in jumps}
        return {self._names[row]: why for row, why in sorted(found.items())}

    def registered(
        self, measured: FloatArray, time_s: float, lost: dict[str, str], believed: Markers, body: "OnBody"
    ) -> None:
        """Remember a frame that was registered.

        `measured` (n_markers, 3): its places, mm, at `time_s`, s; `lost`: what `lost` said of it; `believed`: the
        markers without all that are lost; `body`: where the registered body has them.
        """
        whole = np.isfinite(measured).all(axis=1)
        self._raw[whole] = measured[whole]
        kept = np.isfinite(believed.measured).all(axis=1)
        self._place[kept], self._time[kept], self._reach[kept] = measured[kept], time_s, 0.0
        self._jumped[kept] = False
        self._jumped |= np.isin(self._names, [name for name, why in lost.items() if why == _JUMP])
        here, reach = body
        gone = self._jumped
        self._place[gone], self._time[gone], self._reach[gone] = here[gone], time_s, reach[gone]


#: Registered places of all markers (n_markers, 3), and their standard deviations (n_markers,), mm.
OnBody = tuple[FloatArray, FloatArray]
