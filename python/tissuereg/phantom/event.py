"""Deformations of the phantom: the demo's load, its believed model and its truth, and the shipped model's recipe."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg._base.choices import Size
from tissuereg._base.shown import short_repr
from tissuereg.body.load import Load
from tissuereg.body.markers import Markers
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.phantom import phantom_mesh, true_fields, truth_mesh
from tissuereg.simulation.recipe import Recipe, read_recipe
from tissuereg.simulation.solve import Simulator


@dataclass(frozen=True)
class PushedPhantom:
    """Constants of the demo's synthetic deformation: the true model and load, and those that the user believes.

    `lesion_...`: centre, radius and modulus ratio of a stiff lesion; `pad_origin_mm`, `pushers`, `pad_radius_mm`: two
    pads on the skin, each with its direction from the origin and its push in mN; `believed_young`, `true_young`: moduli
    in kPa; `poisson`, `true_poisson`: Poisson's ratios, believed and true; `true_push_factor`, `true_tilt_deg`: size
    and rotation about z of the true pushes relative to the believed ones; `n_markers`, `marker_std_mm`: markers on the
    skin and their noise.
    """

    lesion_mm: tuple[float, float, float] = (2.0, 16.0, 24.0)  # centre of the stiff lesion
    lesion_radius_mm: float = 9.0
    lesion_contrast: float = 4.0  # modulus over that of the tissue around it
    pad_origin_mm: tuple[float, float, float] = (0.0, -3.0, 18.0)  # where the directions of the pads begin
    # Direction of each pad from there, and its push in mN.
    pushers: tuple[tuple[tuple[float, float, float], tuple[float, float, float]], ...] = (
        ((1.0, 0.1, 0.15), (-6600.0, 400.0, -800.0)),
        ((-0.1, 1.0, 0.2), (400.0, -4400.0, -600.0)),
    )
    pad_radius_mm: float = 22.0
    believed_young: float = 10.0  # kPa
    true_young: float = 12.5  # kPa
    true_push_factor: float = 1.06  # true pushes over the believed ones
    true_tilt_deg: float = 5.0  # of the true pushes about z
    poisson: float = 0.45  # believed
    true_poisson: float = 0.46
    n_markers: int = 15  # on the skin
    marker_std_mm: float = 0.1  # noise of a coordinate


PHANTOM = PushedPhantom()


#: Centre of the stiff lesion, mm.
LESION_MM = PHANTOM.lesion_mm


@dataclass(frozen=True, eq=False)
class PhantomEvent:
    """One synthetic deformation of the phantom: the user's model and measurement, and the truth.

    Attributes
    ----------
    mesh : Mesh
        Mesh that the user simulates and registers on.
    load, material : Load, Material
        Load and material that the user believes, which differ from the true ones.
    markers : Markers
        Markers with their measured places, noise included.
    true_markers : ndarray of float64, shape (n_markers, 3)
        True displacement of the markers, mm.
    true_displacement : ndarray of float64, shape (n_nodes, 3)
        True displacement at the nodes of `mesh`, mm.
    true_lesion : ndarray of float64, shape (3,)
        True place of the lesion's centre, mm.
    """

    mesh: Mesh
    load: Load
    material: Material
    markers: Markers
    true_markers: FloatArray
    true_displacement: FloatArray
    true_lesion: FloatArray

    __repr__ = short_repr


def make_event(*, seed: int = 0, size: Size = "full") -> PhantomEvent:
    """Return the phantom's synthetic deformation, with markers measured on a finer, stiffer, second-order model.

    Parameters
    ----------
    seed : int
        Seed of the markers' places and noise.
    size : str
        Size of the body: ``full`` for the mesh of the shipped model, ``small`` for quick examples.

    Returns
    -------
    PhantomEvent
        The user's mesh, load, material and markers, and the true displacements. Cost: a tenth of a second, because the
        true fields come with the package.

    Raises
    ------
    ArgumentError
        If `size` is neither of the two.
    """
    fine, body = truth_mesh(size), phantom_mesh(size)
    rng = np.random.default_rng([seed, 5])
    field, in_body = true_fields(size)
    places = _marker_places(fine, rng)
    names = tuple(f"P{i + 1}" for i in range(PHANTOM.n_markers))
    observed = MarkerObservation(fine, places, names)
    moved = observed.predict(field[observed.nodes])
    measured = places + moved + PHANTOM.marker_std_mm * rng.standard_normal(moved.shape)
    lesion = TargetObservation(fine, {"lesion": LESION_MM})
    return PhantomEvent(
        mesh=body,
        load=_pushes(body, 1.0, 0.0),
        material=Material(PHANTOM.believed_young, PHANTOM.poisson),
        markers=Markers(places, measured, PHANTOM.marker_std_mm, names),
        true_markers=moved,
        true_displacement=in_body,
        true_lesion=np.asarray(LESION_MM) + lesion.predict(field[lesion.nodes])[0],
    )


def solve_truth(size: Size, *, threads: int = 0) -> tuple[FloatArray, FloatArray]:
    """Solve for the true displacement: ten-node elements, stiffer tissue, a stiff lesion, and larger, rotated pushes.

    `size`: ``full`` or ``small``; `threads`: number of threads, 0 for all cores. Returns the displacement at the nodes
    of ``truth_mesh(size)``, mid-edge nodes included, and of ``phantom_mesh(size)``, (n_nodes, 3) each in mm. Cost: a
    solve of 36,500 nodes (``full``: seconds) or 12,500.
    """
    fine = truth_mesh(size)
    stiffness = np.where(_in_lesion(fine), PHANTOM.lesion_contrast, 1.0) * PHANTOM.true_young
    pushes = _pushes(fine, PHANTOM.true_push_factor, PHANTOM.true_tilt_deg)
    material = Material(stiffness, PHANTOM.true_poisson)
    field = Simulator(fine, element="tet10").solve(pushes, material, threads=threads, tolerance=1e-7).displacement
    inside = TargetObservation(fine, {str(i): node for i, node in enumerate(phantom_mesh(size).nodes)})
    return field, inside.predict(field[inside.nodes])


def shipped_recipe() -> Recipe:
    """Return the recipe of the data on which the shipped model was trained.

    Returns
    -------
    Recipe
        The content of ``training/recipes/breast.toml``. Its mesh is ``phantom_mesh()``; its tables ``data`` and
        ``material`` are the distributions from which `EventSampler` draws deformations of that body.
    """
    return read_recipe(Path(str(files("tissuereg.phantom"))) / "data" / "breast.toml")


def _in_lesion(mesh: Mesh) -> BoolArray:
    centres = mesh.nodes[mesh.tets].mean(axis=1)
    return np.asarray(np.linalg.norm(centres - LESION_MM, axis=1) <= PHANTOM.lesion_radius_mm)


def _pushes(mesh: Mesh, factor: float, tilt_deg: float) -> Load:
    """Return the pushes of both pads as a dead traction, times `factor`, rotated by `tilt_deg` degrees about z."""
    angle = np.deg2rad(tilt_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    triangles, tractions = [], []
    for direction, push in PHANTOM.pushers:
        pad, area = _pad(mesh, np.asarray(direction))
        triangles.append(pad)
        tractions.append(np.broadcast_to(factor * turn @ push / area, (len(pad), 3)))
    return Load(traction=(np.concatenate(triangles), np.concatenate(tractions)))


def _pad(mesh: Mesh, direction: FloatArray) -> tuple[IntArray, float]:
    """Return the surface triangles (n, 3) of the pad in a direction (3,) from the body, and their area, mm^2."""
    corners = mesh.nodes[mesh.surface]
    centres = corners.mean(axis=1)
    arms = centres - PHANTOM.pad_origin_mm
    along = arms @ direction / np.linalg.norm(direction) / np.linalg.norm(arms, axis=1)
    middle = centres[np.argmax(along)]
    rows = np.flatnonzero(np.linalg.norm(centres - middle, axis=1) <= PHANTOM.pad_radius_mm)
    rows = rows[(centres[rows, 2] > 0.5)]
    normal = np.cross(corners[rows, 1] - corners[rows, 0], corners[rows, 2] - corners[rows, 0])
    return mesh.surface[rows], float(0.5 * np.linalg.norm(normal, axis=1).sum())


def _marker_places(mesh: Mesh, rng: np.random.Generator) -> FloatArray:
    """Return places (n_markers, 3), mm, spread over the skin: farthest-point sampling of random candidates."""
    corners = mesh.nodes[mesh.surface]
    skin = np.flatnonzero(corners[:, :, 2].mean(axis=1) > 6.0)
    candidates = []
    for triangle in rng.choice(skin, 400):
        weights = rng.dirichlet((2.0, 2.0, 2.0))
        candidates.append(weights @ corners[triangle])
    places = [candidates[0]]
    rest = np.array(candidates[1:])
    while len(places) < PHANTOM.n_markers:
        gap = np.linalg.norm(rest[:, None] - np.array(places)[None], axis=2).min(axis=1)
        places.append(rest[np.argmax(gap)])
    return np.array(places)
