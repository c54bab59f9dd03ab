"""A state of the body between rest and the measured deformation."""

from dataclasses import dataclass

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.contacts.frame import RigidMotion


@dataclass(eq=False)
class BodyState:
    """Coefficients, the equilibrium under them, and the frame.

    Attributes
    ----------
    coefficients : ndarray of float64, shape (n_columns,)
        Of all causes.
    displacement : ndarray of float64, shape (n_element_nodes, 3)
        In the body's frame, mm.
    frame : RigidMotion
        From the body's frame to the tracker's.
    """

    coefficients: FloatArray
    displacement: FloatArray
    frame: RigidMotion
