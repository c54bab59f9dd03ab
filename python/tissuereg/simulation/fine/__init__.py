"""A reference model with an error far below the measurement noise: pads cut out of the mesh, ten-node elements."""

from tissuereg.simulation.fine.meshing import FineMeshing, fine_experiment
from tissuereg.simulation.fine.model import FineModel, rough_element, without_time
from tissuereg.simulation.fine.third import third_meshes

__all__ = ["FineMeshing", "FineModel", "fine_experiment", "rough_element", "third_meshes", "without_time"]
