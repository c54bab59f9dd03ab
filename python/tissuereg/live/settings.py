"""Settings of a live registration: how long what is waited for, and how much is kept of it."""

from dataclasses import dataclass

from tissuereg._base.arguments import check_choice, real, whole
from tissuereg.errors import ArgumentError

#: What is sent of the registered surface.
SURFACES = ("spread", "plain", "none")


@dataclass(frozen=True)
class LiveSettings:
    """Settings of a live registration.

    Parameters
    ----------
    surface : {"spread", "plain", "none"}
        What is sent of the registered surface: with the standard deviation of every node, without it, or nothing.
    spread_s : float
        Time after which the standard deviation of the nodes is computed anew, s: it takes longer than a registration.
        Each answer states from which frame it is.
    gather_s : float
        Longest time for which markers that come one a message count as one frame, s.
    stale_s : float
        Time without a new frame after which the last answer is marked stale, s.
    partial_s : float
        Longest time for the rest of a message to come after its first byte, s.
    idle_s : float
        Time without a message after which a peer gives way to a new one where no more are let in, and after which
        transforms into another frame are forgotten, s.
    retry_s : float
        Time between attempts to connect to a peer that is not there, s.
    jump_s : float
        Difference between a sender's clock and this machine's beyond which the sender's is set anew, s.
    farthest_mm : float
        Largest coordinate, in the body's frame, of a marker that was seen, mm: no tracker sees farther.
    skew : float
        Largest entry by which a pose's turn, times its transpose, may differ from one: others are none, and not seen.
    most_bytes : int
        Largest body of a message that is read; of a larger one, or of a type that is not taken, nothing is kept.
    most_skipped_bytes : int
        Largest body that is skipped; a connection that announces more is closed.
    most_unsent_bytes : int
        Bytes that may wait for a slow peer; beyond, answers are left out for it.
    most_peers : int
        Most connections at a time; beyond, the one that has sent nothing for longest gives way, after `idle_s`.
    most_waiting : int
        Most frames that wait for the answer to the one before them until they are recorded.
    most_names : int
        Most names of senders that are remembered; further ones are looked up each time.

    Raises
    ------
    ArgumentError
        If a value is not a number or out of its range.
    """

    surface: str = "spread"
    spread_s: float = 1.0
    gather_s: float = 0.05
    stale_s: float = 0.5
    partial_s: float = 5.0
    idle_s: float = 10.0
    retry_s: float = 1.0
    jump_s: float = 1.0
    farthest_mm: float = 10_000.0
    skew: float = 1e-3
    most_bytes: int = 1_000_000
    most_skipped_bytes: int = 64_000_000
    most_unsent_bytes: int = 8_000_000
    most_peers: int = 8
    most_waiting: int = 1000
    most_names: int = 1000

    def __post_init__(self) -> None:
        check_choice("surface", self.surface, SURFACES, ArgumentError)
        for name in ("spread_s", "gather_s", "stale_s", "partial_s", "idle_s", "retry_s", "jump_s"):
            real(name, getattr(self, name), above=0.0, unit="s")
        real("farthest_mm", self.farthest_mm, above=0.0, unit="mm")
        real("skew", self.skew, above=0.0)
        for name in (
            "most_bytes",
            "most_skipped_bytes",
            "most_unsent_bytes",
            "most_peers",
            "most_waiting",
            "most_names",
        ):
            whole(name, getattr(self, name), least=1, most=2**40)
