"""What a file states about its coordinates in its header or its comments: their unit and their patient frame."""

import re
from collections.abc import Iterable

from tissuereg._base.arguments import check_choice
from tissuereg.body.mesh import PATIENT_FRAMES
from tissuereg.errors import FormatError

_UNIT = re.compile(r"\bunits?\b\s*[:= ]\s*(milli|centi)?(mm|cm|m|met(?:er|re)s?)\b", re.IGNORECASE)
_SPACE = re.compile(r"\bSPACE\s*[:=]\s*[\"']?([a-z-]+)", re.IGNORECASE)
#: How the frames are spelt; other words that mean axes of a patient are refused.
_FRAMES = {"lps": "LPS", "ras": "RAS", "left-posterior-superior": "LPS", "right-anterior-superior": "RAS"}
_OTHER_FRAME = re.compile(r"[rl][ap][si]|(right|left)-(anterior|posterior)-(superior|inferior)", re.IGNORECASE)


def unit_in(notes: Iterable[str]) -> str | None:
    """Return the unit, ``mm``, ``cm`` or ``m``, that the first note that states one states; None if none does.

    >>> unit_in(["liver, unit: metres"])
    'm'
    """
    for found in filter(None, map(_UNIT.search, notes)):
        prefix, word = (found[1] or "").lower(), found[2].lower()
        if word in ("mm", "cm"):
            return None if prefix else word
        return {"": "m", "milli": "mm", "centi": "cm"}[prefix]
    return None


def agreed_frame(stated: str | None, given: str | None, place: str) -> str | None:
    """Return the frame of coordinates, from what their file states and what is given; None if neither tells it.

    `place`: the file, for the message. Raises `FormatError` if the two differ, or `given` is neither LPS nor RAS.
    """
    if given is not None:
        check_choice("frame", given, PATIENT_FRAMES, FormatError)
    if stated is not None and given not in (None, stated):
        message = f"the frame that is given must be that of the file, if it states one: {place} is in {stated}, "
        message += f"--frame {given} (frame= in Python) contradicts it; leave it out"
        raise FormatError(message, where=place.strip("`"))
    return stated or given


def frame_in(notes: Iterable[str]) -> str | None:
    """Return the frame, ``LPS`` or ``RAS``, that notes state as 3D Slicer does (``SPACE=RAS``); None if none does.

    Raises `FormatError` if they state two, or another one.

    >>> frame_in(["3D Slicer output. SPACE=RAS"])
    'RAS'
    """
    words = dict.fromkeys(found[1].lower() for note in notes for found in _SPACE.finditer(note))
    stated = {_FRAMES.get(word, word.upper()) for word in words if word in _FRAMES or _OTHER_FRAME.fullmatch(word)}
    if len(stated) > 1 or not stated <= {"LPS", "RAS"}:
        message = f"the frame that a file states must be LPS or RAS, got {' and '.join(sorted(stated))}"
        raise FormatError(message)
    return stated.pop() if stated else None
