"""Words of which an argument takes one: each list stands here alone, as a type and as what is checked."""

from typing import Literal, get_args

#: Frames of a patient: x to the left, y to the back, z to the head; or x to the right, y to the front, z to the head.
Frame = Literal["LPS", "RAS"]

#: Units of lengths in files.
Unit = Literal["mm", "cm", "m"]

#: Finite elements: four-node tets, those with volume ratios averaged at the nodes, ten-node tets.
Element = Literal["tet4", "tet4-averaged", "tet10"]
BodyElement = Literal["auto", Element]

#: What a registration believes of supports, stiffness and tracker.
Held = Literal["sure", "perhaps", "free"]
Stiffness = Literal["believed", "graded"]
TrackerKind = Literal["fixed", "drifts"]

#: When a registrar with a model examines how markers are read.
Readings = Literal["doubtful", "always"]

#: What becomes of nodes at one place that no tets share.
Coincident = Literal["certain", "join", "keep"]

#: How two lists of points are joined.
Match = Literal["label", "order", "number"]

#: From before a deformation to after it, or back, as images are warped.
Direction = Literal["modeling", "resampling"]

#: How a registered state restarts a simulation.
RestartKind = Literal["forces", "displacement", "guess", "reference"]

#: Sizes of the embedded phantom.
Size = Literal["full", "small"]

FRAMES: tuple[Frame, ...] = get_args(Frame)
UNITS: tuple[Unit, ...] = get_args(Unit)
ELEMENTS: tuple[Element, ...] = get_args(Element)
BODY_ELEMENTS: tuple[BodyElement, ...] = get_args(BodyElement)
HELD: tuple[Held, ...] = get_args(Held)
STIFFNESS: tuple[Stiffness, ...] = get_args(Stiffness)
TRACKERS: tuple[TrackerKind, ...] = get_args(TrackerKind)
READINGS: tuple[Readings, ...] = get_args(Readings)
COINCIDENT: tuple[Coincident, ...] = get_args(Coincident)
MATCHES: tuple[Match, ...] = get_args(Match)
DIRECTIONS: tuple[Direction, ...] = get_args(Direction)
RESTARTS: tuple[RestartKind, ...] = get_args(RestartKind)
SIZES: tuple[Size, ...] = get_args(Size)
