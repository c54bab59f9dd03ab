"""Studies of the paper and its contests with rival methods; uses the public names of `tissuereg`.

`reproduce` runs the studies, with `ContestInputs` for the phantom experiment; `RIVALS` are the methods that
registration is compared with. Which private modules of `tissuereg` are used, and why, says `private`.
"""

from tissuereg_paper._core import __version__
from tissuereg_paper.rivals import RIVALS
from tissuereg_paper.studies import ContestInputs, reproduce

__all__ = ["RIVALS", "ContestInputs", "__version__", "reproduce"]
