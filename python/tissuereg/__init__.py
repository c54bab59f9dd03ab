"""Register a deformed soft organ to a few tracked markers, with an uncertainty for every registered point.

>>> import tissuereg as tr
>>> mesh = tr.phantom.phantom_mesh()
>>> mesh.n_nodes
4258
"""

import importlib
from typing import TYPE_CHECKING, Any

from tissuereg._version import __version__

if TYPE_CHECKING:
    from tissuereg import errors, phantom, tracking
    from tissuereg._base.clock import Progress
    from tissuereg.body.load import Load
    from tissuereg.body.markers import Markers
    from tissuereg.body.material import Fibre, Material
    from tissuereg.body.mesh import Mesh
    from tissuereg.body.surface import SurfacePoints
    from tissuereg.body.triangles import Triangles
    from tissuereg.diagnosis import diagnose
    from tissuereg.diagnosis.many import diagnose_many
    from tissuereg.errors import TissueRegError
    from tissuereg.experiment import effects
    from tissuereg.experiment.experiment import Experiment
    from tissuereg.io.datasets import open_dataset
    from tissuereg.io.experiment_out import write_experiment
    from tissuereg.io.experiments import read_experiment
    from tissuereg.io.material_experiments import read_material_experiment
    from tissuereg.io.meshes import read_mesh
    from tissuereg.io.recordings import Recording, read_recording
    from tissuereg.io.tables import read_markers, read_seen, read_surface, read_targets
    from tissuereg.meshing import FilledMesh, tetrahedralize
    from tissuereg.registration.advise import MarkerAdvice, advise_markers
    from tissuereg.registration.body import Body
    from tissuereg.registration.contacts.result import ContactRegistration
    from tissuereg.registration.contacts.settings import ContactSettings
    from tissuereg.registration.frame import register_frame
    from tissuereg.registration.inputs import SimulationVariants
    from tissuereg.registration.learned.result import LearnedRegistration
    from tissuereg.registration.many import register_many
    from tissuereg.registration.register import register
    from tissuereg.registration.registrar import Registrar
    from tissuereg.registration.result import Registration
    from tissuereg.registration.settings import RegisterSettings, SmootherSettings
    from tissuereg.registration.stored import StoredRegistration, read_registration
    from tissuereg.simulation import Simulation, Simulator, simulate
    from tissuereg.simulation.believed import simulate_experiment
    from tissuereg.simulation.fine import FineModel
    from tissuereg.tracking import Tracker

#: The module of each public name, loaded when the name is first used: `import tissuereg` stays quick.
_MODULES = {
    "errors": "tissuereg.errors",
    "phantom": "tissuereg.phantom",
    "tracking": "tissuereg.tracking",
    "effects": "tissuereg.experiment.effects",
    "Load": "tissuereg.body.load",
    "Markers": "tissuereg.body.markers",
    "Fibre": "tissuereg.body.material",
    "Material": "tissuereg.body.material",
    "Mesh": "tissuereg.body.mesh",
    "Triangles": "tissuereg.body.triangles",
    "diagnose": "tissuereg.diagnosis",
    "diagnose_many": "tissuereg.diagnosis.many",
    "TissueRegError": "tissuereg.errors",
    "Experiment": "tissuereg.experiment.experiment",
    "open_dataset": "tissuereg.io.datasets",
    "write_experiment": "tissuereg.io.experiment_out",
    "read_experiment": "tissuereg.io.experiments",
    "read_material_experiment": "tissuereg.io.material_experiments",
    "read_mesh": "tissuereg.io.meshes",
    "Recording": "tissuereg.io.recordings",
    "read_recording": "tissuereg.io.recordings",
    "read_markers": "tissuereg.io.tables",
    "read_seen": "tissuereg.io.tables",
    "read_surface": "tissuereg.io.tables",
    "read_targets": "tissuereg.io.tables",
    "FilledMesh": "tissuereg.meshing",
    "tetrahedralize": "tissuereg.meshing",
    "MarkerAdvice": "tissuereg.registration.advise",
    "advise_markers": "tissuereg.registration.advise",
    "register_frame": "tissuereg.registration.frame",
    "register_many": "tissuereg.registration.many",
    "Body": "tissuereg.registration.body",
    "ContactRegistration": "tissuereg.registration.contacts.result",
    "ContactSettings": "tissuereg.registration.contacts.settings",
    "LearnedRegistration": "tissuereg.registration.learned.result",
    "Progress": "tissuereg._base.clock",
    "RegisterSettings": "tissuereg.registration.settings",
    "SimulationVariants": "tissuereg.registration.inputs",
    "SmootherSettings": "tissuereg.registration.settings",
    "SurfacePoints": "tissuereg.body.surface",
    "register": "tissuereg.registration.register",
    "Registrar": "tissuereg.registration.registrar",
    "Registration": "tissuereg.registration.result",
    "StoredRegistration": "tissuereg.registration.stored",
    "read_registration": "tissuereg.registration.stored",
    "Simulation": "tissuereg.simulation",
    "Simulator": "tissuereg.simulation",
    "simulate": "tissuereg.simulation",
    "simulate_experiment": "tissuereg.simulation.believed",
    "FineModel": "tissuereg.simulation.fine",
    "Tracker": "tissuereg.tracking",
}

#: Public names that are modules themselves.
_ROOMS = ("effects", "errors", "phantom", "tracking")

__all__ = [
    "Body",
    "ContactRegistration",
    "ContactSettings",
    "Experiment",
    "Fibre",
    "FilledMesh",
    "FineModel",
    "LearnedRegistration",
    "Load",
    "MarkerAdvice",
    "Markers",
    "Material",
    "Mesh",
    "Progress",
    "Recording",
    "RegisterSettings",
    "Registrar",
    "Registration",
    "Simulation",
    "SimulationVariants",
    "Simulator",
    "SmootherSettings",
    "StoredRegistration",
    "SurfacePoints",
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
    "read_recording",
    "read_registration",
    "read_seen",
    "read_surface",
    "read_targets",
    "register",
    "register_frame",
    "register_many",
    "simulate",
    "simulate_experiment",
    "tetrahedralize",
    "tracking",
    "write_experiment",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        message = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(message)
    module = importlib.import_module(_MODULES[name])
    found = module if name in _ROOMS else getattr(module, name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
