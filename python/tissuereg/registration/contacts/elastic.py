r"""Linear elastic priors of displacement fields: which fields a body at rest may take, to first order.

With the stiffness matrix K of the body at rest, the matrix C that maps a displacement field to the displacement of the
markers, and the covariance P of the field, each method of `ElasticBody` returns a `LinearPrior`:

* `least_energy`: ``P = K^-1``. The most probable field has the least strain energy ``u' K u / 2`` of all that explain
  the markers equally well; its forces act at the markers.
* `patch_loads`: ``P = K^-1 B B' K^-1``, independent loads on patches of the surface that overlap: smooth tractions.

A body whose support gives moves as a whole, too: `ElasticBody.given_way` adds that to any of them.
"""

from functools import cached_property

import numpy as np

from tissuereg._base.arguments import real, whole
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Element
from tissuereg.body.load import Load
from tissuereg.body.markers import Markers
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.contacts.patches import Patches, make_patches
from tissuereg.registration.linear_prior import LinearPrior
from tissuereg.simulation.sensitivity import Linearised, Observation
from tissuereg.simulation.solve import Simulator


class ElasticBody:
    """A body at rest with markers, linearised once for any number of priors of its displacement.

    `mesh`: undeformed body; its node set ``fixed`` is held; `material`: material; its law does not matter at rest;
    `markers`: reference places, mm, and noise, mm; the measured places are not used; `element` {"tet4",
    "tet4-averaged", "tet10"}: finite elements of the solver; `threads`: threads to use; 0 takes all cores. Raises
    `MarkerError` if a marker lies far from the body; `SupportError`, `MeshError` or `MaterialError` if the body cannot
    be linearised. The attribute `observed` maps the displacement of nodes to that of the markers.

    Notes
    -----
    Cost: a factorisation and one right-hand side per coordinate of a marker; each prior one or two times as many again.
    """

    def __init__(
        self, mesh: Mesh, material: Material, markers: Markers, *, element: Element = "tet4", threads: int = 0
    ) -> None:
        self.mesh = mesh
        self.observed = MarkerObservation.of(mesh, markers)
        self._std = markers.std
        self._young = float(np.median(material.young_array))
        simulator = Simulator(mesh, element=element)
        self._linearised = Linearised(
            simulator, Load(), material, np.zeros((simulator.body.n_nodes, 3)), threads=threads
        )

    @cached_property
    def rows(self) -> list[tuple[IntArray, FloatArray]]:
        """Nodes, int64 (k,), and weights, float64 (k, 3), of each of the 3 n_markers coordinates of the markers."""
        return self.observed.rows(np.zeros((len(self.observed.nodes), 3)))

    @cached_property
    def _at_markers(self) -> FloatArray:
        """Displacement per unit force on each coordinate of each marker, (3 n_markers, n_element_nodes, 3), mm/mN."""
        return self._linearised.compliance([Observation(*row) for row in self.rows]).forces

    @cached_property
    def _free(self) -> IntArray:
        """Numbers of the surface nodes that are not held, int64 (n_free,)."""
        return np.setdiff1d(self.mesh.surface_nodes, self.mesh.fixed_nodes)

    @cached_property
    def patches(self) -> Patches:
        """Overlapping round patches, of several radii, of the surface that is not held, on which loads may act."""
        return make_patches(self.mesh, self._free)

    def seen(self, fields: FloatArray) -> FloatArray:
        """Return the displacement of the markers, (n_fields, 3 n_markers), mm, in fields (n_fields, n_nodes, 3), mm."""
        columns = [np.einsum("fkx,kx->f", fields[:, nodes], weights) for nodes, weights in self.rows]
        return np.stack(columns, axis=1)

    def residual(self, displacement_mm: FloatArray, seen: IntArray, simulation_mm: FloatArray | None) -> FloatArray:
        """Return the measured displacements of some markers minus those of a simulation, (n_seen, 3), in mm.

        `displacement_mm` (n_seen, 3): measured; `seen` int64 (n_seen,): numbers of the markers; `simulation_mm`
        (n_nodes, 3): simulated displacement; None for the body at rest.
        """
        if simulation_mm is None:
            return displacement_mm
        return displacement_mm - self.observed.predict(simulation_mm[self.observed.nodes])[seen]

    def least_energy(self) -> LinearPrior:
        """Return the prior of the displacement under which a field is less likely, the more strain energy it takes.

        Its covariance is K^-1, with the stiffness matrix K of the body at rest.
        """
        fields = self._at_markers[:, : self.mesh.n_nodes]
        return LinearPrior(self.seen(fields), np.moveaxis(fields, 0, -1), self._std)

    def patch_loads(self, level: int) -> LinearPrior:
        """Return the prior of the displacement field by independent random loads on patches of one radius.

        `level`: number of the radius among those of `patches`, 0 for the smallest. At scale one each patch alone moves
        by about 1 mm. Raises `ArgumentError` if there is no such radius.
        """
        whole("level", level, most=int(self.patches.level.max()))
        shapes = self._young * self.patches.shapes[np.flatnonzero(self.patches.level == level)]
        fields = self._at_markers[:, : self.mesh.n_nodes]
        by_patch = np.stack([fields[:, :, axis] @ shapes.T for axis in range(3)], axis=-1)
        forces = np.zeros_like(self._at_markers)
        for axis in range(3):
            forces[:, : self.mesh.n_nodes, axis] = by_patch[:, :, axis] @ shapes
        moved = self._linearised.responses(forces)[:, : self.mesh.n_nodes]
        flat = by_patch.reshape(len(fields), -1)
        return LinearPrior(flat @ flat.T, np.moveaxis(moved, 0, -1), self._std)

    def priors(self, smooth: bool = True, rigid: float = 1.0) -> dict[str, LinearPrior]:
        """Return several priors of the displacement field by name; the one of the highest evidence is to be taken.

        `smooth`: whether smooth tractions on patches of each radius are among them beside the strain energy; `rigid`:
        variance of the markers by rigid motions of the whole body, which are added to each prior because a base may
        give, over that by elasticity.
        """
        found = {"least energy": self.least_energy()}
        for level in range(int(self.patches.level.max()) + 1 if smooth else 0):
            radius = float(self.patches.radii[self.patches.level == level][0])
            found[f"patches of {radius:.3g} mm"] = self.patch_loads(level)
        return {name: self.given_way(prior, rigid) for name, prior in found.items()}

    def given_way(self, prior: LinearPrior, share: float) -> LinearPrior:
        """Return a prior to which small rigid motions of the whole body, held nodes included, have been added.

        `prior`: prior of this body's displacement; `share`: variance of the markers by these motions over their
        variance by `prior`; 0 adds none. Raises `ArgumentError` if it is negative.
        """
        off = self.mesh.nodes - self.mesh.nodes.mean(axis=0)
        turns = np.cross(np.eye(3)[:, None], off) / np.sqrt(np.mean(off**2))
        motions = np.concatenate([np.broadcast_to(np.eye(3)[:, None], turns.shape), turns])
        return prior.plus(motions, self.seen(motions), real("share", share, least=0.0))
