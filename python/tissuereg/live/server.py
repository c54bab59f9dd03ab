"""A live registration: peers on one event loop, the tracker in a thread beside it, one frame between them."""

import asyncio
import contextlib
import socket
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple, Protocol

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError, TissueRegError
from tissuereg.live.answers import (
    Circumstances,
    LiveAnswer,
    NodeSpread,
    answer_digest,
    answer_of,
    not_registered,
    places_of,
    prepare,
    told,
)
from tissuereg.live.frames import TAKEN, Gathering, Intake, LiveFrame, check_intake
from tissuereg.live.keeper import Keeper, Recorder
from tissuereg.live.peers import Address, Peer, Peers, shown
from tissuereg.live.protocol import HEADER_BYTES, header_of, message_of
from tissuereg.live.settings import LiveSettings
from tissuereg.tracking.align import Alignment
from tissuereg.tracking.tracker import CANNOT_BE_REGISTERED

#: Whatever a peer may do to a connection.
_PEER_ERRORS = (FormatError, OSError, EOFError, TimeoutError)


class Engine(Protocol):
    """What registers a frame; a `Tracker` is one."""

    def step(self, measured_mm: FloatArray, time_s: float) -> Any:
        """Return the registration of places (n_markers, 3), mm, at a time, s."""


@dataclass
class Counts:
    """What a live registration did so far, beside what `PeerCounts` says.

    `received`: frames that came in; `registered`, `failed`, `untrusted`: of those that were taken; `dropped`: frames
    for which there was no time; `late`: frames not later than the one before; `spoilt`: messages that break the
    protocol; `skipped`: messages of other types, or too large; `unknown`: names that are no marker's.
    """

    received: int = 0
    registered: int = 0
    failed: int = 0
    untrusted: int = 0
    dropped: int = 0
    late: int = 0
    spoilt: int = 0
    skipped: int = 0
    unknown: int = 0

    def to_json(self) -> dict[str, int]:
        """Return the counts by name."""
        return asdict(self)


@dataclass
class _Latest:
    """The newest frame that waits, and the last answer, with the time of its frame's arrival."""

    frame: LiveFrame | None = None
    answer: LiveAnswer | None = None
    received_s: float = 0.0
    stale: bool = False
    came: asyncio.Event = field(default_factory=asyncio.Event)


class _Answered(NamedTuple):
    """A frame's registration, its messages, and the digest of its answer, empty if nobody wants it."""

    result: Any
    answer: LiveAnswer
    digest: str


