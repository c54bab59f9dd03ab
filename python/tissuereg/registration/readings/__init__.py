"""Detection of misread input: other units, frames, orders of rows and rigid motions, from geometry alone.

`suspect` runs before anything is solved. A reading is one interpretation of the input, such as "the markers are in
metres". All readings are compared by one likelihood (`likelihood`): that of the distances of the markers from the
surface, and of their displacements as those of one soft body. `frames`, `rigid` and `orders` propose readings, `weigh`
compares them, `repeats` finds repeated numbers that no measurement would give, `words` writes the sentences.
"""

from tissuereg.registration.readings.judge import suspect
from tissuereg.registration.readings.words import Suspicion

__all__ = ["Suspicion", "suspect"]
