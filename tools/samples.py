"""Make the files of ``tissuereg demo --files``: a surface with its markers, a segmentation, an experiment.

    python tools/samples.py           # needs the extras `mesh` and `images`
    python tools/samples.py --scan    # the segmentation and the point lists alone, of the surface that is there

writes ``python/tissuereg/phantom/samples/data``. The organ is a smooth made-up shape, about 150 x 90 x 50 mm. Its
"measurement" is made on another mesh than a user's, with ten-node elements, another stiffness and a stiff lesion; the
experiment's by the fine model with a stiff inclusion that its file does not mention. The mesher uses random numbers, so
a second run gives slightly different files.
"""

import json
import shutil
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import own_sources  # noqa: F401 (before the package)
import trimesh

import tissuereg as tr
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.body.surface import evenly
from tissuereg.experiment.effects import Inclusion
from tissuereg.experiment.experiment import Simulated
from tissuereg.imaging.images import Grid, write_image
from tissuereg.io.cases import write_histories
from tissuereg.io.experiment_keys import ACTUATORS_CSV
from tissuereg.io.experiment_out import write_simulated
from tissuereg.io.meshes import write_vtu
from tissuereg.io.mrk_json import write_mrk_json
from tissuereg.io.tables import write_markers, write_points
from tissuereg.io.toml_text import write_toml
from tissuereg.simulation.experiment import with_noise

DATA = Path(__file__).resolve().parent.parent / "python" / "tissuereg" / "phantom" / "samples" / "data"
SEED = 12

#: The organ lies on its back, the plane z = -18 mm.
HELD = "plane 0 0 1 -18 2.5"
LESION_MM, LESION_RADIUS_MM, LESION_CONTRAST = (22.0, 4.0, 4.0), 8.0, 4.0
VESSEL_MM = (-52.0, 2.0, 14.0)
TRUE_YOUNG, TRUE_POISSON = 7.5, 0.46
PUSH_AT_MM, PUSH_RADIUS_MM, PUSH_MM = (34.0, -22.0, 24.0), 13.0, (-3.0, 6.0, -11.0)
N_MARKERS, MARKER_STD_MM = 15, 0.1


def organ() -> trimesh.Trimesh:
    """Return the closed surface in mm: a large and a tapered small lobe, flat below."""
    body = trimesh.creation.icosphere(subdivisions=4)
    x, y, z = body.vertices.T
    taper = 1 - 0.42 * np.clip(x, 0, 1) ** 1.5
    long = 78 * x
    wide = 46 * y * taper - 9 * x**2 + 5 * np.sin(2.2 * x)
    high = 31 * z * taper * (1 + 0.12 * np.cos(2.5 * x + 1.5 * y))
    notch = 7 * np.exp(-(((long - 16) / 12) ** 2) - ((wide + 46) / 16) ** 2)
    low = np.where(high < -18, -18 + 0.02 * (high + 18), high)
    return trimesh.Trimesh(np.column_stack([long, wide + notch, low]), body.faces, process=False)


