"""Experiment folders of a small rig, written as a user would write them."""

import numpy as np

from support.meshes import block
from tissuereg.io.meshes import write_vtu

UP_AND_DOWN = np.concatenate([np.linspace(0.0, 1.0, 4), np.ones(4), np.linspace(1.0, 0.0, 4)])

TOML = """\
name = "pushed block"
[mesh]
file = "mesh.vtu"
[material]
young_kpa = [10.0, 3.0]
poisson = 0.42
[forces]
std_mN = 5.0
[markers]
std_mm = 0.05
rest_case = "rest"
[markers.reference]
{markers}
[[boundary]]
name = "base"
nodes = "fixed"
kind = "fixed"
{pads}
"""


def write_rig(folder, pads):
    """Write a block of 180 nodes with pads on top and at a side, given by balls or by node sets, nothing measured."""
    mesh = block((40.0, 30.0, 30.0), (5, 5, 4))
    places = {"top": (16.0, 12.0, 30.0), "side": (40.0, 18.0, 22.5)}
    motions = {"top": (0.5, 0.0, -3.5), "side": (-3.0, 0.0, 0.5)}
    tables = []
    for name, centre in places.items():
        mesh = mesh.with_node_set(f"{name}_set", mesh.surface_nodes_within(centre, 8.5))
        rule = f"{{ centre_mm = {list(centre)}, radius_mm = 8.5 }}" if pads == "balls" else f'"{name}_set"'
        tables.append(f'[[actuator]]\nname = "{name}"\nnodes = {rule}\nkind = "displacement"')
    free = np.setdiff1d(mesh.surface_nodes, np.concatenate([*mesh.node_sets.values()]))
    markers = mesh.nodes[np.random.default_rng(2).choice(free[mesh.nodes[free, 2] > 5.0], 10, replace=False)]
    lines = "\n".join(f"P{number} = {place.tolist()}" for number, place in enumerate(markers))
    folder.mkdir()
    write_vtu(folder / "mesh.vtu", mesh)
    (folder / "experiment.toml").write_text(TOML.format(markers=lines, pads="\n".join(tables)))
    seen = ["case,time_s,marker,x_mm,y_mm,z_mm", *(f"rest,{0.5 * frame},P0,,," for frame in range(10))]
    moved, felt = ["case,time_s,actuator,x_mm,y_mm,z_mm"], ["case,time_s,actuator,x_mN,y_mN,z_mN"]
    for case, (name, motion) in enumerate(motions.items(), start=1):
        for frame, share in enumerate(UP_AND_DOWN):
            head = f"{name},{20.0 * case + 0.5 * frame},{name}"
            moved.append(",".join([head, *map(str, share * np.array(motion))]))
            felt.append(f"{head},,,")
            seen.append(f"{name},{20.0 * case + 0.5 * frame},P0,,,")
    for table, rows in (("markers", seen), ("actuators", moved), ("forces", felt)):
        (folder / f"{table}.csv").write_text("\n".join(rows) + "\n")
    return folder
