"""Register a deformed soft organ to a few tracked markers, with honest uncertainty.

>>> import tissuereg as tr
>>> mesh = tr.phantom.phantom_mesh()
>>> mesh.n_nodes
4258
"""

from tissuereg import effects, errors, phantom, tracking
from tissuereg._version import __version__
from tissuereg.advise import MarkerAdvice, advise_markers
from tissuereg.diagnose import diagnose
from tissuereg.diagnose.many import diagnose_many
from tissuereg.errors import TissueRegError
from tissuereg.experiment import Experiment
from tissuereg.frames import register_frame
from tissuereg.io.datasets import open_dataset
from tissuereg.io.experiment_out import write_experiment
from tissuereg.io.experiments import read_experiment
from tissuereg.io.material_experiments import read_material_experiment
from tissuereg.io.meshes import read_mesh
from tissuereg.io.tables import read_markers, read_surface, read_targets
from tissuereg.load import Load
from tissuereg.markers import Markers
from tissuereg.material import Fibre, Material
from tissuereg.mesh import Mesh
from tissuereg.meshing import FilledMesh, tetrahedralize
from tissuereg.registrar import Registrar
from tissuereg.registration import RegisterSettings, register
from tissuereg.registrations import register_many
from tissuereg.result import Registration
from tissuereg.simulate import Simulation, Simulator, simulate
from tissuereg.simulate.believed import simulate_experiment
from tissuereg.simulate.fine import FineModel
from tissuereg.studies import reproduce
from tissuereg.tracking import Tracker
from tissuereg.triangles import Triangles

__all__ = [
    "Experiment",
    "Fibre",
    "FilledMesh",
    "FineModel",
    "Load",
    "MarkerAdvice",
    "Markers",
    "Material",
    "Mesh",
    "RegisterSettings",
    "Registrar",
    "Registration",
    "Simulation",
    "Simulator",
    "TissueRegError",
    "Tracker",
    "Triangles",
    "__version__",
    "advise_markers",
    "diagnose",
    "diagnose_many",
    "effects",
    "errors",
    "open_dataset",
    "phantom",
    "read_experiment",
    "read_markers",
    "read_material_experiment",
    "read_mesh",
    "read_surface",
    "read_targets",
    "register",
    "register_frame",
    "register_many",
    "reproduce",
    "simulate",
    "simulate_experiment",
    "tetrahedralize",
    "tracking",
    "write_experiment",
]
