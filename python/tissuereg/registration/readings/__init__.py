"""Detects misread input: other units, frames, orders and rigid motions, from geometry alone.

`suspect` runs before anything is solved. A reading is one interpretation of the input, such as "the markers are in
metres". All readings are compared by one likelihood (`likelihood`) of the places on the skin and of the motion as that
of one soft body. `frames`, `rigid` and `orders` propose readings, `weigh` compares them, `repeats` finds repeated
numbers that no measurement would give, `words` writes the sentences.
"""

from tissuereg.registration.readings.judge import suspect
from tissuereg.registration.readings.words import Suspicion

__all__ = ["Suspicion", "suspect"]
