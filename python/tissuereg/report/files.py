"""The files of a registration, written all or none."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg.io.atomic import atomic_folder
from tissuereg.io.json import write_json
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import write_targets

if TYPE_CHECKING:
    from tissuereg.result import Registration


def save_registration(result: "Registration", folder: Path, extra: dict[str, Any]) -> Path:
    """Write ``registered.vtu``, ``targets.csv``, ``registration.json`` and ``registered.png``.

    Parameters
    ----------
    result : Registration
        What to write.
    folder : Path
        Made where absent.
    extra : dict
        Entries added to the JSON, or put over its own.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    OutputError
        If the folder cannot be written; nothing is changed then.
    """
    fields = {"displacement_mm": result.displacement, "std_mm": result.std}
    if result.forces is not None:
        fields["contact_force_mN"] = result.forces
    held = np.zeros(result.mesh.n_nodes, dtype=np.int8)
    held[result.mesh.node_sets.get("fixed", np.empty(0, np.int64))] = 1
    content = result.to_json()
    with atomic_folder(folder) as draft:
        write_vtu(draft / "registered.vtu", result.mesh, {**fields, "fixed": held})
        write_targets(draft / "targets.csv", content["targets"])
        write_json(draft / "registration.json", {**content, **extra})
        result.plot().savefig(draft / "registered.png", dpi=110)
    return folder
