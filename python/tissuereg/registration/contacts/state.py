"""A state of the body between rest and the measured deformation, and its rigid motion in the tracker's frame."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray

#: How the tracker's frame may behave relative to a body that is held.
TRACKERS = ("fixed", "drifts")


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A rotation and a translation: tracker place = rotation body place + shift.

    `rotation` (3, 3): T_tracker_from_body's rotation; `shift` (3,): mm.
    """

    rotation: FloatArray
    shift: FloatArray

    @classmethod
    def still(cls) -> "RigidMotion":
        """Return the identity."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def between(cls, body: FloatArray, tracker: FloatArray) -> "RigidMotion":
        """Return the best rigid motion (Kabsch) of places (n, 3) to places (n, 3)."""
        middle, goal = body.mean(axis=0), tracker.mean(axis=0)
        u, _, vt = np.linalg.svd((tracker - goal).T @ (body - middle))
        proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
        rotation = u @ proper @ vt
        return cls(rotation, goal - rotation @ middle)

    @property
    def moves(self) -> bool:
        """Whether this motion is not the identity."""
        return not (np.array_equal(self.rotation, np.eye(3)) and not self.shift.any())

    def apply(self, places: FloatArray) -> FloatArray:
        """Return where the tracker sees places (..., 3), mm, that are given in the body's frame."""
        return np.asarray(places @ self.rotation.T + self.shift)

    def undo(self, places: FloatArray) -> FloatArray:
        """Return places (..., 3), mm, in the body's frame, given where the tracker sees them."""
        return np.asarray((places - self.shift) @ self.rotation)

    def followed_by(self, coefficients: FloatArray, rigid: FloatArray) -> "RigidMotion":
        """Return this motion after a small one in the body's frame.

        `coefficients` (6,): translations in mm and rotations in mm at `rigid`'s length; `rigid` (2, 3): pivot and
        length, mm.
        """
        pivot, length = rigid
        turn = _rotation(coefficients[3:] / length[0])
        # x -> pivot + turn (x - pivot) + t, then this motion.
        move = pivot - turn @ pivot + coefficients[:3]
        return RigidMotion(self.rotation @ turn, self.rotation @ move + self.shift)


def _rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) about a vector (3,) by its length in radian (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


@dataclass(eq=False)
class BodyState:
    """A body in equilibrium: the load on it, its displacement, and where the tracker sees it.

    `coefficients` (n_columns,): of all causes; `displacement` (n_element_nodes, 3): in the body's frame, mm; `frame`:
    rigid motion from the body's frame to the tracker's.
    """

    coefficients: FloatArray
    displacement: FloatArray
    frame: RigidMotion
