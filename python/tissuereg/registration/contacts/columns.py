"""All causes that may have moved the body, one column each: their loads, priors, and responses of observations to them.

A cause acts in proportion to an unknown coefficient. Columns come in blocks. The first holds a force along each of
three axes for each patch of the surface; a contact is a choice among these patches. Then follow a body force, the error
of a believed load, the tractions of doubtful supports, a rigid motion, a stiffness that changes across the body, and a
displacement that no load explains; the last two move the body beside its equilibrium. The causes of a block share one
unknown size (they are a family); that of the first block describes weak tractions on all patches at once, the
background.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.registration.contacts.body import ContactBody
from tissuereg.registration.contacts.patches import Patches
from tissuereg.registration.contacts.sensed import Sensed
from tissuereg.registration.contacts.settings import DISCRETISATION, ContactSettings
from tissuereg.registration.contacts.unexplained import Rows, Unexplained
from tissuereg.simulation.sensitivity import Cause, Compliance, ModulusField
from tissuereg.simulation.solve import LoadParts


@dataclass(frozen=True)
class Family:
    """A group of causes, such as all tractions of the background, that share one unknown standard deviation.

    The coefficients are independent normals of variance `variance` times a factor. `name`: the block of causes;
    `columns`: their indices; `variance`: variance of each coefficient at factor one, dimensionless; `factors`
    (n_levels,): candidate factors, in the squared unit of the coefficients (mm^2; dimensionless for a believed load);
    `log_prior` (n_levels,): logarithm of each factor's prior probability, up to a constant.
    """

    name: str
    columns: slice
    variance: float
    factors: FloatArray
    log_prior: FloatArray

    @classmethod
    def of(cls, name: str, columns: slice, variance: float, size: tuple[float, float]) -> "Family":
        """Return a family whose standard deviation has a discretised log-normal prior.

        `name`: the block of causes; `columns`: their indices; `variance`: variance of a coefficient at factor one;
        `size`: median of the standard deviation, in mm (for a believed load relative to it), and standard deviation of
        its logarithm.
        """
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
        Mean Young's modulus near every patch of the surface, kPa; the force of a unit coefficient is in proportion to
        it.
    base_young : float
        Mean Young's modulus of the body, kPa, the unit of tractions and springs at the supports.
    springs : ndarray of float64, shape (n_sets, 2), or None
        Normal and tangential stiffness, kPa/mm, of the springs under doubtful supports or under a free body; None
        without springs.
    believed : LoadParts
        The believed load: forces in mN, body force in mN/mm^3, prescribed displacement in mm. At zero coefficients
        exactly this load acts.
    families : tuple of Family
        Groups of causes with a common standard deviation; the first are the weak tractions on all patches (the
        background).
    rigid : ndarray of float64, shape (2, 3)
        First row: pivot of rigid rotations, mm; second row, three times: the distance from it, mm, at which a unit
        rotation moves by 1 mm.
    unexplained : Unexplained or None
        Displacement that no load explains; None if there is none.
    """

    body: ContactBody
    young: FloatArray
    base_young: float
    springs: FloatArray | None
    believed: LoadParts
    families: tuple[Family, ...]
    rigid: FloatArray
    unexplained: Unexplained | None
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
        stiffness: tuple[float, float] | None = None,
        unexplained: Unexplained | None = None,
    ) -> "Columns":
        """Return the possible causes of motion of a body of some material under a believed load.

        `body`: prepared mesh; `material`: its material; `believed`: parts of the believed load, None where there is
        none; `settings`: prior; `drifts`: whether a small rigid motion of the tracker is one of the causes;
        `stiffness`: size of the change of ln E across the body, with Young's modulus E (median, standard deviation of
        its logarithm), None for none; `unexplained`: displacement that no load explains, None for none.
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
        if stiffness is not None:
            blocks.append(("stiffness", len(body.profiles), stiffness))
        if unexplained is not None:
            median, spread = settings.unexplained
            blocks.append(("unexplained", unexplained.n_columns, (median * unexplained.motion, spread)))
        first = n_patches
        for name, count, size in blocks:
            families.append(Family.of(name, slice(first, first + count), 1.0, size))
            first += count
        nodes, mean = body.mesh.nodes, float(np.mean(material.young_array))
        rigid = np.stack([nodes.mean(axis=0), np.full(3, 0.5 * body.mesh.extent)])
        offsets = {family.name: family.columns for family in families}
        springs = spring_stiffness(body, material, settings.support_stiffness)
        return cls(
            body, _patch_young(body, material), mean, springs, believed, tuple(families), rigid, unexplained, offsets
        )

    @property
    def n_columns(self) -> int:
        """Number of causes, which is that of their coefficients."""
        return int(self.families[-1].columns.stop)

    @property
    def n_patches(self) -> int:
        """Number of patches of the free surface on which a contact may act."""
        return self.body.patches.n_patches

    def on_springs(self, stiffness: Sequence[float]) -> "Columns":
        """Return the same causes on springs of other stiffness.

        `stiffness`: one number per set of springs, in units of Young's modulus over the body's extent.
        """
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

    def responses(
        self,
        sensed: Sensed,
        places: FloatArray,
        rigid: FloatArray | None = None,
        beside: tuple[Rows, FloatArray] | None = None,
    ) -> FloatArray:
        """Return the displacement of observations by a unit coefficient of every cause, (n_rows, n_columns), in mm.

        `sensed`: sensitivities of the observations to nodal forces; `places` (n_points, 3): deformed positions of the
        observed points, mm, with one row of the result for each axis of each point; only rigid motions need them;
        `rigid` (n_rows, 6): displacement of the observations by unit rigid motions, mm, given instead of `places` where
        there are not three observations per point; `beside`: nodes (k,) and weights (k, 3) of the displacement in each
        observation, and forces (n, n_element_nodes, 3), mN, that changes of the stiffness leave unbalanced; without
        them causes beside the loads do nothing.
        """
        by_weight = sensed.image("weight", lambda one: one.body_force)
        out = np.zeros((len(by_weight), self.n_columns))
        own = sensed.image("patches", lambda one: self._by_patches(one, self.body.patches))
        out[:, : 3 * self.n_patches] = own * np.repeat(self.young, 3)
        out[:, self._offsets["weight"]] = by_weight * self._body_force_unit
        if "believed" in self._offsets:
            out[:, self._offsets["believed"]] = sensed.image(None, self._believed_responses)
        base = self.body.base
        if base is not None:
            theirs = sensed.image("supports", lambda one: self._by_patches(one, base))
            out[:, self._offsets["supports"]] = self.base_young * theirs
        if "frame" in self._offsets:
            out[:, self._offsets["frame"]] = self.rigid_field(places).reshape(6, -1).T if rigid is None else rigid
        if beside is not None and "stiffness" in self._offsets:
            out[:, self._offsets["stiffness"]] = sensed.image("stiffness", lambda one: _by_unbalanced(one, beside[1]))
        if beside is not None and self.unexplained is not None:
            out[:, self._offsets["unexplained"]] = self.unexplained.responses(beside[0])
        return out

    def _by_patches(self, compliance: Compliance, patches: Patches) -> FloatArray:
        """Return the derivatives (n_rows, 3 n_patches) of observations by amplitudes of tractions on patches."""
        forces = compliance.forces[:, : self.body.mesh.n_nodes]
        found = [(patches.shapes @ np.ascontiguousarray(forces[:, :, axis].T)).T for axis in range(3)]
        return np.stack(found, axis=2).reshape(len(forces), 3 * patches.n_patches)

    def stiffness_causes(self, material: Material) -> list[Cause]:
        """Return the changes of Young's modulus by unit coefficients, in proportion to that of a material."""
        if "stiffness" not in self._offsets:
            return []
        young = self.body.simulator.moduli(material)[0]
        by_tet = young if young.ndim == 1 else young.mean(axis=1)
        return [ModulusField("young", profile * by_tet) for profile in self.body.profiles]

    def beside(self, coefficients: FloatArray, by_stiffness: FloatArray) -> dict[str, FloatArray]:
        """Return the displacements (..., n_nodes, 3), mm, beside the equilibrium under the load, by block of causes.

        `coefficients` (..., n_columns); `by_stiffness` (n, n_element_nodes, 3): by unit changes of the stiffness, mm.
        """
        found = {}
        if "stiffness" in self._offsets:
            by_nodes = by_stiffness[:, : self.body.mesh.n_nodes]
            found["stiffness"] = np.tensordot(coefficients[..., self._offsets["stiffness"]], by_nodes, 1)
        if self.unexplained is not None:
            found["unexplained"] = self.unexplained.displacement(coefficients[..., self._offsets["unexplained"]])
        return found

    def slopes(self, coefficients: FloatArray) -> FloatArray:
        """Return those of the coefficients (n_columns,) that change ln E across the body, (n,); none if it is known."""
        return np.asarray(coefficients[self._offsets.get("stiffness", slice(0, 0))])

    def rest_sizes(self, levels: IntArray) -> FloatArray:
        """Return the variance, mm^2, of a displacement that no load explains, in each sample; zero if there is none.

        `levels` int64 (n_samples, n_families): candidate size of each family in each sample.
        """
        found = [family.factors[own] for family, own in zip(self.families, levels.T, strict=True)]
        named = [family.name for family in self.families]
        return found[named.index("unexplained")] if "unexplained" in named else np.zeros(len(levels))

    def rigid_rows(self, places: FloatArray, directions: FloatArray) -> FloatArray:
        """Return the motions (n, 6), mm, of places along unit vectors by unit translations and rotations.

        `places` (n, 3): mm; `directions` (n, 3): one unit vector for each place. A unit rotation moves points at the
        length `rigid[1]` by 1 mm.
        """
        return np.asarray(np.einsum("kpx,px->pk", self.rigid_field(places), directions))

    def rigid_field(self, places: FloatArray) -> FloatArray:
        """Return the motions (6, n_points, 3), mm, of places (n_points, 3), mm, by unit translations and rotations.

        A unit translation is 1 mm along an axis; a unit rotation about an axis moves points at the length `rigid[1]` by
        1 mm.
        """
        pivot, length = self.rigid
        moves = np.zeros((6, len(places), 3))
        for axis in range(3):
            moves[axis, :, axis] = 1.0
            moves[3 + axis] = np.cross(np.eye(3)[axis], places - pivot) / length[0]
        return moves

    def _believed_responses(self, compliance: Compliance) -> FloatArray:
        """Return how observations respond to a relative error of the believed load along each axis, (n_obs, 3), in mm.

        A unit error along an axis adds there, at every node, a force of the size of the believed one; the same holds
        for body force and prescribed displacement. `compliance`: derivatives of the observations by nodal forces.
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
        """Return the load at coefficients (n_columns,) of the causes, the believed load included.

        It has nodal forces (n_element_nodes, 3), mN, a body force (3,), mN/mm^3, and prescribed displacements of the
        held nodes (n_held, 3), mm. A rigid motion is no part of it.
        """
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
        """Return the nodal forces (..., n_element_nodes, 3), mN, equivalent to body forces (..., 3), in mN/mm^3."""
        return np.asarray(self.body.node_volumes[:, None] * body_force[..., None, :])

    def forces(self, changes: FloatArray) -> FloatArray:
        """Return the nodal forces (n, n_element_nodes, 3), mN, of changes (n, n_columns) of the coefficients.

        The body force is distributed over the nodes; prescribed motion of held nodes is not included.
        """
        forces, weights = self._forces_and_weights(changes)
        return np.asarray(forces + self.weight_forces(weights))

    def _forces_and_weights(self, changes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return nodal forces (n, n_element_nodes, 3), mN, and body forces (n, 3), mN/mm^3, of changes of coefficients.

        `changes` (n, n_columns): changes of the coefficients. The believed load itself is not included.
        """
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
        """Return those of the coefficients (n_columns,) that are a rigid motion of the tracker, shape (6,), in mm.

        They are three translations, then three rotations, each as the displacement at the length `rigid[1]`. They are
        zero if the causes contain no rigid motion.
        """
        return np.asarray(coefficients[self._offsets["frame"]]) if "frame" in self._offsets else np.zeros(6)

    def without_frame(self, coefficients: FloatArray) -> FloatArray:
        """Return a copy of the coefficients (n_columns,) with those of the tracker's rigid motion set to zero."""
        out: FloatArray = np.array(coefficients)
        if "frame" in self._offsets:
            out[self._offsets["frame"]] = 0.0
        return out

    def core_families(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Return the prior of every family of causes for the compiled sampler: a tuple of three arrays per family.

        They are the variances of all coefficients (n_columns,), zero outside the family; the candidate factors on them
        (n_levels,); and the logarithm of the prior of each factor (n_levels,).
        """
        found = []
        for family in self.families:
            variances = np.zeros(self.n_columns)
            variances[family.columns] = family.variance
            found.append((variances, family.factors, family.log_prior))
        return found


def _spread(patches: Patches, units: FloatArray) -> FloatArray:
    """Return nodal values (n, n_nodes, 3): amplitudes (n, n_patches, 3) of the patches times the patches' shapes.

    With amplitudes in kPa times coefficients in mm the values are nodal forces in mN.
    """
    on_nodes = np.asarray(patches.shapes.T @ np.moveaxis(units, 0, 1).reshape(patches.n_patches, -1))
    return np.moveaxis(on_nodes.reshape(-1, len(units), 3), 1, 0)


def _by_unbalanced(compliance: Compliance, forces: FloatArray) -> FloatArray:
    """Return the displacements (n_rows, n), mm, of observations by nodal forces (n, n_element_nodes, 3), mN.

    Not by BLAS, whose bits depend on its number of threads: a renewal runs beside calls that change that number.
    """
    return np.asarray(np.einsum("onx,snx->os", compliance.forces, forces))


def _in_mm(size: tuple[float, float], extent: float) -> tuple[float, float]:
    """Return (median in mm, standard deviation of the logarithm), given the median as a share of `extent` (mm)."""
    return (size[0] * extent, size[1])


def contact_sizes(columns: Columns, settings: ContactSettings) -> FloatArray:
    """Return the candidate sizes of a contact, shape (n_sizes,), mm: standard deviations of its force coefficients."""
    return np.array(settings.sizes) * columns.body.mesh.extent


def spring_stiffness(body: ContactBody, material: Material, stiffness: float) -> FloatArray | None:
    """Return the normal and tangential stiffness of each set of a body's springs, (n_sets, 2), in kPa/mm.

    `body`: prepared mesh with its supports; `material`: its mean Young's modulus scales the stiffness; `stiffness`: of
    doubtful supports, in Young's modulus over extent. The soft bed under a body without supports has a fixed stiffness.
    Result: None without springs.
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
    """Return the log prior probability that a contact is on each patch with each size, shape (n_patches, n_sizes).

    The probabilities of all patches and sizes add up to that of a contact being there at all. All radii are equally
    likely, and so are all centres of one radius; sizes above a share of the radius are unlikely.
    """
    patches = columns.body.patches
    sizes = contact_sizes(columns, settings)
    by_size = -0.5 * (sizes / (settings.largest_share * patches.radii[:, None])) ** 2
    by_size -= np.log(np.exp(by_size).sum(axis=1, keepdims=True))
    count = np.bincount(patches.level)
    filled = np.log(settings.odds / (1.0 + settings.odds)) - np.log(len(count))
    return np.ascontiguousarray(filled - np.log(count[patches.level])[:, None] + by_size)


def sampler(columns: Columns, settings: ContactSettings, responses: FloatArray, data: dict[str, Any]) -> Any:
    """Return the compiled sampling problem of one linearisation; its methods draw samples and compute their moments.

    `columns`: possible causes; `settings`: prior; `responses` (n_obs, n_columns): displacement of the observations by a
    unit coefficient of every cause, mm; `data`: a dict of ``innovation`` (n_obs,), measured minus predicted at zero
    coefficients, mm; ``noise`` (n_obs, n_obs), covariance, mm^2; and ``groups``, the list of each marker's
    observations.
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
