"""Orientation of the shells (connected parts) of a surface, search for cavities, and removal of too small shells."""

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.triangles import Triangles
from tissuereg.errors import MeshError
from tissuereg.meshing.settings import MESHING
from tissuereg.meshing.topology import Edges, shell_volumes, turned_round
from tissuereg.meshing.words import place, several, were


def outward(surface: Triangles, shell: IntArray, least_volume: float) -> tuple[Triangles, list[str]]:
    """Return the surface with normals outwards and without small shells, and sentences that state what was found.

    A shell is a connected part of the surface. `shell` (n_triangles,) has the number of each triangle's shell, from 0,
    and neighbours agree in their winding. A shell inside no other is turned so that its normals point outwards,
    together with all shells within it. A shell within another whose normals then point inwards is the wall of a cavity;
    otherwise it lies in solid material. Closed shells of less than `least_volume` mm^3 are removed, except the largest,
    and so are vertices that no triangle uses. Raises MeshError if nothing is enclosed.
    """
    volumes = shell_volumes(surface, shell)
    largest = int(np.argmax(np.abs(volumes)))
    _check_encloses(surface, shell == largest, float(volumes[largest]))
    small = (np.abs(volumes) < least_volume) & _closed_shells(surface.triangles, shell)
    small[largest] = False
    within = _containers(surface, shell, np.flatnonzero(~small))
    turned = np.zeros(len(volumes), bool)
    for number in np.flatnonzero(~small).tolist():
        outermost = [other for other in [number, *within[number]] if not within[other]]
        turned[number] = bool(outermost) and volumes[outermost[0]] < 0
    signed = np.where(turned, -volumes, volumes)
    triangles = turned_round(surface.triangles, turned[shell])[~small[shell]]
    kept, corners = np.unique(triangles, return_inverse=True)
    found = Triangles(surface.vertices[kept], corners.reshape(-1, 3))
    return found, [
        *_turning(turned, small),
        *_omission(volumes, small),
        *_layout(surface, shell, signed, small, within),
    ]


def winding_number(point: FloatArray, corners: FloatArray) -> float:
    """Return the winding number of triangles about a point: 1 inside a closed surface with outward normals, 0 outside.

    `point` (3,), `corners` (n, 3, 3): place, and corners of the triangles, mm. The number is the sum of the solid
    angles of the triangles over 4 pi, by the formula of A. Van Oosterom and J. Strackee, "The solid angle of a plane
    triangle", IEEE Transactions on Biomedical Engineering 30, 125-126, 1983. doi:10.1109/TBME.1983.325207
    """
    a, b, c = (corners[:, i] - point for i in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    above = _dot(a, np.cross(b, c))
    below = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
    return float(np.arctan2(above, below).sum() / (2.0 * np.pi))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _check_encloses(surface: Triangles, largest: BoolArray, volume: float) -> None:
    box = float(np.prod(np.ptp(surface.corners[largest].reshape(-1, 3), axis=0)))
    if abs(volume) <= MESHING.least_filled * box or box <= MESHING.least_filled * surface.extent**3:
        message = (
            f"a surface must enclose a body; this one encloses {abs(volume):.3g} mm^3 within an extent of "
            f"{surface.extent:.4g} mm: it is a sheet"
        )
        raise MeshError(message, where="surface")


def _closed_shells(triangles: IntArray, shell: IntArray) -> BoolArray:
    """Return a mask (n_shells,) of the closed shells, in which every edge belongs to two triangles of the same shell.

    `triangles` (m, 3): vertex indices; `shell` (m,): number of the shell (connected part) of each triangle. At an edge
    other shells may touch.
    """
    edges = Edges.of(triangles)
    key, count = np.unique(edges.group * (shell.max() + 1) + shell[edges.owner], return_counts=True)
    loose = key[count != 2] % (shell.max() + 1)
    return np.asarray(np.bincount(loose, minlength=shell.max() + 1) == 0)


def _containers(surface: Triangles, shell: IntArray, among: IntArray) -> dict[int, list[int]]:
    """Return for every shell whose number is in `among` the numbers of the shells, also in `among`, that contain it.

    `shell` (m,): number of the shell (connected part) of each triangle of the surface.
    """
    corners = {int(number): surface.corners[shell == number] for number in among}
    boxes = {number: (c.min(axis=(0, 1)), c.max(axis=(0, 1))) for number, c in corners.items()}
    within: dict[int, list[int]] = {number: [] for number in corners}
    for inner, own in corners.items():
        points = own[:: max(1, len(own) // MESHING.probes)].mean(axis=1)
        for outer, around in corners.items():
            low, high = boxes[outer]
            boxed = outer != inner and ((low <= points) & (points <= high)).all()
            if boxed and all(abs(winding_number(point, around)) > 0.5 for point in points):
                within[inner].append(outer)
    return within


def _turning(turned: BoolArray, small: BoolArray) -> list[str]:
    n, of = int(turned.sum()), int((~small).sum())
    if not n:
        return []
    if n == of:
        return ["all normals pointed inwards and were turned outwards"]
    return [f"the normals of {n} of {of} shells pointed inwards and were turned outwards"]


def _omission(volumes: FloatArray, small: BoolArray) -> list[str]:
    n = int(small.sum())
    if not n:
        return []
    most = float(np.abs(volumes[small]).max())
    return [f"{several(n, 'shell')} of at most {most:.3g} mm^3, less than a tetrahedron, {were(n)} left out"]


def _layout(
    surface: Triangles, shell: IntArray, signed: FloatArray, small: BoolArray, within: dict[int, list[int]]
) -> list[str]:
    if len(within) < 2:
        return []
    repairs = []
    apart = [number for number in within if not within[number]]
    if len(apart) > 1:
        sizes = ", ".join(f"{signed[number]:.4g}" for number in apart[:5]) + (", ..." if len(apart) > 5 else "")
        repairs.append(f"{len(apart)} separate shells ({sizes} mm^3): each was filled")
    for number in within:
        if within[number]:
            middle = surface.corners[shell == number].mean(axis=(0, 1))
            kind = (
                "its normals point into it, so it was kept as a cavity"
                if signed[number] < 0
                else "its normals point out of it, so what it encloses was filled as well"
            )
            repairs.append(
                f"a shell of {abs(signed[number]):.4g} mm^3 about {place(middle)} lies inside another: {kind}"
            )
    return repairs
