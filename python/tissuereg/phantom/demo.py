"""A registration of the embedded phantom, end to end, with its errors against the simulated truth."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.clock import Clock
from tissuereg.io.atomic import atomic_folder
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import write_markers, write_points
from tissuereg.phantom.event import LESION_MM, PhantomEvent, make_event
from tissuereg.registration.register import register
from tissuereg.registration.result import Registration
from tissuereg.registration.settings import RegisterSettings
from tissuereg.simulation.solve import simulate


def run_demo(out: str | os.PathLike[str], *, seed: int = 0, threads: int = 0) -> dict[str, Any]:
    """Register the breast phantom, write the result into the folder `out`, and return the result as JSON data.

    Written are ``registered.vtu``, ``targets.csv``, ``targets.mrk.json``, ``registration.json``, ``registered.png``,
    ``report.html``, and ``input/`` with the mesh, markers, targets and simulation that the command ``register`` takes.
    The data have an entry ``truth`` with the mean Euclidean errors in mm before and after registration, at the markers,
    at the lesion and over the body, and with whether the lesion's 90 % region contains its true place. `seed`
    determines the markers' places, their noise and the ensemble; the result does not depend on `threads` (0: all
    cores).
    """
    clock = Clock()
    with clock.stage("measure"):
        event = make_event(seed=seed)
    with clock.stage("simulate"):
        simulation = simulate(event.mesh, event.load, event.material, threads=threads).displacement
    result = register(
        event.mesh,
        event.markers,
        model="phantom",
        simulation=simulation,
        targets={"lesion": LESION_MM},
        seed=seed,
        settings=RegisterSettings(threads=threads),
    )
    seconds = {**clock.seconds, **result.seconds}
    seconds["total"] += sum(clock.seconds.values())
    answer = {**result.to_json(), "truth": _errors(event, simulation, result), "seconds": seconds}
    with atomic_folder(out) as draft:
        result.save(draft, {"truth": answer["truth"], "seconds": seconds})
        result.report(draft / "report.html")
        _write_input(draft / "input", event, simulation)
    return answer


def _write_input(folder: Path, event: PhantomEvent, simulation: FloatArray) -> None:
    """Write mesh, markers, target and simulation (n_nodes, 3), mm, into `folder` as input files of ``register``."""
    folder.mkdir()
    held = np.zeros(event.mesh.n_nodes, dtype=np.int8)
    held[event.mesh.fixed_nodes] = 1
    write_vtu(folder / "body.vtu", event.mesh, {"fixed": held})
    write_markers(folder / "markers.csv", event.markers)
    write_points(folder / "targets.csv", {"lesion": LESION_MM})
    np.savez_compressed(folder / "simulation.npz", displacement_mm=simulation)


def _errors(event: PhantomEvent, simulation: FloatArray, result: Registration) -> dict[str, Any]:
    """Return the mean Euclidean errors in mm before and after registration, at markers, at the lesion, over the body.

    `simulation` (n_nodes, 3): displacement that the believed model predicts, mm; this is the state before registration.
    """
    lesion = result.target("lesion")
    registered = event.markers.measured - np.array([result.markers.residual_mm[n] for n in event.markers.names])
    true_places = event.markers.reference + event.true_markers
    before = lesion.simulation if lesion.simulation is not None else lesion.reference
    return {
        "markers": {
            "before_mm": _mean(result.start_markers - true_places),
            "after_mm": _mean(registered - true_places),
        },
        "targets": {
            "lesion": {
                "true_mm": event.true_lesion.tolist(),
                "before_mm": _mean(before - event.true_lesion),
                "after_mm": _mean(lesion.mean - event.true_lesion),
                "inside_region90": lesion.region(0.90).contains(event.true_lesion),
            }
        },
        "body": {
            "before_mm": _mean(simulation - event.true_displacement),
            "after_mm": _mean(result.displacement - event.true_displacement),
        },
    }


def _mean(vectors: FloatArray) -> float:
    return float(np.linalg.norm(np.atleast_2d(vectors), axis=1).mean())
