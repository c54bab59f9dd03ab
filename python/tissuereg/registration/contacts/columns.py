"""All causes of a registration as columns: their loads, their priors, and the response of observations to them.

Columns come in blocks. The first holds three directions per patch; slots choose among these. Then follow a body force,
the error of a believed load, the tractions of doubtful supports, and a rigid motion. The background is the family of
the first block; every other block has one family of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.registration.contacts.body import ContactBody
from tissuereg.registration.contacts.patches import Patches
from tissuereg.registration.contacts.settings import DISCRETISATION, ContactSettings
from tissuereg.simulation.sensitivity import Compliance
from tissuereg.simulation.solve import LoadParts


@dataclass(frozen=True)
class Family:
    """A group of causes, such as all tractions of the background, that share one standard deviation.

    `columns`: the causes that belong to it; `variance`: variance of each coefficient at factor one; `factors`
    (n_levels,): candidate factors on that variance; `log_prior` (n_levels,): logarithm of each candidate's prior
    probability, up to a constant.
    """

    name: str
    columns: slice
    variance: float
    factors: FloatArray
    log_prior: FloatArray

    @classmethod
    def of(cls, name: str, columns: slice, variance: float, size: tuple[float, float]) -> "Family":
        """Return a family whose size is log-normal with a median and a standard deviation of the logarithm."""
        median, spread = size
        levels = np.array(DISCRETISATION.levels)
        factors = np.asarray(median**2 * np.exp(2.0 * spread * levels), np.float64)
        return cls(name, columns, variance, factors, np.asarray(-0.5 * levels**2))


@dataclass(frozen=True, eq=False)
class Columns:
    """All causes that may have moved the body in one registration: one column each, with an unknown coefficient.

    Attributes
    ----------
    body : ContactBody
        The body on which they act.
    young : ndarray of float64, shape (n_patches,)
        Mean Young's modulus near every patch of the surface, kPa: forces are in proportion to it.
    base_young : float
        Mean Young's modulus near the doubtful supports, kPa.
    springs : ndarray of float64, shape (n_sets, 2), or None
        Normal and tangential stiffness, kPa/mm, of the springs under doubtful supports or under a free body.
    believed : LoadParts
        The believed load; with zero coefficients it acts exactly.
    families : tuple of Family
        Groups of causes; first the weak tractions anywhere on the surface (the background).
    rigid : ndarray of float64, shape (2, 3)
        Pivot of rigid rotations, and the length at which the coefficient of a rotation is the displacement in mm.
    """

    body: ContactBody
    young: FloatArray
    base_young: float
    springs: FloatArray | None
    believed: LoadParts
    families: tuple[Family, ...]
    rigid: FloatArray
    _offsets: dict[str, slice] = field(repr=False)

    @classmethod
    def of(
        cls,
        body: ContactBody,
        material: Material,
        believed: LoadParts,
        settings: ContactSettings,
        *,
        drifts: bool = False,
    ) -> "Columns":
        """Return the possible causes on a body of some material under a believed load.

        `drifts`: whether a small rigid motion of the tracker is among them.
        """
        n_patches = 3 * body.patches.n_patches
        extent = body.mesh.extent
        families = [
            Family.of(
                "background", slice(0, n_patches), settings.background_share**2, _in_mm(settings.background, extent)
            )
        ]
        blocks = [("weight", 3, _in_mm(settings.weight, extent))]
        if any(part is not None for part in believed.values()):
            blocks.append(("believed", 3, settings.believed))
        if body.base is not None:
            blocks.append(("supports", 3 * body.base.n_patches, _in_mm(settings.supports, extent)))
        if body.supports.moves or drifts:
            moved = settings.frame if body.supports.moves else settings.drift
            blocks.append(("frame", 6, _in_mm(moved, extent)))
        first = n_patches
        for name, count, size in blocks:
            families.append(Family.of(name, slice(first, first + count), 1.0, size))
            first += count
        nodes, mean = body.mesh.nodes, float(np.mean(material.young_array))
        rigid = np.stack([nodes.mean(axis=0), np.full(3, 0.5 * body.mesh.extent)])
        offsets = {family.name: family.columns for family in families}
        springs = spring_stiffness(body, material, settings.support_stiffness)
        return cls(body, _patch_young(body, material), mean, springs, believed, tuple(families), rigid, offsets)

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return int(self.families[-1].columns.stop)

    @property
    def n_patches(self) -> int:
        """Number of patches that slots choose among."""
        return self.body.patches.n_patches

    def made_of(self, material: Material) -> "Columns":
        """Return the columns of the same body made of another material."""
        return replace(self, young=_patch_young(self.body, material))

    def on_springs(self, stiffness: Sequence[float]) -> "Columns":
        """Return the same causes on springs of other stiffness: one value a set, modulus over extent."""
        springs = [unit * self.base_young * one for (_, unit), one in zip(self.body.springs, stiffness, strict=True)]
        return replace(self, springs=np.array(springs))

    def on(self, springs: FloatArray | None) -> "Columns":
        """Return the same causes on springs of other stiffness (n_sets, 2), normal and tangential, in kPa/mm."""
        return replace(self, springs=springs)

    @property
    def moves(self) -> bool:
        """Whether a rigid motion between body and tracker is unknown."""
        return "frame" in self._offsets

    @property
    def _body_force_unit(self) -> float:
        return 2.0 * float(np.mean(self.young)) / (0.5 * self.body.mesh.extent) ** 2

    def responses(self, compliance: Compliance, places: FloatArray, rigid: FloatArray | None = None) -> FloatArray:
        """Return the responses of observations to unit coefficients.

        `compliance`: sensitivities of the observations to nodal forces; `places` (n_points, 3): deformed positions of
        the points, mm, for rigid motions; three rows per point; `rigid` (n_rows, 6): responses of the rows to rigid
        motions, if they are not three per point. Result: (n_rows, n_columns), mm per unit coefficient.
        """
        n_nodes = self.body.mesh.n_nodes
        out = np.zeros((len(compliance.forces), self.n_columns))
        forces = compliance.forces[:, :n_nodes]
        for axis in range(3):
            along = np.ascontiguousarray(forces[:, :, axis].T)
            out[:, axis : 3 * self.n_patches : 3] = (self.young[:, None] * (self.body.patches.shapes @ along)).T
        out[:, self._offsets["weight"]] = compliance.body_force * self._body_force_unit
        if "believed" in self._offsets:
            out[:, self._offsets["believed"]] = self._believed_responses(compliance)
        if self.body.base is not None:
            block = self._offsets["supports"]
            for axis in range(3):
                along = np.ascontiguousarray(forces[:, :, axis].T)
                out[:, block.start + axis : block.stop : 3] = (self.base_young * (self.body.base.shapes @ along)).T
        if "frame" in self._offsets:
            out[:, self._offsets["frame"]] = self.rigid_field(places).reshape(6, -1).T if rigid is None else rigid
        return out

    def rigid_rows(self, places: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the motion (n, 6) of places (n, 3) along unit vectors (n, 3) by unit rigid motions, mm."""
        return np.asarray(np.einsum("kpx,px->pk", self.rigid_field(places), directions))

    def rigid_field(self, places: FloatArray) -> FloatArray:
        """Return the motions (6, n_points, 3), mm, of places (n_points, 3) by unit translations and rotations."""
        pivot, length = self.rigid
        moves = np.zeros((6, len(places), 3))
        for axis in range(3):
            moves[axis, :, axis] = 1.0
            moves[3 + axis] = np.cross(np.eye(3)[axis], places - pivot) / length[0]
        return moves

    def _believed_responses(self, compliance: Compliance) -> FloatArray:
        """Return how observations respond to the size of each believed force along each axis, (n_obs, n_forces), in mm.

        `compliance`: sensitivities of the observations to nodal forces.
        """
        out = np.zeros((len(compliance.forces), 3))
        forces, weight, moved = (self.believed[part] for part in ("forces", "body_force", "prescribed"))
        if forces is not None:
            out += np.einsum("onx,n->ox", compliance.forces, np.linalg.norm(forces, axis=1))
        if weight is not None:
            out += compliance.body_force * float(np.linalg.norm(weight))
        if moved is not None:
            out += np.einsum("ohx,h->ox", compliance.prescribed, np.linalg.norm(moved, axis=1))
        return out

    def load(self, coefficients: FloatArray) -> Load:
        """Return the load that belongs to coefficients (n_columns,) of the causes, the believed load included."""
        (forces,), (weight,) = self._forces_and_weights(coefficients[None])
        moved = np.zeros((len(self.body.simulator.held_nodes), 3))
        if self.believed["forces"] is not None:
            forces = forces + self.believed["forces"]
        if self.believed["body_force"] is not None:
            weight = weight + self.believed["body_force"]
        if self.believed["prescribed"] is not None:
            moved += self.believed["prescribed"]
            share = coefficients[self._offsets["believed"]]
            moved += np.linalg.norm(self.believed["prescribed"], axis=1)[:, None] * share
        return Load(forces=forces, body_force=weight, prescribed=moved)

    def weight_forces(self, body_force: FloatArray) -> FloatArray:
        """Return the nodal forces (..., n_element_nodes, 3) of body forces (..., 3), mN."""
        return np.asarray(self.body.node_volumes[:, None] * body_force[..., None, :])

    def forces(self, changes: FloatArray) -> FloatArray:
        """Return the nodal forces (n, n_element_nodes, 3) of many changes of coefficients (n, n_columns), mN.

        Weight is distributed over the nodes; prescribed motion of held nodes is not included.
        """
        forces, weights = self._forces_and_weights(changes)
        return np.asarray(forces + self.weight_forces(weights))

    def _forces_and_weights(self, changes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nodal forces (n, n_element_nodes, 3) and body forces (n, 3) of changes, without the believed load."""
        n_nodes = self.body.mesh.n_nodes
        units = changes[:, : 3 * self.n_patches].reshape(len(changes), -1, 3)
        weights = changes[:, self._offsets["weight"]] * self._body_force_unit
        forces = np.zeros((len(changes), self.body.simulator.body.n_nodes, 3))
        forces[:, :n_nodes] += _spread(self.body.patches, self.young[:, None] * units)
        if "believed" in self._offsets:
            share = changes[:, self._offsets["believed"]]
            if self.believed["forces"] is not None:
                forces += np.linalg.norm(self.believed["forces"], axis=1)[:, None] * share[:, None]
            if self.believed["body_force"] is not None:
                weights = weights + float(np.linalg.norm(self.believed["body_force"])) * share
        if self.body.base is not None:
            units = changes[:, self._offsets["supports"]].reshape(len(changes), -1, 3)
            forces[:, :n_nodes] += _spread(self.body.base, self.base_young * units)
        return forces, weights

    def frame(self, coefficients: FloatArray) -> FloatArray:
        """Return the coefficients (6,) of the tracker's rigid motion among all (n_columns,); zero without one."""
        return np.asarray(coefficients[self._offsets["frame"]]) if "frame" in self._offsets else np.zeros(6)

    def without_frame(self, coefficients: FloatArray) -> FloatArray:
        """Return coefficients (n_columns,) with the part that is a rigid motion of the tracker set to zero."""
        out: FloatArray = np.array(coefficients)
        if "frame" in self._offsets:
            out[self._offsets["frame"]] = 0.0
        return out

    def core_families(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Return columns, candidate factors on the variance and log priors of every family, for the sampler."""
        found = []
        for family in self.families:
            variances = np.zeros(self.n_columns)
            variances[family.columns] = family.variance
            found.append((variances, family.factors, family.log_prior))
        return found


def _spread(patches: Patches, units: FloatArray) -> FloatArray:
    """Return nodal values (n, n_nodes, 3): amplitudes (n, n_patches, 3) times the patches' shapes."""
    on_nodes = np.asarray(patches.shapes.T @ np.moveaxis(units, 0, 1).reshape(patches.n_patches, -1))
    return np.moveaxis(on_nodes.reshape(-1, len(units), 3), 1, 0)


def _in_mm(size: tuple[float, float], extent: float) -> tuple[float, float]:
    """Return (median, standard deviation of the logarithm) of a size given over the extent, with the median in mm."""
    return (size[0] * extent, size[1])


def contact_sizes(columns: Columns, settings: ContactSettings) -> FloatArray:
    """Return the candidate sizes of a contact, mm, shape (n_sizes,)."""
    return np.array(settings.sizes) * columns.body.mesh.extent


def spring_stiffness(body: ContactBody, material: Material, stiffness: float) -> FloatArray | None:
    """Return the stiffness (n_sets, 2) of a body's springs in kPa/mm; that of a soft bed is fixed.

    `body`: with its supports; `material`: its mean modulus is the unit; `stiffness`: of doubtful supports, in Young's
    modulus over extent.
    """
    young = float(np.mean(material.young_array)) * (stiffness if body.base is not None else 1.0)
    return np.array([unit * young for _, unit in body.springs]) if body.springs else None


def _patch_young(body: ContactBody, material: Material) -> FloatArray:
    """Return the geometric mean of Young's modulus over the tets within each patch's radius, (n_patches,) in kPa."""
    from scipy.spatial import cKDTree

    patches, young = body.patches, material.young_array
    by_tet = young if young.ndim == 1 else young.mean(axis=1)
    if np.ptp(by_tet) == 0.0:
        return np.full(patches.n_patches, float(by_tet[0]))
    tree = cKDTree(body.mesh.nodes[body.mesh.tets].mean(axis=1))
    nearest = np.asarray(tree.query(patches.centres)[1])
    within = tree.query_ball_point(patches.centres, patches.radii)
    logs = np.log(by_tet)
    return np.exp([logs[near].mean() if near else logs[one] for near, one in zip(within, nearest, strict=True)])


def log_filled(columns: Columns, settings: ContactSettings) -> FloatArray:
    """Return the logarithm of the prior probability of a slot's patch and size, shape (n_patches, n_sizes).

    All radii are equally likely, and so are all centres of one radius; sizes above a share of the radius are unlikely.
    """
    patches = columns.body.patches
    sizes = contact_sizes(columns, settings)
    by_size = -0.5 * (sizes / (settings.largest_share * patches.radii[:, None])) ** 2
    by_size -= np.log(np.exp(by_size).sum(axis=1, keepdims=True))
    count = np.bincount(patches.level)
    filled = np.log(settings.odds / (1.0 + settings.odds)) - np.log(len(count))
    return np.ascontiguousarray(filled - np.log(count[patches.level])[:, None] + by_size)


def sampler(columns: Columns, settings: ContactSettings, responses: FloatArray, data: dict[str, Any]) -> Any:
    """Return the compiled sampling problem of one linearisation.

    `columns`: causes; `settings`: prior; `responses` (n_obs, n_columns): responses of the observations to the columns;
    `data`: ``innovation`` (n_obs,), ``noise`` (n_obs, n_obs), ``groups``: rows of each marker. Result: runs the
    sampler, and computes moments from its samples.
    """
    from tissuereg import _core

    patches = columns.body.patches
    wrong_variance = (settings.wrong_share * columns.body.mesh.extent) ** 2
    return _core.Contacts(
        np.ascontiguousarray(responses),
        texture=patches.texture,
        neighbours=patches.neighbours,
        variances=contact_sizes(columns, settings) ** 2,
        log_filled=log_filled(columns, settings),
        log_empty=-float(np.log1p(settings.odds)),
        n_slots=settings.n_slots,
        families=columns.core_families(),
        wrong=(data["groups"], wrong_variance, float(np.log(settings.wrong_odds))),
        innovation=np.ascontiguousarray(data["innovation"]),
        noise=np.ascontiguousarray(data["noise"]),
    )
