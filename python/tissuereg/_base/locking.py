"""The warning that linear tets lock, issued at the line that uses them."""

import sys
import warnings
from types import FrameType

from tissuereg.errors import LockingWarning


def warn_of_locking(poisson: float) -> None:
    """Warn at the first line outside this package.

    The core calls it wherever a body of four-node tets meets a material of `Material::locks_linear_tets`. `poisson`:
    largest Poisson's ratio.
    """
    level = 1
    frame: FrameType | None = sys._getframe()
    while frame is not None and str(frame.f_globals.get("__name__")).split(".")[0] == "tissuereg":
        level, frame = level + 1, frame.f_back
    text = f"four-node tets lock at Poisson's ratio {poisson:g} and move too little; "
    warnings.warn(text + 'element="tet4-averaged" or "tet10" does not', LockingWarning, stacklevel=level)