def write_stl(path: Path, surface: "trimesh.Trimesh") -> None:
    """Write a surface as binary STL, all normals 0: readers find them from the corners, and the wheel is smaller."""
    facets = np.zeros(len(surface.faces), [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    facets["corners"] = surface.triangles
    path.write_bytes(bytes(80) + np.array(len(facets), "<u4").tobytes() + facets.tobytes())


def make_surface(folder: Path) -> None:
    """Write the surface, its markers before and after a push, targets, and the targets' true places."""
    folder.mkdir(parents=True)
    surface = organ()
    write_stl(folder / "organ.stl", surface)
    mesh = tr.tetrahedralize(folder / "organ.stl", 5.0, fixed=HELD)
    pad = mesh.surface_nodes_within(np.array(PUSH_AT_MM), PUSH_RADIUS_MM)
    inside = np.linalg.norm(mesh.nodes[mesh.tets].mean(axis=1) - LESION_MM, axis=1) < LESION_RADIUS_MM
    held = np.union1d(mesh.fixed_nodes, pad)
    motion = np.zeros((len(held), 3))
    motion[np.isin(held, pad)] = PUSH_MM
    truth = tr.simulate(
        mesh.with_node_set("fixed", held),
        tr.Load(prescribed=motion),
        tr.Material(np.where(inside, LESION_CONTRAST, 1.0) * TRUE_YOUNG, TRUE_POISSON),
        element="tet10",
    )
    # The part that a camera above sees: the pusher and the far end of the organ are hidden.
    seen = (surface.vertices[:, 2] > -6) & (surface.vertex_normals[:, 2] > 0.25) & (surface.vertices[:, 0] > -25)
    seen &= np.linalg.norm(surface.vertices - PUSH_AT_MM, axis=1) > PUSH_RADIUS_MM + 5
    places = surface.vertices[seen][evenly(surface.vertices[seen], N_MARKERS)]
    names = [f"M{i + 1}" for i in range(N_MARKERS)]
    markers = MarkerObservation(mesh, places, tuple(names))
    moved = markers.predict(truth.displacement[markers.nodes])
    noise = MARKER_STD_MM * np.random.default_rng(SEED).standard_normal(places.shape)
    write_markers(folder / "markers.csv", tr.Markers(places, places + moved + noise, MARKER_STD_MM, names))
    targets = {"lesion": np.array(LESION_MM), "vessel": np.array(VESSEL_MM)}
    write_points(folder / "targets.csv", targets)
    inner = TargetObservation(mesh, targets)
    shifts = inner.predict(truth.displacement[inner.nodes])
    true = {name: place + shift for (name, place), shift in zip(targets.items(), shifts, strict=True)}
    write_points(folder / "truth.csv", true)
    print("markers move", np.linalg.norm(moved, axis=1).round(1), "targets", shifts.round(2).tolist())


def make_scan(folder: Path, surface: Path) -> None:
    """Write the organ and its lesion as a segmentation, and the markers as point lists of 3D Slicer, in LPS."""
    folder.mkdir(parents=True)
    body = trimesh.load_mesh(surface / "organ.stl")
    spacing = np.array([1.5, 1.5, 2.0])
    grid = Grid.over(body.bounds[0] - 6.0, body.bounds[1] + 6.0, 1.0)
    size = tuple(int(n) for n in np.ceil(np.array(grid.size) / spacing))
    grid = Grid(size, grid.origin, np.diag(spacing))
    numbers = np.stack(np.meshgrid(*(np.arange(n) for n in size[::-1]), indexing="ij"), axis=-1)
    places = grid.places(numbers[..., ::-1].reshape(-1, 3).astype(float))
    values = body.contains(places).astype(np.uint8)
    values[np.linalg.norm(places - LESION_MM, axis=1) < LESION_RADIUS_MM] = 2
    image = grid.image(values.reshape(size[::-1]))
    extent = " ".join(f"0 {n - 1}" for n in size)
    for k, (name, colour) in enumerate({"organ": "0.87 0.72 0.53", "lesion": "0.56 0.93 0.56"}.items()):
        of_segment = {
            "ID": name,
            "Name": name,
            "Color": colour,
            "LabelValue": str(k + 1),
            "Layer": "0",
            "Extent": extent,
        }
        for key, value in of_segment.items():
            image.SetMetaData(f"Segment{k}_{key}", value)
    write_image(folder / "segmentation.seg.nrrd", image)
    markers = tr.read_markers(surface / "markers.csv")
    for name, at in {"markers": markers.reference, "measured": markers.measured}.items():
        points = {label: (place.round(3), "") for label, place in zip(markers.names, at, strict=True)}
        write_mrk_json(folder / f"{name}.mrk.json", points, "LPS")


def make_rig(folder: Path, surface: Path) -> None:
    """Write the experiment: two pads, markers, forces, a target, and a stiff inclusion that the file leaves out."""
    folder.mkdir(parents=True)
    mesh = tr.tetrahedralize(surface, 13.0, fixed=HELD, deviation_mm=0.4)
    skin = mesh.nodes[mesh.surface_nodes]
    seen = skin[(skin[:, 2] > -8)]
    places = seen[evenly(seen, 16)]
    stroke = np.array([0.0, 0.35, 0.7, 1.0, 1.0, 0.5])
    pads = {"top": ((-22.0, 2.0, 30.0), 14.0, (0.0, 0.0, -7.0)), "side": ((40.0, -24.0, 4.0), 13.0, (-2.0, 6.0, 0.0))}
    centres = {
        name: skin[np.argmin(np.linalg.norm(skin - at, axis=1))].round(3).tolist() for name, (at, _, _) in pads.items()
    }
    write_vtu(folder / "mesh.vtu", mesh)
    toml = {
        "name": "an organ between two pads",
        "mesh": {"file": "mesh.vtu"},
        "material": {"law": "neo-hookean", "young_kpa": [10.0, 3.0], "poisson": 0.45},
        "forces": {"std_mN": 5.0},
        "markers": {
            "std_mm": 0.05,
            "rest_case": "rest",
            "reference": {f"P{i + 1}": place.round(3).tolist() for i, place in enumerate(places)},
        },
        "boundary": [
            {"name": "base", "nodes": {"plane": [0.0, 0.0, 1.0, -18.0], "tolerance_mm": 2.5}, "kind": "fixed"}
        ],
        "actuator": [
            {"name": name, "nodes": {"centre_mm": centres[name], "radius_mm": radius}, "kind": "displacement"}
            for name, (_, radius, _) in pads.items()
        ],
        "target": [{"name": "lesion", "reference": list(LESION_MM)}],
    }
    write_toml(folder / "experiment.toml", toml)
    cases = {}
    for number, (name, (_, _, way)) in enumerate(pads.items(), start=1):
        cases[f"push {name}"] = (10.0 * number + np.arange(len(stroke)), {name: stroke[:, None] * np.array(way)})
    write_histories(folder / "actuators.csv", ACTUATORS_CSV, cases)
    rest = [f"rest,{time},P{i + 1},,," for time in range(6) for i in range(len(places))]
    frames = [
        f"{case},{time},P{i + 1},,," for case, (times, _) in cases.items() for time in times for i in range(len(places))
    ]
    head = "case,time_s,marker,x_mm,y_mm,z_mm"
    (folder / "markers.csv").write_text("\n".join([head, *rest, *frames, ""]), encoding="utf-8")
    believed = tr.read_experiment(folder, measured=False)
    hidden = Inclusion(centre_mm=LESION_MM, semi_axes_mm=(12.0, 12.0, 12.0), contrast=4.0)
    answers = with_noise(believed, tr.simulate_experiment(replace(believed, effects=(hidden,))), seed=SEED)
    with tempfile.TemporaryDirectory() as made:
        write_simulated(Path(made), believed, answers, Simulated("fine", "tet10"))
        for table in ("markers.csv", "forces.csv", "targets.csv"):
            shutil.copy(Path(made) / table, folder / table)
    text = (folder / "experiment.toml").read_text(encoding="utf-8")
    (folder / "experiment.toml").write_text(
        text + '\n[simulated]\nmodel = "fine"\nelement = "tet10"\n', encoding="utf-8"
    )
    (folder / "truth.json").write_text(json.dumps({"effect": hidden.table()}, indent=1) + "\n", encoding="utf-8")
    print(
        believed,
        {name: float(np.nanmax(np.abs(a.markers[-2] - believed.marker_reference))) for name, a in answers.items()},
    )


if __name__ == "__main__":
    if "--scan" in sys.argv:
        shutil.rmtree(DATA / "scan", ignore_errors=True)
    else:
        shutil.rmtree(DATA, ignore_errors=True)
        make_surface(DATA / "surface")
        make_rig(DATA / "rig", DATA / "surface" / "organ.stl")
    make_scan(DATA / "scan", DATA / "surface")
