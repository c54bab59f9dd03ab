"""Is the input misread? Other units, frames, orders and motions weighed against it, from geometry alone.

`suspect` answers before anything is solved. All readings share one likelihood (`likelihood`): places on the skin, and
a motion that one soft body can make. `frames`, `rigid` and `orders` propose readings, `weigh` compares them, `repeats`
finds numbers that no measurement repeats, `words` says it.
"""

from tissuereg.readings.judge import suspect
from tissuereg.readings.words import Suspicion

__all__ = ["Suspicion", "suspect"]
