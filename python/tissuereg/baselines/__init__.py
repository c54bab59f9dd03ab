"""Baselines without simulation: rigid motion and spline through the markers, copying the neighbours."""

from tissuereg.baselines.copy import copied_displacement
from tissuereg.baselines.rigid import rigid_displacement
from tissuereg.baselines.spline import spline_displacement

__all__ = ["copied_displacement", "rigid_displacement", "spline_displacement"]
