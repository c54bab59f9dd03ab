"""Tracked markers: reference position on the undeformed body, measured position, and its standard deviation."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tissuereg._base.arguments import found, named
from tissuereg._base.arrays import FloatArray, IntArray, depth, float_array, frozen
from tissuereg._base.provenance import derived
from tissuereg._base.shown import notebook
from tissuereg.errors import MarkerError

#: Upper limit of a finite standard deviation, mm: its square must not overflow.
_MOST_STD = 1e9


class Markers:
    """Tracked markers at one moment: their places on the undeformed body and their measured places.

    Parameters
    ----------
    reference : array_like of float, shape (n_markers, 3)
        Place of each marker in mm: on or near the undeformed surface, or inside the body.
    measured : array_like of float, shape (n_markers, 3), optional
        Measured place of each marker in mm; NaN where the tracker did not measure a coordinate. If it is left out, no
        marker counts as measured.
    std : float or array_like of float, shape (n_markers,) or (n_markers, 3)
        Standard deviation of a measured coordinate in mm: one for all markers, one per marker, or one per marker along
        each of the axes x, y and z of the tracker. Infinite along an axis states that this coordinate was not measured.
    names : sequence of str, optional
        One name per marker, without repeats; by default ``M1``, ``M2`` and so on.

    Raises
    ------
    ShapeError
        If the shapes do not match.
    MarkerError
        If a reference place is not finite, a coordinate infinite, `std` not positive, or a name repeated.

    Attributes
    ----------
    std : ndarray of float64, shape (n_markers,)
        Root mean square of the standard deviations of each marker along its measured axes, mm.
    axis_std : ndarray of float64, shape (n_markers, 3)
        Standard deviation of each marker along each axis, mm. An axis given as infinite gets the marker's value of
        `std` here, and its measured coordinate is set to NaN.
    """

    def __init__(
        self, reference: Any, measured: Any = None, std: Any = 0.1, names: Sequence[str] | None = None
    ) -> None:
        places = float_array("reference", reference, (None, 3))
        seen = places * np.nan if measured is None else float_array("measured", measured, (len(places), 3))
        spread = _spread(std, len(places))
        titles = tuple(f"M{i + 1}" for i in range(len(places))) if names is None else _titles(names)
        _check_names(titles, len(places))
        _check_rows("reference places must be finite", titles, np.isfinite(places).all(axis=1), places)
        _check_rows("measured places must be finite, or NaN where not seen", titles, ~np.isinf(seen).any(axis=1), seen)
        known = np.isfinite(spread)
        good = (spread > 0).all(axis=1) & known.any(axis=1)
        _check_rows("std must be positive, in mm, and finite along one axis or more", titles, good, _as_given(spread))
        _check_rows(
            f"std must be less than {_MOST_STD:g} mm", titles, ~(known & (spread >= _MOST_STD)).any(axis=1), spread
        )
        squared = np.where(known, spread, 0.0) ** 2
        overall = np.sqrt(squared.sum(axis=1) / known.sum(axis=1))
        self.names = titles
        self.reference: FloatArray = frozen(places.copy())
        self.measured: FloatArray = frozen(np.where(known, seen, np.nan))
        self.std: FloatArray = frozen(overall)
        self.axis_std: FloatArray = frozen(np.where(known, spread, overall[:, None]))

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        return f"Markers({len(self)} markers, {int(self.seen.sum())} seen)"

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return notebook("markers", self)

    @property
    def seen(self) -> "np.ndarray[Any, np.dtype[np.bool_]]":
        """Whether all three coordinates of each marker were measured, bool, shape (n_markers,)."""
        return np.asarray(np.isfinite(self.measured).all(axis=1))

    @property
    def displacement(self) -> FloatArray:
        """Measured minus reference place of each marker in mm, NaN where not measured, shape (n_markers, 3)."""
        return np.asarray(self.measured - self.reference)

    def without(self, lost: Iterable[str]) -> "Markers":
        """Return the markers with those of the names `lost` counted as not seen; itself if there are none."""
        gone = np.isin(self.names, list(lost))
        if not gone.any():
            return self
        return Markers(self.reference, np.where(gone[:, None], np.nan, self.measured), self.axis_std, self.names)

    def only(self, keep: Any) -> "Markers":
        """Return the markers selected by a mask or by indices.

        Parameters
        ----------
        keep : array_like of bool or int
            Mask of length n_markers, or indices.

        Returns
        -------
        Markers
            The selected markers: in their present order for a mask, in the order of `keep` for indices.
        """
        rows = _kept(keep, len(self))
        kept = Markers(self.reference[rows], self.measured[rows], self.axis_std[rows], [self.names[i] for i in rows])
        return derived(kept, self)

    def with_seen(self, targets: Mapping[str, Any], seen: Mapping[str, Any], std: Any = 0.1) -> "Markers":
        """Return these markers and, after them, targets that were seen, or corrected by hand, in the deformed body.

        A registration attaches them like all others: inside the body, to the tissue around them.

        Parameters
        ----------
        targets : mapping of str to array_like of float, shape (3,)
            Inner points of the undeformed body by name, mm, as `register` takes them.
        seen : mapping of str to array_like of float, shape (3,)
            Where some of them are in the deformed body, by name, mm; NaN = not seen.
        std : float or mapping of str to float
            Standard deviation of a seen coordinate, mm: one for all, or one for each name in `seen`.

        Returns
        -------
        Markers
            With the seen targets under their own names.

        Raises
        ------
        ShapeError
            If a place is not three numbers.
        MarkerError
            If a name in `seen` is no target, has no `std` or is that of a marker, or a value is out of its range.

        Examples
        --------
        >>> skin = Markers([[0.0, 0, 9]], [[0.0, 0, 8]])
        >>> skin.with_seen({"lesion": (0.0, 0, 4)}, {"lesion": (0.0, 0, 3.5)}, std=0.5).names
        ('M1', 'lesion')
        """
        known, places = (
            named(word, given, error=MarkerError) for word, given in (("targets", targets), ("seen", seen))
        )
        spread = named("std", std, error=MarkerError) if isinstance(std, Mapping) else dict.fromkeys(places, std)
        for word, given in (("targets", known), ("std", spread)):
            strangers = [name for name in places if name not in given]
            if strangers:
                message = (
                    f"every name in `seen` must be in `{word}` ({', '.join(given) or 'none'}), got '{strangers[0]}'"
                )
                raise MarkerError(message, where=strangers[0])
        at = [float_array(f"targets[{name!r}]", known[name], (3,)) for name in places]
        to = [float_array(f"seen[{name!r}]", place, (3,)) for name, place in places.items()]
        own = [np.full(3, float_array(f"std[{name!r}]", spread[name], ())) for name in places]
        together = Markers(
            np.concatenate([self.reference, np.reshape(at, (-1, 3))]),
            np.concatenate([self.measured, np.reshape(to, (-1, 3))]),
            np.concatenate([self.axis_std, np.reshape(own, (-1, 3))]),
            [*self.names, *places],
        )
        return derived(together, self, targets, seen)


def _kept(keep: Any, n_markers: int) -> IntArray:
    """Return the indices (n_kept,) of the markers that a mask (n_markers,) or indices select, or raise MarkerError."""
    try:
        rows = np.arange(n_markers)[keep]
        reason = ""
    except (IndexError, TypeError, ValueError) as error:
        rows, reason = np.empty((0, 0), np.int64), f": {error}"
    if np.ndim(rows) != 1:
        message = f"`keep` must be a mask of {n_markers} markers or a list of indices, got {found(keep)}{reason}"
        raise MarkerError(message, where="keep")
    return np.asarray(rows, np.int64)


def _spread(std: Any, n_markers: int) -> FloatArray:
    """Return `std` in mm, one for all, per marker (n_markers,) or per axis (n_markers, 3), as shape (n_markers, 3)."""
    if depth("std", std) == 2:
        return float_array("std", std, (n_markers, 3))
    by_marker = (
        np.full(n_markers, float_array("std", std, ()))
        if depth("std", std) == 0
        else float_array("std", std, (n_markers,))
    )
    return np.repeat(by_marker[:, None], 3, axis=1)


def _as_given(spread: FloatArray) -> FloatArray:
    """Return standard deviations (n_markers, 3), mm, as (n_markers,) if all markers have the same along all axes."""
    return spread[:, 0] if len(spread) and np.array_equal(spread, spread[:, [0, 0, 0]], equal_nan=True) else spread


def _titles(names: Any) -> tuple[str, ...]:
    """Return marker names as a tuple of texts; raise MarkerError if `names` is no list of names."""
    if isinstance(names, str | bytes) or not isinstance(names, Iterable):
        message = f"`names` must be a list of texts, one per marker, got {found(names)}"
        raise MarkerError(message, where="names")
    return tuple(str(name) for name in names)


def _check_names(names: tuple[str, ...], n_markers: int) -> None:
    if len(names) != n_markers:
        message = f"`names` must hold one name a marker ({n_markers}), got {len(names)}"
        raise MarkerError(message, where="names")
    repeated = sorted(name for name, times in Counter(names).items() if times > 1)
    if repeated:
        message = f"marker names must be unique, repeated: {', '.join(repeated)}"
        raise MarkerError(message, where="names")


def _check_rows(rule: str, names: tuple[str, ...], good: Any, values: FloatArray) -> None:
    if not np.all(good):
        row = int(np.argmin(good))
        message = f"{rule}: marker '{names[row]}' has {np.asarray(values[row]).tolist()}"
        raise MarkerError(message, where=names[row])
