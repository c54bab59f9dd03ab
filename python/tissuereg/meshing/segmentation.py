"""The surface of a label in a segmentation, without the steps of its voxels, and which tets lie in which label.

The label's voxels are turned into a signed distance, smoothed by a voxel along each axis; the surface is where that is
the number, near zero, that keeps the volume of the voxels.
"""

import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import found
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.closest import ClosestTriangles
from tissuereg.body.mesh import Mesh
from tissuereg.body.triangles import Triangles
from tissuereg.errors import MeshingError, MissingPackageError
from tissuereg.imaging.images import WRITTEN, Grid, itk, labels_of, read_image, threaded
from tissuereg.meshing.settings import MESHING


def is_segmentation(path: str | os.PathLike[str]) -> bool:
    """Return whether the name of a file is that of an image."""
    return str(path).lower().endswith((*WRITTEN, ".dcm"))


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Labels of an image.

    `path`: its file; `grid`: places of its voxels; `values` (slices, rows, columns): the label of each; `labels`: the
    value of each label that is asked for, by name or number; `named`: that of every segment that has a name;
    `there`: all of the image.
    """

    path: str
    grid: Grid
    values: npt.NDArray[Any]
    labels: dict[str, int]
    named: dict[str, int]
    there: frozenset[int]

    @classmethod
    def read(cls, path: str | os.PathLike[str], labels: Any) -> "Segmentation":
        """Read a label map; `labels`: names (of a .seg.nrrd's segments) or numbers of the labels that make the body."""
        image = read_image(path)
        if image.GetNumberOfComponentsPerPixel() != 1:
            message = f"{path} must hold one label a voxel; segments of it overlap: export it as a label map"
            raise MeshingError(message, where=str(path))
        values = labels_of(image, str(path), MeshingError)
        if values.dtype.kind == "f":
            values = values.astype(np.int64)
        named = _segments(image, str(path))
        # By slices: of a whole volume this takes several times its memory.
        there = frozenset(int(one) for some in values for one in np.unique(some)) - {0}
        known = _listed(str(path), named, there)
        if isinstance(labels, str | bytes) or not isinstance(labels, Iterable):
            message = f"`labels` must be a list of {known}; got {found(labels)}"
            raise MeshingError(message, where="labels")
        chosen: dict[str, int] = {}
        for asked in labels:
            value = _value(asked, named, there)
            if value is None or value not in there:
                message = f"`labels` must be names or whole numbers of {known}; got {found(asked)}"
                raise MeshingError(message, where="labels")
            chosen[str(asked)] = value
        if not chosen:
            message = f"`labels` must name at least one of the {known}; got none (--label NAME; in Python a list)"
            raise MeshingError(message, where="labels")
        return cls(str(path), Grid.of(image), values, chosen, named, there)

    def surface(self, threads: int = 0) -> tuple[Triangles, list[str]]:
        """Return the surface around all labels together, in LPS, mm, and what was done to the voxels, in sentences.

        `threads`: threads of the filters, 0 takes all cores.
        """
        low, inside = _cut(np.isin(self.values, list(self.labels.values())))
        high = low + inside.shape
        inside, said = _mended(inside, float(np.prod(self.grid.spacing)))
        ends = zip(low == 0, high == self.values.shape, strict=True)
        if any(
            end and inside.take(where, axis).any()
            for axis, both in enumerate(ends)
            for where, end in zip((0, -1), both, strict=True)
        ):
            said.append("the label reaches the border of the image, where the surface is cut off")
        found, volume = self._outlined(low, inside, threads)
        wanted = float(np.count_nonzero(inside) * np.prod(self.grid.spacing))
        if abs(volume - wanted) >= MESHING.level_share * wanted:
            said.append(
                f"the voxels have {wanted:.4g} mm^3, the surface encloses {volume:.4g}: parts are too thin for it"
            )
        return found, said

    def interfaces(self, outer: Triangles, threads: int = 0) -> Triangles | None:
        """Return the surfaces between the labels, in LPS, mm; None where there is one label.

        Those of all labels but the largest, without what lies on the `outer` surface or on that of another label.
        """
        counts = {value: int(np.count_nonzero(self.values == value)) for value in self.labels.values()}
        made = [outer]
        for value in sorted(counts, key=counts.__getitem__)[:-1]:
            low, inside = _cut(self.values == value)
            surface, _ = self._outlined(low, _mended(inside, 1.0)[0], threads)
            middles = surface.vertices[surface.triangles].mean(axis=1)
            gaps = [ClosestTriangles(other.vertices[other.triangles]).find(middles).distances for other in made]
            apart = np.min(gaps, axis=0) > MESHING.apart * self.grid.spacing.max()
            if apart.any():
                made.append(Triangles(surface.vertices, surface.triangles[apart], "LPS"))
        if len(made) == 1:
            return None
        firsts = np.cumsum([0, *(len(one.vertices) for one in made[1:-1])])
        triangles = [first + one.triangles for first, one in zip(firsts, made[1:], strict=True)]
        return Triangles(np.concatenate([one.vertices for one in made[1:]]), np.concatenate(triangles), "LPS")

    def _outlined(self, low: IntArray, inside: npt.NDArray[np.bool_], threads: int) -> tuple[Triangles, float]:
        """Return the surface of voxels, of which the first is `low`, in LPS, mm, and its volume, mm^3."""
        spacing = [float(x) for x in self.grid.spacing]
        smooth = _smooth(np.pad(inside, MESHING.pad), spacing, threads)
        vertices, triangles, volume = _contour(smooth, spacing, float(np.count_nonzero(inside) * np.prod(spacing)))
        # Normals point to smaller values, and the axes of an image may be left-handed.
        if np.linalg.det(self.grid.steps) > 0.0:
            triangles = np.ascontiguousarray(triangles[:, ::-1])
        return Triangles(self.grid.places(vertices + low[::-1] - MESHING.pad), triangles, "LPS"), volume

    @property
    def volumes(self) -> dict[str, float]:
        """Volume of the voxels of each label, mm^3, by its name."""
        voxel = float(np.prod(self.grid.spacing))
        return {name: voxel * int(np.count_nonzero(self.values == value)) for name, value in self.labels.items()}

    @property
    def sets(self) -> list[str]:
        """Names of the labels that become node sets: where there are several, all but those that would hold nodes."""
        return [name for name in self.labels if name not in ("fixed", "perhaps_fixed")] if len(self.labels) > 1 else []

    def label_near(self, rule: Any, name: str) -> tuple[int, float] | None:
        """Return label and distance, mm, of a rule ``label NAME r``; None for another rule; `name`: of the argument."""
        words = rule.split() if isinstance(rule, str) else []
        if len(words) < 2 or words[0] != "label":
            return None
        value = _value(" ".join(words[1:-1]), self.named, self.there)
        try:
            within = float(words[-1])
        except ValueError:
            within = math.nan
        if 0.0 < within < math.inf and (value is None or value not in self.there):
            message = f"`{name}`: {_listed(self.path, self.named, self.there)}; got {found(' '.join(words[1:-1]))}"
            raise MeshingError(message, where=name)
        if value is None or not 0.0 < within < math.inf:
            message = f"`{name}` must be 'label NAME r', a label of {self.path} and a distance in mm, got {found(rule)}"
            raise MeshingError(message, where=name)
        return value, within

    def nodes_near(self, mesh: Mesh, near: tuple[int, float]) -> IntArray:
        """Return the surface nodes (n,) of a mesh within a distance, mm, of the middles of a label's voxels."""
        from scipy.spatial import cKDTree

        value, within = near
        places = self.grid.places(np.argwhere(self.values == value)[:, ::-1].astype(np.float64))
        gaps = cKDTree(places).query(mesh.nodes[mesh.surface_nodes], distance_upper_bound=within)[0]
        if not np.isfinite(gaps).any():
            message = f"a surface node must lie within {within:g} mm of label {value} of {self.path}; none does"
            raise MeshingError(message, where="label")
        return np.asarray(mesh.surface_nodes[np.isfinite(gaps)])

    def of_tets(self, mesh: Mesh) -> dict[str, IntArray]:
        """Return the numbers of the tets (n,) whose middle lies in each label; the rest is in none."""
        middle = np.rint(self.grid.indices(mesh.nodes[mesh.tets].mean(axis=1))).astype(int)
        middle = np.clip(middle, 0, np.array(self.grid.size) - 1)
        own = self.values[middle[:, 2], middle[:, 1], middle[:, 0]]
        return {name: np.flatnonzero(own == value) for name, value in self.labels.items()}


def _listed(path: str, named: dict[str, int], there: frozenset[int]) -> str:
    """Return the labels of an image in words."""
    listed = [f"{name} ({one})" for name, one in named.items() if one in there]
    listed += [str(one) for one in sorted(there - set(named.values()))]
    return f"labels in {path}: {', '.join(listed) or 'it has none'}"


def _value(asked: Any, named: dict[str, int], there: frozenset[int]) -> int | None:
    """Return the value of a label: a number is one, a text a segment's name or else a number; None if it is neither."""
    if isinstance(asked, int | np.integer) and not isinstance(asked, bool):
        return int(asked)
    if not isinstance(asked, str):
        return None
    number = int(asked) if asked.strip().removeprefix("-").isdecimal() else None
    value = named.get(asked, number)
    if number in there and value != number:
        message = (
            f"`labels`: {asked!r} is the name of label {value} and the number of another: say {value}, or its name"
        )
        raise MeshingError(message, where="labels")
    return value


def _segments(image: Any, path: str) -> dict[str, int]:
    """Return the label of each segment that a .seg.nrrd names; segments that share a name are known by number."""
    segments: list[tuple[str, int]] = []
    while image.HasMetaDataKey(f"Segment{len(segments)}_Name"):
        number = len(segments)
        key = f"Segment{number}_LabelValue"
        value = image.GetMetaData(key).strip() if image.HasMetaDataKey(key) else str(number + 1)
        if not value.removeprefix("-").isdecimal():
            message = f"{path}: {key} must be a whole number, got {found(value)}"
            raise MeshingError(message, where=path)
        segments.append((image.GetMetaData(f"Segment{number}_Name").strip(), int(value)))
    names = [name for name, _ in segments]
    return {name: value for name, value in segments if names.count(name) == 1}


def _cut(inside: npt.NDArray[np.bool_]) -> tuple[IntArray, npt.NDArray[np.bool_]]:
    """Return the first slice, row and column that a label has, and the voxels of its box."""
    found = [np.flatnonzero(inside.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    low = np.array([one[0] for one in found])
    return low, inside[tuple(slice(one[0], one[-1] + 1) for one in found)]


def _mended(inside: npt.NDArray[np.bool_], voxel_mm3: float) -> tuple[npt.NDArray[np.bool_], list[str]]:
    """Return voxels without small islands and with small cavities filled, and what was done."""
    from scipy import ndimage

    said: list[str] = []
    parts, n_parts = ndimage.label(inside)
    sizes = np.bincount(parts.ravel())[1:]
    small = np.flatnonzero(sizes < MESHING.least_island * sizes.max())
    if len(small):
        inside = inside & ~np.isin(parts, 1 + small)
        said.append(f"{len(small)} islands, together {sizes[small].sum() * voxel_mm3:.3g} mm^3, were left out")
    if n_parts - len(small) > 1:
        said.append(f"the label has {n_parts - len(small)} parts")
    cavities, _ = ndimage.label(~np.pad(inside, 1))
    sizes = np.bincount(cavities.ravel())
    outer = cavities[0, 0, 0]
    closed = np.flatnonzero(sizes < MESHING.most_cavity * inside.sum())
    closed = closed[(closed != 0) & (closed != outer)]
    if len(closed):
        inside = inside | np.isin(cavities, closed)[1:-1, 1:-1, 1:-1]
        said.append(f"{len(closed)} cavities, together {sizes[closed].sum() * voxel_mm3:.3g} mm^3, were filled")
    return inside, said


def _smooth(inside: npt.NDArray[np.bool_], spacing: list[float], threads: int) -> npt.NDArray[np.float32]:
    """Return the distance, mm, of voxels from the border of a label, negative in it, without the voxels' steps."""
    image = itk().GetImageFromArray(inside.astype(np.uint8))
    image.SetSpacing(spacing)
    apart = threaded("SignedMaurerDistanceMapImageFilter", threads)
    apart.SetSquaredDistance(False)
    apart.SetUseImageSpacing(True)
    # Distances are from middles of voxels at the border: the mean of both ways is zero between them.
    distance = 0.5 * (apart.Execute(image) - apart.Execute(1 - image))
    gauss = threaded("SmoothingRecursiveGaussianImageFilter", threads)
    gauss.SetSigma(spacing)
    once = gauss.Execute(distance)
    # A Gauss filter shrinks what is curved or thin; what a second one takes away is given back to the first.
    return np.asarray(itk().GetArrayFromImage(2.0 * once - gauss.Execute(once)))


def _contour(values: npt.NDArray[Any], spacing: list[float], wanted: float) -> tuple[FloatArray, IntArray, float]:
    """Return vertices (n, 3), in columns, rows and slices, triangles, and their volume: near `wanted`, mm^3."""
    try:
        import pyvista
    except ImportError as error:
        message = "surfaces of labels are made by pyvista, which must be installed: pip install 'tissuereg[mesh]'"
        raise MissingPackageError(message, where="pyvista") from error
    image, level = pyvista.ImageData(dimensions=values.shape[::-1]), 0.0
    step = MESHING.level_step * max(spacing)
    for _ in range(MESHING.level_steps):
        made = image.contour([level], scalars=values.ravel(), method="flying_edges")
        if not made.n_points:
            message = "the labels must have an inside larger than a voxel; no surface was found"
            raise MeshingError(message, where="labels")
        vertices, triangles = (
            np.asarray(made.points, np.float64),
            np.asarray(made.faces.reshape(-1, 4)[:, 1:], np.int64),
        )
        in_mm = Triangles(vertices * spacing, triangles)
        volume = abs(in_mm.volume)
        if abs(volume - wanted) < MESHING.level_share * wanted:
            break
        level += float(np.clip((wanted - volume) / in_mm.areas.sum(), -step, step))
    return vertices, triangles, volume


__all__ = ["Segmentation", "is_segmentation"]
