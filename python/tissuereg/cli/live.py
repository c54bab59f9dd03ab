"""The command ``tissuereg live``: registers the markers that peers send over OpenIGTLink, and answers them."""

import argparse
import asyncio
import contextlib
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.fields import choice, number, whole
from tissuereg.cli.body_input import (
    add_belief_options,
    add_body_options,
    add_match_option,
    add_method_options,
    beliefs_of,
    believed_body,
    method_of,
    only_given,
    read_tracked_body,
)
from tissuereg.cli.common import UNTRUSTED, Outcome, Stopwatch, note, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse, refuse_overwriting
from tissuereg.cli.recording_input import add_offset_option, warm_up
from tissuereg.live.settings import SURFACES
from tissuereg.report.words import counted

if TYPE_CHECKING:
    from tissuereg.live import LiveServer
    from tissuereg.live.frames import Intake
    from tissuereg.tracking import Tracker

HELP = Help(
    "Registers a body to markers that come over the network, by OpenIGTLink: POINT (all markers in one message), "
    "TRANSFORM and TDATA (one marker a tool). Sends to all peers, in RAS mm, the registered surface (POLYDATA, with "
    "the standard deviation of every node), the targets (POINT, whose radius is the longest half-axis of the 90 % "
    "region), and trust, latency and regions (STRING of JSON, STATUS). The newest frame is registered; what comes "
    "meanwhile is dropped. It listens at this machine alone unless an address is given, and writes no file but that of "
    "--record, which 'tissuereg track --replay' answers in the same way. Ctrl-C ends it. Exit code 0: nothing speaks "
    "against any frame; 4: some frames are not to be trusted or could not be registered; 2: bad usage or input.",
    example=(
        "tissuereg live liver.vtu --reference sit.fcsv --targets tumour.fcsv --listen 18944 --record today.csv\n"
        "tissuereg live liver.vtu --reference sit.fcsv --connect 127.0.0.1:18944 --align first"
    ),
    seed="seed of all random numbers (default: 0)",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg live`` to its parser."""
    parser.add_argument("path", metavar="MESH", help="mesh file")
    parser.add_argument(
        "--reference", required=True, metavar="FILE", help="where the markers sit on the undeformed body"
    )
    text = (
        "listen at a port of this machine, 18944 as a rule (0: any); with an address, as 0.0.0.0:18944 or [::1]:18944, "
        "at that one"
    )
    parser.add_argument("--listen", type=_listened, metavar="[HOST:]PORT", help=text)
    text = "connect to a peer, such as a PLUS server, and again whenever it is gone"
    parser.add_argument("--connect", type=_address, metavar="HOST:PORT", help=text)
    text = "record every frame to a table, which 'track --replay' reads; it takes its name at the end"
    parser.add_argument("--record", metavar="FILE", help=text)
    text = "surface with the standard deviation of every node, without it, or none"
    add_option(parser, "--surface", choice(SURFACES, text, default="spread"))
    add_option(parser, "--frames", whole("end after so many registered frames", least=1, default=None), "N")
    text = "end after this time"
    add_option(parser, "--seconds", number(text, unit="s", above=0.0, default=None, otherwise="never"), "S")
    more = parser.add_argument_group("more input")
    add_match_option(more, "--reference and senders' names")
    add_offset_option(more)
    text = (
        "align the tracker's frame to the body's: 'first', by the first frame in which all markers are seen, of the "
        "undeformed body; or table point,x_mm,y_mm,z_mm,tracker_x_mm,tracker_y_mm,tracker_z_mm of three points or more"
    )
    more.add_argument("--align", metavar="first|FILE", help=text)
    text = "take transforms of tools into this frame alone: Tracker takes P1ToTracker (default: into one, any)"
    more.add_argument("--tools-in", metavar="FRAME", help=text)
    add_body_options(more, "--reference and --targets")
    add_belief_options(parser.add_argument_group("what is believed"))
    add_method_options(parser.add_argument_group("method"))
    parser.set_defaults(simulations=None)


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg live`` until it is ended; JSON schema ``tissuereg.live/1``.

    The exit code is 4 if a frame is not trusted or could not be registered.
    """
    from tissuereg.live import LiveServer, LiveSettings

    if args.listen is None and args.connect is None:
        refuse("--listen or --connect must be given: where messages come from", "--listen")
    pairs = None if args.align in (None, "first") else args.align
    if args.record is not None:
        refuse_overwriting([Path(args.record)], [args.path, args.reference, args.targets, pairs])
    clock = Stopwatch()
    tracker, intake = _read(args)
    clock.lap("read")
    warm_up(tracker)
    clock.lap("prepare")
    with _recorder(args.record, intake.names) as recorder:
        settings = LiveSettings(surface=args.surface)
        server = LiveServer(tracker, intake, settings, recorder=recorder, told=None if args.quiet else note)
        _serve(server, args)
    clock.lap("live")
    counts = {**server.counts.to_json(), **asdict(server.peer_counts)}
    latency = 1e3 * np.percentile(server.latencies_s, [50.0, 99.0]) if server.latencies_s else [None, None]
    content = {
        "schema": "tissuereg.live/1",
        "seed": args.seed or 0,
        **counts,
        "alignment": None if server.alignment is None else server.alignment.to_json(),
        "latency_ms": {"median": latency[0], "p99": latency[1]},
        "seconds": clock.seconds,
    }
    doubted = counts["untrusted"] or counts["failed"]
    return Outcome(content, _summary(content, args), args.threads, UNTRUSTED if doubted else 0)


def _read(args: argparse.Namespace) -> "tuple[Tracker, Intake]":
    from tissuereg.io.tables import read_pairs, read_reference, read_targets
    from tissuereg.live.frames import FirstFrame, Intake
    from tissuereg.registration.registrar import Registrar
    from tissuereg.tracking import Tracker, rigid_alignment
    from tissuereg.tracking.align import Alignment

    material, load = beliefs_of(args, "--simulations")
    mesh, frames = read_tracked_body(args)
    if frames["frame"] is None and args.align is None:
        note("nothing says in which patient frame MESH is: its numbers are taken for RAS, as those of messages are")
    markers = read_reference(args.reference, args.std, **frames)
    targets = None if args.targets is None else read_targets(args.targets, **frames)
    registrar = Registrar(believed_body(args, mesh, material), markers, targets=targets, load=load, **method_of(args))
    alignment: Alignment | FirstFrame | None = None
    noise = float(np.sqrt(np.mean(markers.axis_std**2)))
    if args.align == "first":
        alignment = FirstFrame(markers.reference, noise)
    elif args.align is not None:
        names, tracker, body = read_pairs(args.align, **frames)
        alignment = rigid_alignment(tracker, body, names, std=noise)
        note(f"the tracker's frame was aligned to the body's, rms residual {alignment.rms_mm:.3g} mm")
    offsets = {name: np.array(place) for name, place in args.offset}
    how = only_given(match=args.match, tools_in=args.tools_in)
    return Tracker(registrar), Intake(markers.names, offsets=offsets, frame=frames["frame"], alignment=alignment, **how)


@contextlib.contextmanager
def _recorder(path: str | None, names: Any) -> Iterator[Any]:
    from tissuereg.io.atomic import check_file_target
    from tissuereg.io.recordings.table import recorder

    if path is None:
        yield None
        return
    check_file_target(path)
    with recorder(Path(path), names) as made:
        yield made


def _serve(server: "LiveServer", args: argparse.Namespace) -> None:
    """Serve until the end; Ctrl-C is one, after which what was recorded is kept."""
    listen = args.listen
    try:
        asyncio.run(server.run(listen, args.connect, frames=args.frames, seconds=args.seconds))
    except KeyboardInterrupt:
        note("ended")
    except (OSError, UnicodeError) as error:
        refuse(f"--listen must name an address of this machine that is free: {error}", "--listen")


def _summary(content: dict[str, Any], args: argparse.Namespace) -> str:
    latency = content["latency_ms"]
    lines = [
        f"{counted(content['registered'], 'frame')} registered of {content['received']}, {content['dropped']} dropped, "
        f"{content['failed']} failed",
        *([f"latency: median {latency['median']:.0f} ms, 99 % {latency['p99']:.0f} ms"] if latency["median"] else []),
        seconds_line(content["seconds"], verbose=args.verbose),
        *([f"written: {args.record}"] if args.record else []),
    ]
    doubted = content["untrusted"]
    lines.append(
        f"Not to be trusted: {doubted} of {content['registered']} frames."
        if doubted
        else "Nothing speaks against any frame."
    )
    return "\n".join(lines)


def _address(text: str, least: int = 1) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        message = f"must have brackets round an address with colons, as [::1]:18944, got '{text}'"
        raise argparse.ArgumentTypeError(message)
    if not host or not port.isascii() or not port.isdigit() or not least <= int(port[:6]) < 65536:
        message = f"must be an address and a port, HOST:PORT, got '{text}'"
        raise argparse.ArgumentTypeError(message)
    return host, int(port)


def _listened(text: str) -> tuple[str, int]:
    return _address(text if ":" in text else f"127.0.0.1:{text}", 0)
