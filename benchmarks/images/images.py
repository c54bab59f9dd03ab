"""Exactness and times of fields, grid transforms and warped images -> archive/, RESULTS.md, docs/results.md.

python -m images.images [--page]
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import SimpleITK as sitk  # noqa: N813 (its own habit)

import tissuereg as tr
from common import REPOSITORY, commit, read_archive, write_archive
from readme import write_table
from tissuereg._base.machine import machine, versions
from tissuereg.imaging.images import Grid, write_image
from tissuereg.imaging.warp import warp_image
from tissuereg.phantom.breast import breast_mesh
from tissuereg.phantom.event import make_event
from tissuereg.registration.field import RegisteredField

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive", HERE / "RESULTS.md", ("rows/#",)
RESULTS = REPOSITORY / "docs" / "results.md"

#: Threads, points asked for, voxels along each axis of the large image.
THREADS, N_POINTS, VOXELS = 2, 10_000, 512

#: Targets of one call, and of another that is compared with it; nodes of the bodies.
TARGETS, BODIES = (10, 200, 2500), (4200, 30_000)


def phantom() -> tr.Registration:
    """Return the registration of the demo's event."""
    event = make_event(seed=0)
    return tr.register(event.mesh, event.markers, settings=tr.RegisterSettings(threads=THREADS))


