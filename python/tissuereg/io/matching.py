"""How two lists of labelled points are joined: by their labels, by order, or by the number in each label."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tissuereg._base.arguments import check_choice
from tissuereg._base.choices import MATCHES, Match
from tissuereg.errors import FormatError

#: Number of labels that a message lists.
_NAMED = 8
_NUMBER = re.compile(r"[0-9]+")


@dataclass(frozen=True)
class Labels:
    """Labels of a list of points, in its order; for messages the file that holds it, and where in it each stands."""

    file: str
    labels: Sequence[str]
    where: Sequence[str] = ()


def partners(sit: Labels, seen: Labels, match: Match) -> list[int]:
    """Return for each label of `seen` the place in `sit` of the label that belongs to it.

    `sit`: labels of the markers, without repeats; `seen`: labels of measured points; `match`: ``"label"``: those that
    are equal belong together; ``"number"``: those whose last numbers are equal (``F-3`` and ``F_1-3``); ``"order"``:
    the first to the first, whatever the labels are. Raises `FormatError` if a measured point has no partner, or two
    have the same; or if `match` is no such way.

    Examples
    --------
    >>> partners(Labels("was", ["F-1", "F-2"]), Labels("now", ["F_1-2"]), "number")
    [1]
    """
    check_choice("match", match, MATCHES, FormatError)
    if match == "order":
        if len(seen.labels) != len(sit.labels):
            message = (
                f"two lists that are joined by order must have as many points as each other; {sit.file} has "
                f"{len(sit.labels)}, {seen.file} has {len(seen.labels)}"
            )
            raise FormatError(message, where=seen.file)
        return list(range(len(seen.labels)))
    keys = [_keys(one, match) for one in (sit, seen)]
    index = {key: place for place, key in enumerate(keys[0])}
    strangers = [label for key, label in zip(keys[1], seen.labels, strict=True) if key not in index]
    if strangers:
        first = seen.where[seen.labels.index(strangers[0])] if seen.where else "its place"
        known = f"there are {_listed(sit.labels)}"
        others = [f"--match {other}" for other in ("order", "number") if other != match]
        message = (
            f"every {match} in {seen.file} must stand in {sit.file} too; {_listed(strangers)} does not, at "
            f"{first} ({known}). Lists whose labels differ are joined by {' or '.join(others)} (match= in Python)"
        )
        raise FormatError(message, where=f"{seen.file}: {strangers[0]}")
    return [index[key] for key in keys[1]]


def finder(sit: Labels, match: Match) -> Callable[[str], int | None]:
    """Return a function that gives the place in `sit` of the label that belongs to a label, None if there is none.

    Labels belong together as in `partners`, by ``"label"`` or ``"number"``; raises `FormatError` as it does at `sit`.
    """
    index = {key: place for place, key in enumerate(_keys(sit, match))}

    def find(label: str) -> int | None:
        try:
            return index.get(_keys(Labels("", [label]), match)[0])
        except FormatError:
            return None

    return find


def _listed(labels: Sequence[str]) -> str:
    return ", ".join(map(repr, labels[:_NAMED])) + (f" and {len(labels) - _NAMED} more" if len(labels) > _NAMED else "")


def _keys(points: Labels, match: Match) -> list[str]:
    """Return what must be equal for two labels to belong together, for each label; raise `FormatError` at a repeat."""
    found: dict[str, str] = {}
    for label in points.labels:
        numbers = _NUMBER.findall(label)
        if match == "number" and not numbers:
            message = f"every label in {points.file} must hold a number to be joined by it; '{label}' has none"
            raise FormatError(message, where=f"{points.file}: {label}")
        key = str(int(numbers[-1])) if match == "number" else label
        if key in found:
            message = f"each {match} must stand in {points.file} once; '{found[key]}' and '{label}' have the same"
            raise FormatError(message, where=f"{points.file}: {label}")
        found[key] = label
    return list(found)
