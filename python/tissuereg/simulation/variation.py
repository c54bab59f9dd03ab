"""Random variations of the believed model: modulus, size and direction of loads and motions."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh


@dataclass(frozen=True)
class Variation:
    """Standard deviations of the variations.

    Parameters
    ----------
    young_log_std : float
        Standard deviation of the logarithm of Young's modulus.
    load_log_std : float
        The same for the size of every believed load.
    load_tilt_deg : float
        Standard deviation of a load's rotation about each axis, degrees.
    motion_log_std, motion_tilt_deg : float
        The same two for prescribed displacements.
    """

    young_log_std: float = 0.25
    load_log_std: float = 0.05
    load_tilt_deg: float = 3.0
    motion_log_std: float = 0.03
    motion_tilt_deg: float = 2.0

    def draw(self, load: Load, material: Material, rng: np.random.Generator) -> tuple[Load, Material]:
        """Return one variation of a load and a material.

        Parameters
        ----------
        load : Load
            The believed load.
        material : Material
            The believed material.
        rng : numpy.random.Generator
            Source of random numbers; the same numbers are drawn whatever the load holds.

        Returns
        -------
        load, material : Load, Material
            Forces, body force, traction and motions, each rotated and scaled independently.
        """
        softer = float(np.exp(self.young_log_std * rng.standard_normal()))
        force, weight, pull = (_turn(rng, self.load_log_std, self.load_tilt_deg) for _ in range(3))
        push = _turn(rng, self.motion_log_std, self.motion_tilt_deg)
        varied = Load(
            None if load.forces is None else np.asarray(load.forces, np.float64) @ force.T,
            None if load.body_force is None else weight @ np.asarray(load.body_force, np.float64),
            None if load.prescribed is None else np.asarray(load.prescribed, np.float64) @ push.T,
            None if load.traction is None else (load.traction[0], np.asarray(load.traction[1], np.float64) @ pull.T),
        )
        return varied, material.scaled(softer)


def _turn(rng: np.random.Generator, log_std: float, tilt_deg: float) -> FloatArray:
    """Return a small random rotation times a factor near one, shape (3, 3)."""
    from scipy.spatial.transform import Rotation

    vector = np.deg2rad(tilt_deg) * rng.standard_normal(3)
    return np.asarray(Rotation.from_rotvec(vector).as_matrix() * np.exp(log_std * rng.standard_normal()))


def random_inclusion(
    mesh: Mesh, rng: np.random.Generator, radius: tuple[float, float], contrast: tuple[float, float]
) -> FloatArray:
    """Return the factor on Young's modulus of every tet for a ball around a random node.

    `mesh`: reference shape; `rng`: source of random numbers; `radius`: range of the ball's radius in mm; `contrast`:
    range of the modulus inside over that outside. Result: (n_tets,), `contrast` where a tet's centre lies in the ball,
    1 elsewhere.
    """
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    centre = mesh.nodes[rng.integers(mesh.n_nodes)]
    size, factor = rng.uniform(*radius), rng.uniform(*contrast)
    return np.where(np.linalg.norm(centres - centre, axis=1) <= size, factor, 1.0)
