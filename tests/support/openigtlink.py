"""Peers of a live registration: a fake tracker that is fast, messages, and a server on a loop of its own."""

import asyncio
import contextlib
import socket
import threading
import time
from types import SimpleNamespace

import numpy as np

from support.meshes import block
from tissuereg.live import LiveServer, LiveSettings
from tissuereg.live.frames import Intake
from tissuereg.live.protocol import HEADER_BYTES, NamedPlace, header_of, message_of, packed, points_packed
from tissuereg.registration.target import Target

BODY = block()
NAMES = ("P1", "P2", "P3")
SIT = np.array([[30.0, 10.0, 40.0], [0.0, 10.0, 40.0], [15.0, 0.0, 20.0]])


class FastResult(SimpleNamespace):
    """A registration whose spread is counted when it is asked for."""

    @property
    def std(self):
        self.engine.spreads += 1
        return self.engine.spreads * np.linspace(0.1, 1.0, BODY.n_nodes)


class FastEngine:
    """Moves the body with the mean of the markers, at once, or after `takes` seconds."""

    def __init__(self, takes=0.0, keeps=1000):
        self.takes, self.keeps, self.seen, self.spreads = takes, keeps, [], 0

    def step(self, measured_mm, time_s):
        assert not self.seen or time_s > self.seen[-1][0], "time must advance"
        if self.takes:
            time.sleep(self.takes)
        self.seen = [*self.seen[1 - self.keeps :], (time_s, measured_mm)]
        by = np.nanmean(measured_mm - SIT, axis=0)
        lesion = Target(np.full(3, 10.0), np.full(3, 10.0) + by, np.diag([1.0, 4.0, 9.0]), None)
        return FastResult(
            engine=self,
            mesh=BODY,
            displacement=np.tile(by, (BODY.n_nodes, 1)),
            targets={"lesion": lesion},
            trust=SimpleNamespace(ok=bool(np.isfinite(measured_mm).all()), reasons=["noise: a marker is missing"]),
            markers=SimpleNamespace(used=NAMES, after_rms_mm=0.1),
        )


def point_message(places, names=NAMES, time_s=0.0):
    """A POINT message of all markers, whose places (n, 3) are in the message's frame, mm."""
    points = [NamedPlace(name, np.asarray(place, float), 0.0) for name, place in zip(names, places, strict=True)]
    return packed("POINT", "Markers", points_packed(points, "marker", (255, 0, 0, 255)), time_s)


class Peer:
    """A client of a live registration on a plain socket of this machine."""

    def __init__(self, address, timeout_s=5.0):
        self.socket = socket.create_connection(address, timeout=timeout_s)

    def send(self, data):
        self.socket.sendall(data)

    def read(self, *types):
        """Return the next message of one of these types."""
        while True:
            header = header_of(self._exactly(HEADER_BYTES))
            message = message_of(header, self._exactly(header.size))
            if not types or header.type in types:
                return message

    def gone(self):
        """Return whether the other side closes the connection; what it sends until then is passed over."""
        try:
            while self.socket.recv(65_536):
                pass
        except ConnectionError:
            pass
        return True

    def close(self):
        self.socket.close()

    def _exactly(self, count):
        found = b""
        while len(found) < count:
            part = self.socket.recv(count - len(found))
            if not part:
                raise EOFError
            found += part
        return found


@contextlib.contextmanager
def serving(engine=None, *, intake=None, recorder=None, **settings):
    """Yield a server that runs on a thread of its own, with `address` and `said`; it is stopped at the end."""
    said = []
    server = LiveServer(engine or FastEngine(), intake or Intake(NAMES), LiveSettings(**settings), recorder=recorder,
                        told=said.append)  # fmt: skip
    ready, loops = threading.Event(), []

    def begun(address):
        server.address = address
        loops.append(asyncio.get_running_loop())
        ready.set()

    failed = []

    def run():
        try:
            asyncio.run(server.run(("127.0.0.1", 0), ready=begun))
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert ready.wait(5.0)
    server.said = said
    try:
        yield server
    finally:
        loops[0].call_soon_threadsafe(server.stop)
        thread.join(10.0)
    assert not thread.is_alive()
    assert not failed, failed


def eventually(true, seconds=5.0):
    """Wait until something is true; fail if it does not become so."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it never became true"
        time.sleep(0.002)