def inner(mesh: tr.Mesh, count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return inner points (count, 3), mm, with the corners of their tets and weights (count, 4)."""
    rng = np.random.default_rng(seed)
    corners, shares = mesh.tets[rng.integers(mesh.n_tets, size=count)], rng.dirichlet(np.ones(4), count)
    return np.einsum("pk,pkx->px", shares, mesh.nodes[corners]), corners, shares


def exactness(field: RegisteredField, folder: Path) -> list[dict]:
    """Return errors in mm: of points, of grids as SimpleITK reads them, of the way back."""
    places, corners, shares = inner(field.mesh, N_POINTS)
    wanted = places + np.einsum("pk,pkx->px", shares, field.displacement[corners])
    at = field.at(places).mean
    nodes = np.abs(field.at(field.mesh.nodes).mean - field.mesh.nodes - field.displacement).max()
    rows = [_row("nodes and inner points against the mesh's own interpolation", max(np.abs(at - wanted).max(), nodes))]
    for spacing in (1.0, 2.0):
        field.transform(folder / "there.nrrd", spacing=spacing)
        back = field.transform(folder / "back.h5", spacing=spacing)
        image = sitk.Cast(sitk.ReadImage(str(folder / "there.nrrd")), sitk.sitkVectorFloat64)
        for name, transform, start, end in (
            ("modeling, .nrrd", sitk.DisplacementFieldTransform(image), places, at),
            ("resampling, .h5", sitk.ReadTransform(str(folder / "back.h5")), at, places),
        ):
            moved = np.array([transform.TransformPoint(point) for point in start])
            off = np.linalg.norm(moved - end, axis=1)
            rows.append(_row(f"grid of {spacing:g} mm, {name}, by SimpleITK: mean", off.mean()))
            rows.append(_row(f"grid of {spacing:g} mm, {name}, by SimpleITK: 99 %", np.quantile(off, 0.99)))
        rows.append(_row(f"grid of {spacing:g} mm, back and forward at voxels", back.residual_mm))
    return rows


def overlaps(field: RegisteredField, folder: Path) -> list[dict]:
    """Return Dice coefficients of moved balls with exactly moved ones, voxels of 1 mm."""
    rows, middle = [], np.array([0.0, 0.0, 30.0])
    for radius in (10.0, 15.0):
        grid = Grid.over(middle - radius - 12.0, middle + radius + 12.0, 1.0)
        numbers = np.stack(np.meshgrid(*[np.arange(n) for n in grid.size[::-1]], indexing="ij"), axis=-1)
        places = grid.places(numbers[..., ::-1].reshape(-1, 3).astype(np.float64))
        labels = np.linalg.norm(places - middle, axis=1) < radius
        write_image(folder / "ball.nrrd", grid.image(labels.astype(np.uint8).reshape(grid.size[::-1])))
        warp_image(field, folder / "ball.nrrd", folder / "moved.nrrd", labels=True)
        found = sitk.GetArrayFromImage(sitk.ReadImage(str(folder / "moved.nrrd"))).ravel() > 0
        wanted = np.linalg.norm(places - field.space.back(places) - middle, axis=1) < radius
        share = 2.0 * np.count_nonzero(found & wanted) / (np.count_nonzero(found) + np.count_nonzero(wanted))
        rows.append(_row(f"ball of {radius:g} mm as a label map of 1 mm, Dice", share, ""))
    return rows


def times(field: RegisteredField, folder: Path) -> list[dict]:
    """Return times in s of what is asked of a field, in the order of a first use."""
    places = inner(field.mesh, N_POINTS)[0]
    rows = [
        _timed("regions of 2,500 points, the first asked", lambda: field.at(places[:2500])),
        _timed("regions of 2,500 points, again", lambda: field.at(places[:2500])),
        _timed("grid of 2 mm, the first made", lambda: field.transform(folder / "there.nrrd", spacing=2.0)),
    ]
    low, high = field.mesh.nodes.min(axis=0) - 20.0, field.mesh.nodes.max(axis=0) + 20.0
    grid = Grid((VOXELS,) * 3, low, np.diag((high - low) / (VOXELS - 1)))
    z, y, x = np.meshgrid(*[np.arange(VOXELS, dtype=np.float32)] * 3, indexing="ij", sparse=True)
    image = (x + y + z).astype(np.int16)
    write_image(folder / "large.mha", grid.image(image))
    write_image(folder / "labels.nrrd", grid.image((image > 700).astype(np.uint8)))
    del image
    for name, file, out in (("volume", "large.mha", "v.mha"), ("label map", "labels.nrrd", "l.nrrd")):
        of_labels = {"labels": name == "label map", "threads": THREADS}
        run = partial(warp_image, field, folder / file, folder / out, **of_labels)
        rows.append(_timed(f"{name} of {VOXELS}^3 voxels, read, warped and written", run))
    rows.append(_row("peak memory of the process", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6, "GB"))
    return rows


def of_targets(n_nodes: int, n_targets: int) -> list[float]:
    """Return the times, s, of a first and a next registration with targets."""
    mesh, rng = breast_mesh(n_nodes), np.random.default_rng(0)
    skin = mesh.surface_nodes[mesh.nodes[mesh.surface_nodes, 2] > 8.0]
    reference = mesh.nodes[skin[rng.choice(len(skin), 15, replace=False)]]
    off = np.linalg.norm(reference - mesh.nodes[skin[np.argmax(mesh.nodes[skin, 2])]], axis=1)
    moved = np.exp(-0.5 * (off / 15.0) ** 2)[:, None] * np.array([2.0, 1.0, -6.0])
    markers = tr.Markers(reference, reference + moved + 0.1 * rng.standard_normal(reference.shape), 0.1)
    targets = {str(i): place for i, place in enumerate(inner(mesh, n_targets)[0])}
    spent = []
    for _ in range(2):
        begun = time.perf_counter()
        tr.register(mesh, markers, targets=targets, settings=tr.RegisterSettings(threads=THREADS))
        spent.append(time.perf_counter() - begun)
    return spent


def _many_targets() -> list[dict]:
    rows = []
    for nodes in BODIES:
        for targets in TARGETS:
            words = [sys.executable, "-m", "images.images", "--targets", str(nodes), str(targets)]
            done = subprocess.run(words, capture_output=True, text=True, check=True)
            for name, spent in zip(("first", "next"), done.stdout.split(), strict=True):
                rows.append(_row(f"registration, {nodes:,} nodes, {targets:,} targets: {name}", float(spent), "s"))
    return rows


def _row(what: str, value: float, unit: str = "mm") -> dict:
    return {"what": what, "value": float(value), "unit": unit}


def _timed(what: str, run) -> dict:
    begun = time.perf_counter()
    run()
    return _row(what, time.perf_counter() - begun, "s")


def table(content: dict) -> str:
    """Return the table of an archive."""
    lines = ["| | |", "|---|---|"]
    for row in content["rows"]:
        digits = {"s": ".2g", "GB": ".2g", "": ".3f"}.get(row["unit"], ".1g" if row["value"] < 1e-3 else ".3f")
        lines.append(f"| {row['what']} | {row['value']:{digits}} {row['unit']} |".replace("  |", " |"))
    return "\n".join(lines) + "\n"


def page(content: dict) -> str:
    """Return the page of an archive."""
    made = "Written by `make -C benchmarks/images` from `archive/`; edit neither."
    body = (
        f"The phantom of 4,258 nodes, moved by up to 15 mm; registrations of a body of that shape. {THREADS} threads."
    )
    return "\n".join(["# Fields, warps and many points", "", made, body, "", table(content)])


def main() -> None:
    """Measure and write; `--page` writes the pages alone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true")
    parser.add_argument("--targets", nargs=2, type=int, help="time registrations of so many nodes and targets alone")
    options = parser.parse_args()
    if options.targets:
        print(*of_targets(*options.targets))
        return
    if not options.page:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            result, where = phantom(), Path(folder)
            once = _timed("the uncertainty of all nodes, once a result", lambda: result.uncertainty)
            field = result.field
            rows = [once, *times(field, where), *exactness(field, where), *overlaps(field, where), *_many_targets()]
        write_archive(ARCHIVE, {"rows": rows, "machine": machine(), "versions": versions(), **commit()}, TABLES)
    content = read_archive(ARCHIVE)
    PAGE.write_text(page(content), encoding="utf-8")
    write_table("images", table(content), RESULTS)


if __name__ == "__main__":
    main()
