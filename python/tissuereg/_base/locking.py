"""The warning that linear tets lock (are too stiff near incompressibility), issued at the line that uses them."""

import sys
import warnings
from types import FrameType

from tissuereg.errors import LockingWarning


def warn_of_locking(poisson: float) -> None:
    """Issue `LockingWarning`, located at the innermost calling line that lies outside this package.

    The core calls it where a body of four-node tets has a material whose Poisson's ratio is so high that such tets lock
    (`Material::locks_linear_tets`). `poisson`: largest Poisson's ratio of the body.
    """
    level = 1
    frame: FrameType | None = sys._getframe()
    while frame is not None and str(frame.f_globals.get("__name__")).split(".")[0] == "tissuereg":
        level, frame = level + 1, frame.f_back
    text = f"four-node tets lock at Poisson's ratio {poisson:g} and move too little; "
    warnings.warn(text + 'element="tet4-averaged" or "tet10" does not', LockingWarning, stacklevel=level)
