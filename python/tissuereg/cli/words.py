"""What ``tissuereg register`` and ``tissuereg track`` print: progress on standard error, then a summary."""

import contextlib
import math
import sys
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from tissuereg.cli.common import note, paragraph, seconds_line


def registration_words(content: dict[str, Any], out: str) -> str:
    """Return the result as text; contacts, flags and the verdict come last.

    `content`: of ``registration.json``; `out`: folder of the results. Result: several lines; the last states whether to
    trust the result.
    """
    from tissuereg.report.words import fallback_lines, start_word

    markers, trust, body, model = (content[name] for name in ("markers", "trust", "body", "model"))
    simulated = any(target["simulation_mm"] is not None for target in content["targets"].values())
    start = start_word(simulated)
    unknown = trust["p_value"] is None or not math.isfinite(trust["p_value"])
    p_value = "not known" if unknown else f"{trust['p_value']:.3g}"
    return "\n".join(
        [
            *([_marker_line(markers, start)] if markers["used"] or markers["dropped"] else []),
            *([_surface_line(content["surface"])] if content["surface"] is not None else []),
            *(_target_line(name, target) for name, target in content["targets"].items()),
            f"smallest det F {body['min_det_f']:.3f}, {body['inverted_tets']} inverted tets; p-value of the "
            f"residuals {p_value}",
            f"model: {model.get('kind')}, {model.get('source')}",
            seconds_line(content["seconds"]),
            f"written: {out}",
            *(_contact_line(contact) for contact in content["contacts"]),
            *([] if content["fallback"] is None else fallback_lines(content["fallback"]["targets_mm"])),
            *_verdict_lines(content["targets"], trust),
        ]
    )


def _surface_line(surface: dict[str, Any]) -> str:
    thinned = "" if surface["thinned_from"] is None else f" (thinned evenly from {surface['thinned_from']})"
    return (
        f"{surface['used']} of {surface['points']} surface points used{thinned}, {len(surface['outliers'])} outliers; "
        f"rms distance along the normal {surface['before_rms_mm']:.3f} mm before, "
        f"{surface['after_rms_mm']:.3f} mm after"
    )


def _marker_line(markers: dict[str, Any], start: str) -> str:
    from tissuereg.report.words import counted

    lost = ", ".join(f"{item['marker']} ({item['reason']})" for item in markers["dropped"])
    used = f"{counted(len(markers['used']), 'marker')} used{f'; dropped: {lost}' if lost else ''}"
    if not markers["used"]:
        return used
    return f"{used}; rms distance {markers['before_rms_mm']:.3f} mm {start}, {markers['after_rms_mm']:.3f} mm after"


def _target_line(name: str, target: dict[str, Any], when: str = "") -> str:
    place = ", ".join(f"{x:.2f}" for x in target["mean_mm"])
    axes = " x ".join(f"{x:.2f}" for x in target["region90_radii_mm"])
    return f"target {name}{when}: at ({place}) mm, 90 % region with half-axes {axes} mm"


def _contact_line(contact: dict[str, Any]) -> str:
    place = ", ".join(f"{x:.0f}" for x in contact["centre_mm"])
    towards = ", ".join(f"{x:.2f}" for x in contact["direction"])
    return (
        f"contact at ({place}) mm: surface moved by {contact['size_mm']:.1f} mm, {contact['force_mN']:.0f} mN at the "
        f"believed modulus towards ({towards}), probability {contact['probability']:.2f}"
    )


def _verdict_lines(targets: dict[str, Any], trust: dict[str, Any]) -> list[str]:
    """Return flags and the verdict; if not trusted, the reasons come before it and it names their kinds."""
    from tissuereg.report.words import silent, verdict

    flagged = [name for name, target in targets.items() if target["flag"]]
    kinds = dict.fromkeys(reason.partition(":")[0] for reason in trust["reasons"])
    last = verdict(trust["ok"])
    return [
        *([silent(flagged)] if flagged else []),
        *trust["reasons"],
        last if trust["ok"] else f"{last.removesuffix('.')}: {', '.join(kinds)}.",
    ]


