"""A drawing of one rig: body, supports, pads with their motion, markers, targets; for docs/experiment.md."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import tissuereg as tr

SUPPORT, PAD, SKIN, MARKER, TARGET = "#4d4d4d", "#0072b2", "#f1d9c8", "#d55e00", "#009e73"


def draw_rig(folder: Path, out: Path) -> None:
    """Draw the rig of an experiment folder.

    Parameters
    ----------
    folder : Path
        The experiment.
    out : Path
        The picture, PNG.
    """
    rig = tr.read_experiment(folder)
    mesh = rig.mesh
    figure = plt.figure(figsize=(8.4, 4.0), dpi=110)
    axes = figure.add_axes((0.02, -0.1, 0.6, 1.2), projection="3d", computed_zorder=False)
    axes.view_init(elev=16, azim=-8)
    axes.set_proj_type("ortho")
    held = np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)
    corners = mesh.nodes[mesh.surface]
    pads = {pad.name: np.isin(mesh.surface, pad.nodes).all(axis=1) for pad in rig.actuators}
    colours = np.full(len(corners), SKIN, dtype=object)
    colours[held] = SUPPORT
    for own in pads.values():
        colours[own] = PAD
    skin = Poly3DCollection(corners, facecolors=list(colours), edgecolors="#00000022", linewidths=0.4, alpha=0.62)
    axes.add_collection3d(skin)
    for pad in rig.actuators:
        case = next(case for case in rig.cases.values() if pad.name in case.displacements)
        motion = max(case.displacements[pad.name], key=np.linalg.norm)
        middle = mesh.nodes[pad.nodes].mean(axis=0)
        way = motion / np.linalg.norm(motion)
        axes.quiver(*(middle - 28 * way), *(24 * way), color=PAD, linewidth=2.6, arrow_length_ratio=0.3)
        axes.text(*(middle - 34 * way), f'[[actuator]]\n"{pad.name}"', color=PAD, fontsize=9, ha="right")
    axes.scatter(*rig.marker_reference.T, color=MARKER, s=26, depthshade=False, edgecolors="white", linewidths=0.5)
    for place in rig.targets.values():
        axes.scatter(*place, color=TARGET, s=90, marker="*", depthshade=False)
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    axes.set_box_aspect(high - low, zoom=1.05)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_axis_off()
    entries = (
        ("s", SKIN, "[mesh]: body at rest"),
        ("s", SUPPORT, "[[boundary]]: held nodes"),
        ("s", PAD, "[[actuator]]: pads; arrows: actuators.csv"),
        ("o", MARKER, "[markers.reference]: tracked points"),
        ("*", TARGET, "[[target]]: inner point"),
    )
    lines = [
        plt.Line2D([], [], marker=mark, color=colour, linestyle="", markersize=9, label=label, markeredgecolor="#555")
        for mark, colour, label in entries
    ]
    figure.legend(handles=lines, loc="center right", frameon=False, fontsize=9)
    figure.savefig(out)
    plt.close(figure)
