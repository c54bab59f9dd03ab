"""Files in and out: each format one module, units converted here and nowhere else.

Readers import meshio on first use only, so that importing tissuereg stays quick. Writers leave a
whole file or none.
"""

from tissuereg.io.experiment_out import write_experiment
from tissuereg.io.experiments import read_experiment
from tissuereg.io.meshes import read_mesh, write_vtu
from tissuereg.io.problems import Problem, read_problem, read_simulation, write_solution
from tissuereg.io.tables import read_markers, read_targets, write_targets

__all__ = [
    "Problem",
    "read_experiment",
    "read_markers",
    "read_mesh",
    "read_problem",
    "read_simulation",
    "read_targets",
    "write_experiment",
    "write_solution",
    "write_targets",
    "write_vtu",
]