def tracking_words(content: dict[str, Any], out: str) -> str:
    """Return the result as text; the verdict comes last.

    `content`: of ``track.json``; `out`: folder of the results. Result: several lines; the last says whether any frame
    is not to be trusted.
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
            *(_target_line(name, target, f" at {last['time_s']:g} s") for name, target in last["targets"].items()),
            seconds_line(content["seconds"]),
            f"written: {out}",
            *([f"not registered at {failed[0]['time_s']:g} s: {failed[0]['reason']}"] if failed else []),
            *_frames_verdict(frames),
        ]
    )


def _frames_verdict(frames: list[dict[str, Any]]) -> list[str]:
    doubted = [frame for frame in frames if not frame["trust"]["ok"]]
    if not doubted:
        return ["Nothing speaks against any frame."]
    first = doubted[0]
    return [
        f"at {first['time_s']:g} s: {first['trust']['reasons'][0]}",
        f"Not to be trusted: {len(doubted)} of {len(frames)} frames.",
    ]


if TYPE_CHECKING:
    from tissuereg._base.clock import Progress

#: Descriptions of the stages that may take long.
_WORDS = {
    "body": "analysing the mesh: order of elimination, patches of contact",
    "linearise": "factoring the tangent",
    "sensitivities": "responses to forces",
    "sample": "sampling contacts",
    "solve": "solving for equilibrium",
    "spread": "regions of targets",
    "ensemble": "solving drawn loads",
    "assimilate": "assimilating",
    "draws": "draws for the spread of the nodes",
    "files": "writing files",
}

#: Runs shorter than this, in s, show no stages.
_SILENT = 2.0


class Stages:
    """Shows stages and passes. `bar`: on a terminal; lines where there is none; `quiet`: show nothing."""

    def __init__(self, bar: Any, *, quiet: bool) -> None:
        self._bar, self._quiet = bar, quiet
        self._start = time.perf_counter()
        self._pass = ""

    def __call__(self, said: "Progress") -> None:
        """Show what a registration says; for use as the argument `progress` of `tissuereg.register`."""
        if said.kind == "pass":
            self._passed(said.done, said.most)
        elif said.kind == "stage" and not self._quiet:
            self._began(said.words)
        elif not self._quiet:
            self._clear()
            if said.kind == "warning":
                print(paragraph(f"warning: {said.words}"), file=sys.stderr)
            else:
                note(said.words)

    def _passed(self, done: int, in_all: int) -> None:
        """Show passes finished and passes at most."""
        if in_all > done:
            self._pass = f"pass {done + 1} of at most {in_all}: "
        if self._bar is not None:
            self._bar.total = in_all
            self._bar.update(done - self._bar.n)

    def _began(self, words: str) -> None:
        """Show the stage that begins."""
        name, _, share = words.partition(" ")
        if name not in _WORDS:
            return
        if name in ("spread", "draws", "files"):
            self._pass = ""
        line = f"{self._pass}{_WORDS[name]}{share and f' {share}'}"
        if self._bar is not None:
            self._bar.set_description(line)
            return
        spent = time.perf_counter() - self._start
        if spent > _SILENT:
            print(f"{spent:.0f} s: {line}", file=sys.stderr)

    def _clear(self) -> None:
        if self._bar is not None:
            self._bar.clear()


@contextlib.contextmanager
def stage_lines(*, quiet: bool) -> Iterator[Stages]:
    """Give an object that shows the stages of a registration on standard error.

    `quiet`: show nothing. Gives: a bar on a terminal, else lines; both only in runs of more than a few seconds.
    """
    if quiet or not sys.stderr.isatty():
        yield Stages(None, quiet=quiet)
        return
    from tqdm import tqdm

    with tqdm(file=sys.stderr, unit="", delay=_SILENT, leave=False) as bar:
        yield Stages(bar, quiet=False)
