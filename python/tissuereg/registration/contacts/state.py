"""A state of the body between rest and the measured deformation, and its rigid motion in the tracker's frame."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A rigid motion x -> R x + s, which takes a place in the body's frame to the tracker's frame.

    `rotation` (3, 3): R; `shift` (3,): s, mm.
    """

    rotation: FloatArray
    shift: FloatArray

    @classmethod
    def still(cls) -> "RigidMotion":
        """Return the motion without rotation and shift, the identity."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def between(cls, body: FloatArray, tracker: FloatArray) -> "RigidMotion":
        """Return the rigid motion that takes `body` (n, 3) to `tracker` (n, 3), mm, best by least squares (Kabsch)."""
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
        """Return places (..., 3), mm, in the tracker's frame, given them in the body's frame."""
        return np.asarray(places @ self.rotation.T + self.shift)

    def undo(self, places: FloatArray) -> FloatArray:
        """Return places (..., 3), mm, in the body's frame, given them in the tracker's frame."""
        return np.asarray((places - self.shift) @ self.rotation)

    def followed_by(self, coefficients: FloatArray, rigid: FloatArray) -> "RigidMotion":
        """Return the motion that first applies a small one in the body's frame, then this one.

        `coefficients` (6,): translations in mm, then rotations as displacements in mm at a distance from the pivot;
        `rigid` (2, 3): pivot of the rotations, mm, and three times that distance, mm.
        """
        pivot, length = rigid
        turn = _rotation(coefficients[3:] / length[0])
        # x -> pivot + turn (x - pivot) + t, then this motion.
        move = pivot - turn @ pivot + coefficients[:3]
        return RigidMotion(self.rotation @ turn, self.rotation @ move + self.shift)


def _rotation(vector: FloatArray) -> FloatArray:
    """Return the rotation matrix (3, 3) about the axis `vector` (3,) by its length in radian (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


@dataclass(eq=False)
class BodyState:
    """A body in equilibrium under some coefficients of the causes, with its rigid motion in the tracker's frame.

    `coefficients` (n_columns,): of all possible causes (forces on patches, body force, ...), mm; `displacement`
    (n_element_nodes, 3): of the equilibrium, in the body's frame, mm; `frame`: rigid motion from the body's frame to
    the tracker's; `beside` (n_nodes, 3): displacement beside the equilibrium, in the body's frame, mm; None for none.
    """

    coefficients: FloatArray
    displacement: FloatArray
    frame: RigidMotion
    beside: FloatArray | None = None

    @property
    def moved(self) -> FloatArray:
        """Displacement of the nodes, in the body's frame, in mm; (n_nodes, 3) where there is one beside equilibrium."""
        if self.beside is None:
            return self.displacement
        return np.asarray(self.displacement[: len(self.beside)] + self.beside)
