"""The silicone beam with an unknown load: registered to two tip markers, evaluated at the third."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import tissuereg as tr

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def example() -> ModuleType:
    """Return the example, which reads mesh and recordings."""
    if str(EXAMPLES) not in sys.path:
        sys.path.append(str(EXAMPLES))
    return import_module("beam")


def run(mesh: tr.Mesh, path: Path, element: str = "tet10") -> dict[str, Any]:
    """Return one row of the table."""
    beam = example()
    places = beam.read_trial(path)
    names = (*beam.FITTED, beam.HELD_OUT)
    before, after = (np.array([places[name][i] for name in names]) for i in (0, 1))
    seen = np.where(np.isin(names, beam.FITTED)[:, None], after, np.nan)
    result = tr.register(
        tr.Body(mesh, material=tr.Material(263.8, beam.POISSON, density=beam.DENSITY_G_PER_CM3), element=element),
        tr.Markers(before, seen, beam.MARKER_STD_MM, names),
    )
    found = result.unseen[beam.HELD_OUT]
    return {
        "trial": path.stem,
        "moved_mm": float(np.linalg.norm(after[2] - before[2])),
        "error_mm": float(np.linalg.norm(found.mean - after[2])),
        "error_xyz_mm": (found.mean - after[2]).tolist(),
        "std_xyz_mm": np.sqrt(np.diag(found.covariance)).tolist(),
        "inside_region90": found.region(0.90).contains(after[2]),
        "flag": found.flag,
        "trust": result.trust.ok,
        "passes": result.work["passes"],
    }