class LiveServer:
    """Registers the markers that peers send over OpenIGTLink, frame after frame, and sends them the answers.

    It stands between peers that come, stall, lie and go, and a tracker that takes its time: a frame that comes while
    another one is registered waits, and is dropped if a newer one comes; answers are left out for a peer that does not
    read them. It writes no file, whatever it is sent; frames go to `recorder`.

    Parameters
    ----------
    engine : Tracker, or an object with its method `step`
        What registers a frame. It is called from one thread at a time.
    intake : Intake
        Names of the markers, and how what comes in becomes their places in the body's frame.
    settings : LiveSettings, optional
        Times and bounds.
    recorder : Recorder, optional
        Is given every frame, in the order of time, whether it was registered, and a digest of its answer.
    told : callable of str, optional
        Is told what happens, in words: who connected, and what was wrong.

    Raises
    ------
    FormatError
        If the names of the markers cannot be joined with a sender's as `intake` says.

    Attributes
    ----------
    counts : Counts
        What was done so far; of peers in `peer_counts`.
    latencies_s : list of float
        Time from a frame's arrival to its answer of the last frames, s.
    """

    def __init__(
        self,
        engine: Engine,
        intake: Intake,
        settings: LiveSettings | None = None,
        *,
        recorder: Recorder | None = None,
        told: Callable[[str], None] | None = None,
    ) -> None:
        check_intake(intake)
        self.counts, self.latencies_s = Counts(), list[float]()
        self._engine, self._intake = engine, intake
        self._settings = settings or LiveSettings()
        self._told = told or (lambda _: None)
        self._keeper = Keeper(recorder, self._settings, lambda text: self._announce("NOT_RECORDED", text))
        self._peers = Peers(self._settings, self._told)
        self.peer_counts = self._peers.counts
        self._gathering = Gathering(intake, self._settings)
        self._latest = _Latest()
        self._spread: NodeSpread | None = None
        self._doubts: set[str] = set()
        self._begin = time.monotonic()
        self._ended = asyncio.Event()

    async def run(
        self,
        listen: Address | None = None,
        connect: Address | None = None,
        *,
        frames: int | None = None,
        seconds: float | None = None,
        ready: Callable[[Address], None] | None = None,
    ) -> None:
        """Serve until `stop` is called, a number of `frames` was registered, or a time in `seconds` has passed.

        `listen`: address to listen at, port 0 for any; `connect`: peer to connect to, again whenever it is gone; one of
        them, or both. `ready`: is called with the address once peers can connect. Raises `OSError` if the address
        cannot be listened at.
        """
        prepare()
        async with self._listening(listen, ready):
            tasks = [asyncio.create_task(one) for one in (self._register(frames), self._watch())]
            if connect is not None:
                tasks.append(asyncio.create_task(self._keep_connected(connect)))
            ended = asyncio.create_task(self._ended.wait())
            try:
                done, _ = await asyncio.wait([ended, *tasks], timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
            finally:
                for task in (ended, *tasks):
                    task.cancel()
                await asyncio.gather(ended, *tasks, return_exceptions=True)
                self._drop()
                self._keeper.close()
                self._peers.close()

    @property
    def alignment(self) -> Alignment | None:
        """The alignment of the tracker's frame to the body's; None if there is none, or none yet."""
        return self._gathering.alignment

    def stop(self) -> None:
        """End `run`; to be called on its event loop."""
        self._ended.set()

    @contextlib.asynccontextmanager
    async def _listening(self, listen: Address | None, ready: Callable[[Address], None] | None) -> AsyncIterator[None]:
        if listen is None:
            yield
            return
        server = await asyncio.start_server(self._accepted, *listen)
        address = server.sockets[0].getsockname()[:2]
        self._told(f"listening on {shown(address)}")
        if ready is not None:
            ready(address)
        try:
            yield
        finally:
            server.close()

    async def _keep_connected(self, address: Address) -> None:
        lost = False
        while True:
            try:
                reader, writer = await asyncio.open_connection(*address)
            except (OSError, UnicodeError) as error:  # the second is of a name that is none of a machine
                if not lost:
                    self._told(f"{shown(address)} is not there ({error}); it is tried again and again")
                lost = True
            else:
                lost = False
                await self._serve(reader, writer, called=True)
            await asyncio.sleep(self._settings.retry_s)

    async def _accepted(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.CancelledError):  # asyncio complains of a connection that is cancelled
            await self._serve(reader, writer)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, called: bool = False) -> None:
        """Read messages of one peer until it goes, gives way, or breaks the protocol beyond repair."""
        peer = self._peers.admit(writer, self._now(), called=called)
        if peer is None:
            return
        # A peer whose machine is gone is noticed by the system, though it never says so.
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        why = ""
        try:
            if self._latest.answer is not None:
                answer, stale = self._latest.answer, self._latest.stale
                self._peers.send(peer, answer.heavy + (answer.stale if stale else answer.light))
            while True:
                await self._message(reader, peer)
        except _PEER_ERRORS as error:
            if not isinstance(error, EOFError | ConnectionError):
                self.counts.spoilt += 1
                why = f": {error or 'a message that did not end in time'}"
        finally:
            self._peers.leave(peer, why)

    async def _message(self, reader: asyncio.StreamReader, peer: Peer) -> None:
        """Read one message and take what it holds; raise what ends the connection."""
        begin = await reader.readexactly(1)
        async with asyncio.timeout(self._settings.partial_s):
            header = header_of(begin + await reader.readexactly(HEADER_BYTES - 1))
            if header.size > self._settings.most_skipped_bytes:
                message = f"a message must have at most {self._settings.most_skipped_bytes} bytes, got {header.size}"
                raise FormatError(message, where=header.type)
            if header.type not in TAKEN or header.size > self._settings.most_bytes:
                self.counts.skipped += 1
                await _skip(reader, header.size)
                peer.heard_s = self._now()
                return
            body = await reader.readexactly(header.size)
        peer.heard_s = self._now()
        try:
            frames = self._gathering.take(message_of(header, body), self._now())
        except FormatError as error:  # its length was right, so that the next one can be read
            if not self.counts.spoilt:
                self._told(f"a message is left out, and others like it without a word: {error}")
            self.counts.spoilt += 1
        else:
            self._arrived(frames)
            self._tell_strangers()
        await asyncio.sleep(0)  # a peer that sends without a break does not keep the others from their turn

    def _tell_strangers(self) -> None:
        """Tell of names that are no marker's, each once."""
        new = list(self._gathering.unknown)[self.counts.unknown :]
        if new:
            several = f" and {len(new) - 1} more are no markers" if len(new) > 1 else " is no marker"
            names = ", ".join(self._intake.names[:3])
            self._told(f"'{new[0]}'{several} of the reference ({names} ...), and left out; --match number or order?")
        self.counts.unknown = len(self._gathering.unknown)

    def _tell_reasons(self, result: Any) -> None:
        """Tell why frames are not to be trusted, each kind of reason once."""
        for reason in result.trust.reasons:
            kind = reason.partition(":")[0]
            if kind not in self._doubts:
                self._doubts.add(kind)
                self._told(f"not to be trusted: {reason}")

    def _announce(self, name: str, text: str) -> None:
        """Tell peers and the user of what happened beside the frames."""
        self._told(text)
        self._peers.publish(told(name, text, self._now()))

    def _arrived(self, frames: list[LiveFrame]) -> None:
        events, self._gathering.events = self._gathering.events, []
        for event in events:
            self._announce(*event)
        for frame in frames:
            self.counts.received += 1
            self._drop()
            self._latest.frame = frame
            self._latest.came.set()

    def _drop(self) -> None:
        """Drop the frame that waits, if there is one, since a newer one came, or the end."""
        frame, self._latest.frame = self._latest.frame, None
        if frame is not None:
            self.counts.dropped += 1
            self._keeper.dropped(frame)

    async def _register(self, most: int | None) -> None:
        """Register the newest frame, again and again, until `most` were."""
        while most is None or self.counts.registered < most:
            await self._latest.came.wait()
            self._latest.came.clear()
            frame, self._latest.frame = self._latest.frame, None
            if frame is None:
                continue
            if not frame.ready:
                self.counts.failed += 1
                self._keeper.dropped(frame)
                why = "the tracker's frame is not aligned: all markers must be seen once"
                self._peers.publish(not_registered(why, frame.time_s, self._said()))
                continue
            self._keeper.taken(frame)
            try:
                result, answer, digest = await asyncio.to_thread(self._answer, frame)
            except Exception as error:  # whatever a peer sends, the next frame is registered
                self.counts.failed += 1
                self._keeper.answered("failed")
                if not isinstance(error, TissueRegError):
                    self._told(f"this is a bug, please report it: {type(error).__name__}: {error}")
                self._peers.publish(not_registered(str(error), frame.time_s, self._said()))
            else:
                self.counts.registered += 1
                self.counts.untrusted += not answer.trusted
                self._tell_reasons(result)
                self._latest.answer, self._latest.received_s, self._latest.stale = answer, frame.received_s, False
                self._peers.publish(answer.heavy + answer.light)
                self._keeper.answered(digest)
                if self._settings.surface == "spread" and self._is_old(frame.time_s):
                    await asyncio.to_thread(self._renew, result, frame.time_s)

    def _answer(self, frame: LiveFrame) -> _Answered:
        """Return a frame's registration and its messages; the spread is of an earlier frame, where there is one."""
        begin = self._now()
        result, surface = self._engine.step(frame.places, frame.time_s), self._settings.surface
        step_s = self._now() - begin
        if surface == "spread" and self._spread is None:
            self._renew(result, frame.time_s)
        heavy = places_of(result, frame.time_s, self._intake.frame, surface=surface != "none", spread=self._spread)
        latency_s = self._now() - frame.received_s
        self.latencies_s = [*self.latencies_s[-999:], latency_s]
        said = self._said()._replace(latency_s=latency_s, step_s=step_s, spread=self._spread)
        answer = answer_of(result, heavy, frame.time_s, said)
        return _Answered(result, answer, answer_digest(result, frame.time_s) if self._keeper.recording else "")

    def _said(self) -> Circumstances:
        """Return what every answer states."""
        aligned_mm = None if self.alignment is None else self.alignment.rms_mm
        return Circumstances(self._intake.frame, recorded=self._keeper.recording, aligned_mm=aligned_mm)

    def _is_old(self, time_s: float) -> bool:
        return self._spread is None or time_s - self._spread.time_s >= self._settings.spread_s

    def _renew(self, result: Any, time_s: float) -> None:
        """Compute the spread of the nodes, which takes longer than a registration; keep the old one if it fails."""
        with contextlib.suppress(*CANNOT_BE_REGISTERED):
            self._spread = NodeSpread(result.std, time_s)

    async def _watch(self) -> None:
        """Flush tools whose frame does not become whole, and mark the last answer as stale when no frame comes."""
        settings, latest = self._settings, self._latest
        while True:
            await asyncio.sleep(settings.gather_s / 2.0)
            self._arrived(self._gathering.flush(self._now()))
            self.counts.late = self._gathering.late
            age = self._now() - latest.received_s
            if latest.answer is not None and not latest.stale and age > settings.stale_s and latest.frame is None:
                latest.stale = True
                self._peers.publish(latest.answer.stale)

    def _now(self) -> float:
        return time.monotonic() - self._begin


async def _skip(reader: asyncio.StreamReader, size: int) -> None:
    """Read bytes and forget them, without ever holding many."""
    while size > 0:
        found = await reader.read(min(size, 65_536))
        if not found:
            raise EOFError
        size -= len(found)
