"""Peers that are connected: who they are, who gives way to a new one, and what is sent to them."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from tissuereg.live.settings import LiveSettings

#: Where to listen, or whom to connect to.
Address = tuple[str, int]


@dataclass
class PeerCounts:
    """What happened to peers: all so far, those refused since no more are let in, those that gave way to new ones.

    `unsent`: answers left out for those that do not read.
    """

    peers: int = 0
    refused: int = 0
    displaced: int = 0
    unsent: int = 0


@dataclass(eq=False)
class Peer:
    """A connection: `name`, its address; `heard_s`, when it last sent something; `called`, whether we called it."""

    name: str
    writer: asyncio.StreamWriter
    heard_s: float
    called: bool = False
    gave_way: bool = False

    @property
    def unread(self) -> int:
        """Number of bytes that wait for it to read."""
        return self.writer.transport.get_write_buffer_size()


class Peers:
    """The peers of a live registration, at most `most_peers` of its settings; `told` is told who comes and goes."""

    def __init__(self, settings: LiveSettings, told: Callable[[str], None]) -> None:
        self.counts = PeerCounts()
        self._settings, self._told = settings, told
        self._there: list[Peer] = []
        self._full = False

    def admit(self, writer: asyncio.StreamWriter, now: float, *, called: bool = False) -> Peer | None:
        """Return a new peer, for which an idle one may have to go; None if there is no room, and it is cut off.

        `called`: whether this side connected, which is never asked to give way.
        """
        peer = Peer(shown(writer.get_extra_info("peername", ("?", 0))[:2]), writer, now, called)
        if len(self._there) >= self._settings.most_peers and not self._made_room(peer, now):
            self.counts.refused += 1
            if not self._full:
                self._full = True
                many, idle = len(self._there), self._settings.idle_s
                self._told(
                    f"{peer.name} is refused, and others like it without a word: all {many} peers sent something in "
                    f"the last {idle:g} s"
                )
            writer.transport.abort()
            return None
        self._there.append(peer)
        self.counts.peers += 1
        self._told(f"{peer.name} connected")
        return peer

    def leave(self, peer: Peer, why: str) -> None:
        """Forget a peer, and close its connection."""
        if peer in self._there:
            self._there.remove(peer)
        peer.writer.transport.abort()
        if not peer.gave_way:
            self._told(f"{peer.name} is gone{why}")

    def publish(self, data: bytes) -> None:
        """Send bytes to all."""
        for peer in list(self._there):
            self.send(peer, data)

    def send(self, peer: Peer, data: bytes) -> None:
        """Hand bytes to a peer's connection, which sends them as the peer reads; leave them out if too many wait."""
        if peer.unread > self._settings.most_unsent_bytes:
            self.counts.unsent += 1
        elif not peer.writer.transport.is_closing():
            peer.writer.write(data)

    def close(self) -> None:
        """Cut all connections."""
        for peer in list(self._there):
            peer.writer.transport.abort()

    def _made_room(self, new: Peer, now: float) -> bool:
        """Cut off the peer that is least in use: one that does not read, or else has sent nothing for longest."""
        idle = [one for one in self._there if not one.called and now - one.heard_s >= self._settings.idle_s]
        if not idle:
            return False
        one = max(idle, key=lambda peer: (peer.unread > 0, now - peer.heard_s))
        self._told(f"{one.name} gives way to {new.name}: it has sent nothing for {now - one.heard_s:.0f} s")
        one.gave_way = True
        self.leave(one, "")
        self.counts.displaced += 1
        return True


def shown(address: Address) -> str:
    """Return an address as it is written: ``127.0.0.1:18944``, ``[::1]:18944``."""
    host, port = address
    return f"[{host}]:{port}" if ":" in str(host) else f"{host}:{port}"
