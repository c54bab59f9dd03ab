"""The warning that linear tets lock (are too stiff near incompressibility), issued at the line that uses them."""

from tissuereg._base.provenance import warn
from tissuereg.errors import LockingWarning


def warn_of_locking(poisson: float) -> None:
    """Issue `LockingWarning`.

    The core calls it where a body of four-node tets has a material whose Poisson's ratio is so high that such tets lock
    (`Material::locks_linear_tets`). `poisson`: largest Poisson's ratio of the body.
    """
    text = f"four-node tets lock at Poisson's ratio {poisson:g} and move too little; "
    warn(text + 'element="tet4-averaged" or "tet10" does not', LockingWarning)
