"""Contacts: dead tractions, pads that are bonded and pads that slide, as tractions and ties on a surface.

The traction of a contact at an amplitude a is ``a load(X) - tie(X) u``: both fields are fixed, so amplitudes and their
first answers are linear.
"""

from dataclasses import asdict, dataclass

import numpy as np

#: Penalty that ties a pad to the body, kPa/mm; the body's own stiffness is near 1.
TIE = 3000.0

PROFILES = ("uniform", "parabolic", "lopsided")


@dataclass(frozen=True)
class Contact:
    """One contact on the free surface; lengths in mm.

    Parameters
    ----------
    kind : str
        "traction": dead load; "bonded": glued pad that moves and turns; "sliding": frictionless pad that gives the
        normal displacement.
    centre, normal, side : tuple of float
        Where, the outward normal there, and a unit tangent along which the patch has its first radius.
    radii : tuple of float
        Half lengths of the patch along `side` and across it.
    direction : tuple of float
        Unit vector of the traction or of the pad's stroke.
    profile : str
        Of a traction: see `PROFILES`.
    turn : tuple of float
        Rotation vector of a bonded pad in radians for 1 mm of stroke.
    """

    kind: str
    centre: tuple
    normal: tuple
    side: tuple
    radii: tuple
    direction: tuple
    profile: str = "uniform"
    turn: tuple = (0.0, 0.0, 0.0)

    def reach(self, points, normals):
        """Return the distance from the centre over the radius, (...,), infinite on other sides of the body."""
        off = points - np.asarray(self.centre)
        normal, side = np.asarray(self.normal), np.asarray(self.side)
        along, across, up = off @ side, off @ np.cross(normal, side), off @ normal
        far = np.sqrt((along / self.radii[0]) ** 2 + (across / self.radii[1]) ** 2)
        same = (normals @ normal > 0.3) & (np.abs(up) < max(self.radii))
        return np.where(same, far, np.inf)

    def fields(self, points, normals):
        """Return load (..., 3) in kPa at amplitude 1 and tie (..., 3, 3) in kPa/mm."""
        far = self.reach(points, normals)
        on = far < 1.0
        direction = np.asarray(self.direction)
        if self.kind == "traction":
            return self._profile(points, far)[..., None] * direction, np.zeros((*far.shape, 3, 3))
        hold = TIE * on[..., None, None]
        tie = hold * (np.outer(self.normal, self.normal) if self.kind == "sliding" else np.eye(3))
        motion = direction + np.cross(np.asarray(self.turn), points - np.asarray(self.centre))
        return np.einsum("...xy,...y->...x", tie, motion), tie

    def _profile(self, points, far):
        inside = np.clip(1.0 - np.where(np.isfinite(far), far, 2.0) ** 2, 0.0, None)
        if self.profile == "uniform":
            return (inside > 0).astype(float)
        if self.profile == "parabolic":
            return inside
        return inside * (1.0 + 0.8 * ((points - np.asarray(self.centre)) @ np.asarray(self.side)) / self.radii[0])

    def description(self):
        """Return the contact as plain data."""
        return asdict(self)
