"""The summary that ``tissuereg track`` prints."""

from typing import Any

from tissuereg.cli.common import seconds_line


def summary(content: dict[str, Any], out: str) -> str:
    """Return the result as text; the verdict comes last.

    Parameters
    ----------
    content : dict
        Of ``track.json``.
    out : str
        Folder of the results.

    Returns
    -------
    str
        Several lines; the last says whether any frame is not to be trusted.
    """
    import numpy as np

    from tissuereg.report.words import counted

    frames, failed = content["frames"], content["failed"]
    latency = [frame["latency_ms"] for frame in frames]
    rms = np.median([frame["markers_rms_mm"] for frame in frames])
    last = frames[-1]
    return "\n".join(
        [
            f"{counted(len(frames), 'frame')} registered, {content['dropped_frames']} dropped, {len(failed)} failed, "
            f"{content['hz']:.1f} a second",
            f"latency: median {np.median(latency):.0f} ms, 99 % {np.percentile(latency, 99):.0f} ms",
            f"rms distance to the markers: median {rms:.3f} mm",
            *(_target_line(name, target, last["time_s"]) for name, target in last["targets"].items()),
            seconds_line(content["seconds"]),
            f"written: {out}",
            *([f"not registered at {failed[0]['time_s']:g} s: {failed[0]['reason']}"] if failed else []),
            *_verdict(frames),
        ]
    )


def _target_line(name: str, target: dict[str, Any], time_s: float) -> str:
    place = ", ".join(f"{x:.2f}" for x in target["mean_mm"])
    axes = " x ".join(f"{x:.2f}" for x in target["region90_radii_mm"])
    return f"target {name} at {time_s:g} s: at ({place}) mm, 90 % region with half-axes {axes} mm"


def _verdict(frames: list[dict[str, Any]]) -> list[str]:
    doubted = [frame for frame in frames if not frame["trust"]["ok"]]
    if not doubted:
        return ["Nothing speaks against any frame."]
    first = doubted[0]
    return [
        f"at {first['time_s']:g} s: {first['trust']['reasons'][0]}",
        f"Not to be trusted: {len(doubted)} of {len(frames)} frames.",
    ]
