"""Live registration over OpenIGTLink: markers come in as messages, the registered body goes out with its spread.

`protocol` packs and unpacks messages, `frames` makes frames of markers of them, `answers` makes messages of results,
and `server` joins them with a tracker. Everything is bounded: the newest frame is registered, never a queue of them.
"""

from tissuereg.live.server import LiveServer
from tissuereg.live.settings import LiveSettings

__all__ = ["LiveServer", "LiveSettings"]
