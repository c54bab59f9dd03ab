"""The files of a registration, of which either all are written or none."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg.io.atomic import atomic_folder
from tissuereg.io.json import write_json
from tissuereg.io.meshes import write_vtu
from tissuereg.io.mrk_json import write_mrk_json
from tissuereg.io.tables import write_targets
from tissuereg.registration.stored import FIELD, write_field

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration


#: What `save_registration` writes.
PICTURE = "registered.png"
WRITTEN = ("registered.vtu", FIELD, "targets.csv", "targets.mrk.json", "registration.json", PICTURE)

#: What it writes on request.
DEFORMED = "registered_deformed.vtu"
PAGE = "report.html"


def save_registration(
    result: "Registration",
    folder: Path,
    extra: dict[str, Any],
    *,
    deformed: bool = False,
    picture: bool = True,
    image: Any = None,
) -> Path:
    """Write a registration's mesh, tables, JSON and picture into a folder, all or none; return the folder.

    The files are those in `WRITTEN`, with `deformed` also a mesh whose nodes are displaced, without `picture` not
    `PICTURE`, with an `image`, a file, also `PAGE`. Entries of `extra` are added to the JSON and replace its own of the
    same name. Raises OutputError if the folder cannot be written; nothing
    is changed then.
    """
    mesh = result.mesh
    fields = {"displacement_mm": result.displacement, "std_mm": result.std}
    forces = getattr(result, "forces", None)
    if forces is not None:
        fields["contact_force_mN"] = forces
    held = np.zeros(mesh.n_nodes, dtype=np.int8)
    held[mesh.node_sets.get("fixed", np.empty(0, np.int64))] = 1
    content = result.to_json()
    with atomic_folder(folder) as draft:
        values = {**fields, "fixed": held}
        write_vtu(draft / "registered.vtu", mesh, values, says="points_are_undeformed_warp_by_displacement_mm")
        if deformed:
            says = "points_are_warped_by_displacement_mm_already"
            write_vtu(draft / DEFORMED, mesh, values, says=says, places=mesh.nodes + result.displacement)
        write_field(draft / FIELD, result.field)
        write_targets(draft / "targets.csv", content["targets"])
        write_mrk_json(draft / "targets.mrk.json", _labelled(content), mesh.frame)
        write_json(draft / "registration.json", {**content, **extra})
        if picture:
            (draft / PICTURE).write_bytes(result.picture)
        if image is not None:
            result.report(draft / PAGE, image=image)
    return folder


def _labelled(content: dict[str, Any]) -> dict[str, tuple[list[float], str]]:
    """Return registered places in mm by target name, each with a text for viewers: trust, flag, size of the region."""
    trusted = [] if content["trust"]["ok"] else ["do not trust this registration"]
    points = {}
    for name, target in content["targets"].items():
        axes = " x ".join(f"{radius:.2f}" for radius in target["region90_radii_mm"])
        flag = [] if target["flag"] is None else [target["flag"]]
        points[name] = (target["mean_mm"], "; ".join([*trusted, *flag, f"90 % region with half-axes {axes} mm"]))
    return points
