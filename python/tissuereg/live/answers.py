"""What goes out: the registered surface with its spread, targets with their regions, trust and latency, in RAS mm."""

import hashlib
import json
from typing import Any, NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.io.points import turned
from tissuereg.live.protocol import (
    NamedPlace,
    Status,
    crc64,
    packed,
    points_packed,
    status_packed,
    surface_packed,
    text_packed,
)
from tissuereg.registration.target import region_of

#: Name of the device in all answers but the surface's and the targets'.
DEVICE = "TissueReg"


class StatusCode(NamedTuple):
    """Codes of the protocol that say what an answer is worth."""

    trusted: int = 1
    untrusted: int = 2
    stale: int = 7
    refused: int = 10
    not_kept: int = 11
    not_ready: int = 13


_CODES = StatusCode()


#: Codes of what peers are told beside answers, by its name.
_EVENTS = {
    "ALIGNED": _CODES.trusted,
    "NOT_ALIGNED": _CODES.not_ready,
    "SEVERAL_FRAMES": _CODES.refused,
    "NOT_RECORDED": _CODES.not_kept,
}


class LiveAnswer(NamedTuple):
    """The messages of one frame: `heavy`, its places; `light`, what they are worth; `stale`, that once they are old."""

    heavy: bytes
    light: bytes
    stale: bytes
    trusted: bool


class NodeSpread(NamedTuple):
    """Standard deviation of every node, (n_nodes,), mm, and the time of the frame from which it is, s."""

    std: FloatArray
    time_s: float


class Circumstances(NamedTuple):
    """What an answer states beside its registration.

    `frame`: patient frame of the body, None if it has none; `latency_s`: from the frame's arrival to its places, s,
    and `step_s`, the registration's share of it, None of a frame that could not be registered; `spread`: of the nodes;
    `recorded`: whether frames are recorded, None if nobody wants that; `aligned_mm`: rms residual of the alignment.
    """

    frame: str | None = None
    latency_s: float | None = None
    step_s: float | None = None
    spread: NodeSpread | None = None
    recorded: bool | None = None
    aligned_mm: float | None = None


def prepare() -> None:
    """Make what is made once, so that it does not delay the first answer."""
    crc64(bytes(2000))
    region_of(np.zeros(3), np.eye(3), 0.9, None)


def places_of(result: Any, time_s: float, frame: str | None, *, surface: bool, spread: NodeSpread | None) -> bytes:
    """Return the messages of a registration's places: its surface, and its targets with their regions.

    `result`: a `Registration`; `time_s`: of its frame; `frame`: patient frame of the body, None if it has none;
    `surface`: whether the surface is sent; `spread`: of its nodes. A target's radius is the longest half-axis of its
    90 % region.
    """
    heavy = [_surface(result, time_s, spread, frame)] if surface else []
    if result.targets:
        colour = (0, 200, 80, 255) if result.trust.ok else (230, 60, 40, 255)  # RGBA
        points = [
            NamedPlace(name, turned(one.mean, frame, "RAS"), float(max(one.region().radii)))
            for name, one in result.targets.items()
        ]
        heavy.append(packed("POINT", "Targets", points_packed(points, "target", colour), time_s))
    return b"".join(heavy)


def answer_of(result: Any, heavy: bytes, time_s: float, said: Circumstances) -> LiveAnswer:
    """Return the messages of a registration: its places, as `places_of` returns them, and what they are worth."""
    trusted = bool(result.trust.ok)
    content = {
        **_content(time_s, said),
        "trusted": trusted,
        "reasons": list(result.trust.reasons),
        "markers_used": len(result.markers.used),
        "markers_rms_mm": result.markers.after_rms_mm,
        "targets": {name: _target(one, said.frame) for name, one in result.targets.items()},
    }
    code, name = (_CODES.trusted, "TRUSTED") if trusted else (_CODES.untrusted, "UNTRUSTED")
    why = "nothing speaks against it" if trusted else "; ".join(result.trust.reasons)
    light = _told(content, Status(code, name, why), time_s)
    old = _told({**content, "stale": True}, Status(_CODES.stale, "STALE", "no newer answer came in time"), time_s)
    return LiveAnswer(heavy, light, old, trusted)


def not_registered(reason: str, time_s: float, said: Circumstances) -> bytes:
    """Return the messages for a frame that could not be registered: the fields of others, null where there is none."""
    content = {**_content(time_s, said), "reasons": [reason]}
    return _told(content, Status(_CODES.not_ready, "NOT_REGISTERED", reason), time_s)


def told(name: str, text: str, time_s: float) -> bytes:
    """Return the message of what happened beside the frames: a status of a name in `_EVENTS`."""
    return packed("STATUS", DEVICE, status_packed(Status(_EVENTS[name], name, text)), time_s)


def answer_digest(result: Any, time_s: float) -> str:
    """Return the digest of a registration, by which a replay knows whether its answer is the same to the last bit.

    Of the frame's time, all displacements, the targets with their covariances, the markers that count, and the verdict.
    """
    words = [repr(time_s), bool(result.trust.ok), *result.trust.reasons, *result.markers.used, *result.targets]
    found = hashlib.sha256("\0".join(map(str, words)).encode())
    numbers = [result.displacement]
    for one in result.targets.values():
        numbers += [one.mean, one.covariance]
    for array in numbers:
        found.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return found.hexdigest()[:16]


def _content(time_s: float, said: Circumstances) -> dict[str, Any]:
    """Return all fields of an answer, as they are of a frame that could not be registered."""
    return {
        "schema": "tissuereg.live-answer/1",
        "time_s": time_s,
        "latency_ms": None if said.latency_s is None else 1e3 * said.latency_s,
        "step_ms": None if said.step_s is None else 1e3 * said.step_s,
        "stale": False,
        "trusted": False,
        "reasons": [],
        "markers_used": None,
        "markers_rms_mm": None,
        "frame": None if said.frame is None else "RAS",
        "alignment_rms_mm": said.aligned_mm,
        "recorded": said.recorded,
        "spread_of_s": None if said.spread is None else said.spread.time_s,
        "targets": {},
    }


def _told(content: dict[str, Any], status: Status, time_s: float) -> bytes:
    """Return a STRING of JSON and a STATUS; targets are left out of a text that would be too long for a message."""
    text = json.dumps(content, allow_nan=False, default=float)
    try:
        body = text_packed(text)
    except ValueError:
        body = text_packed(json.dumps({**content, "targets": None, "reasons": content["reasons"][:1]}, default=float))
    return packed("STRING", DEVICE, body, time_s) + packed("STATUS", DEVICE, status_packed(status), time_s)


def _target(target: Any, frame: str | None) -> dict[str, Any]:
    region = target.region()
    return {
        "mean_mm": turned(target.mean, frame, "RAS").tolist(),
        "region90_radii_mm": region.radii.tolist(),
        "region90_axes": turned(region.axes, frame, "RAS").tolist(),
        "flag": target.flag,
    }


def _surface(result: Any, time_s: float, spread: NodeSpread | None, frame: str | None) -> bytes:
    """Return the message of the registered surface: the nodes of the free and held surface, and triangles of them."""
    nodes, corners = np.unique(result.mesh.surface, return_inverse=True)
    places = turned((result.mesh.nodes + result.displacement)[nodes], frame, "RAS")
    scalars = {"displacement_mm": np.linalg.norm(result.displacement[nodes], axis=1)}
    if spread is not None:
        scalars = {"std_mm": spread.std[nodes], **scalars}
    return packed("POLYDATA", "Registered", surface_packed(places, corners.reshape(-1, 3), scalars), time_s)
