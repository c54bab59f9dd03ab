"""What a file states about its coordinates in its header or its comments: their unit and their patient frame."""

import re
from collections.abc import Iterable

from tissuereg._base.arguments import check_choice
from tissuereg._base.choices import FRAMES, UNITS, Frame, Unit
from tissuereg.errors import FormatError

#: A comment in XML.
COMMENT = re.compile(rb"<!--(.*?)-->", re.DOTALL)
_KEY_OF_UNIT = (
    r"(?:(?:(?<![a-z])|(?:length|coordinate)s?[ _]?)units?[\s:=(\[\"'<]+(?:in\s+|is\s+)?"
    r"|(?<![a-z])(?:length|coordinate|dimension)s?\s+(?:are\s+)?in\s+)"
)
_UNIT = re.compile(
    _KEY_OF_UNIT
    + r"(?:(milli|centi)?(mm|cm|m|met(?:er|re)s?)|(dm|km|nm|um|\u00b5m|\u03bcm|(?:deci|kilo|nano|micro)\w+|"
    r"inch(?:es)?|foot|feet|ft|(?<=[:=])in|(?<=[:=] )in))\b",
    re.IGNORECASE,
)
_KEY_OF_FRAME = r"(?<![a-z])(?:space|coordinate[ _]*(?:system|frame)|frame|orientation)\b"
_AXES = r"([rlapsi](?:[-_, ]{0,2}[rlapsi]){2}|(?:right|left)[-_ ]?(?:anterior|posterior)[-_ ]?(?:superior|inferior))"
#: Behind a blank alone only LPS and RAS are no part of a sentence.
_FRAME = re.compile(
    _KEY_OF_FRAME + r"(?:\s*[:=]+\s*[\"'(\[<]*|[\s\"'(\[<]+(?=(?:ras|lps)\b))" + _AXES + "(?![a-z])", re.IGNORECASE
)


def unit_in(notes: Iterable[str]) -> Unit | None:
    """Return the unit, ``mm``, ``cm`` or ``m``, that notes state; None if none does.

    Raises `FormatError` if they state two, or another unit of length.

    >>> unit_in(["liver, unit: metres"])
    'm'
    """
    stated = {_unit(found) for note in notes for found in _UNIT.finditer(note)}
    if len(stated) > 1 or not stated <= set(UNITS):
        message = f"the unit that a file states must be mm, cm or m, got {' and '.join(sorted(stated))}"
        raise FormatError(message)
    return check_choice("unit", stated.pop(), UNITS, FormatError) if stated else None


def _unit(found: "re.Match[str]") -> str:
    prefix, word, other = ((group or "").lower() for group in found.groups())
    if word in ("mm", "cm") or other:
        return prefix + word + other
    return {"": "m", "milli": "mm", "centi": "cm"}[prefix]


def agreed_frame(stated: Frame | None, given: Frame | None, place: str) -> Frame | None:
    """Return the frame of coordinates, from what their file states and what is given; None if neither tells it.

    `place`: the file, for the message. Raises `FormatError` if the two differ, or `given` is neither LPS nor RAS.
    """
    if given is not None:
        check_choice("frame", given, FRAMES, FormatError)
    if stated is not None and given not in (None, stated):
        message = f"the frame that is given must be that of the file, if it states one: {place} is in {stated}, "
        message += f"--frame {given} (frame= in Python) contradicts it; leave it out"
        raise FormatError(message, where=place.strip("`"))
    return stated or given


def frame_in(notes: Iterable[str]) -> Frame | None:
    """Return the frame, ``LPS`` or ``RAS``, that notes state as 3D Slicer does (``SPACE=RAS``); None if none does.

    Raises `FormatError` if they state two, or another one.

    >>> frame_in(["3D Slicer output. SPACE=RAS"])
    'RAS'
    """
    stated = set(filter(None, (_axes(found[1]) for note in notes for found in _FRAME.finditer(note))))
    if len(stated) > 1 or not stated <= set(FRAMES):
        message = f"the frame that a file states must be LPS or RAS, got {' and '.join(sorted(stated))}"
        raise FormatError(message)
    return check_choice("frame", stated.pop(), FRAMES, FormatError) if stated else None


def _axes(words: str) -> str | None:
    """Return the first letters of three axes of a patient, one of each, in capitals; None if they are no such three."""
    bare = re.sub("[-_, ]", "", words.upper())
    letters = bare if len(bare) == 3 else "".join(word[0] for word in re.findall("RIGHT|LEFT|ANT|POST|SUP|INF", bare))
    return letters if all(set(letters) & set(pair) for pair in ("RL", "AP", "SI")) else None
