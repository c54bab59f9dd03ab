"""The class `Body`: what is assumed of a body before a registration: its mesh, its material, its supports."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice, found, maybe, named, real
from tissuereg._base.arrays import IntArray, frozen, index_array
from tissuereg._base.choices import BODY_ELEMENTS, STIFFNESS, BodyElement, Element, Held, Stiffness
from tissuereg._base.provenance import warn
from tissuereg._base.shown import notebook, short_repr
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.body.topology import sound_mesh
from tissuereg.errors import ArgumentError, MaterialError, MeshError, ShapeError
from tissuereg.registration.contacts.supports import Supports, support_warnings

#: Meshes with at most this many nodes get averaged elements, and so do materials with a larger Poisson's ratio.
COARSE_NODES, STIFF_POISSON = 3000, 0.475

_FIELDS = ("mesh", "material", "element", "held", "stiffness", "held_nodes", "regions")


@dataclass(frozen=True, eq=False)
class StiffPart:
    """A part of a body with a stiffness of its own.

    Attributes
    ----------
    tets : ndarray of int64, shape (n,)
        Numbers of its tets, of a `Body` without those of smaller parts.
    young, std : float
        Young's modulus and its standard deviation, kPa.
    """

    tets: IntArray
    young: float
    std: float

    @classmethod
    def of(cls, mesh: Mesh, name: str, given: Any) -> "StiffPart":
        """Return the region of a node set; `given`: its modulus, (modulus, standard deviation), or a region."""
        if isinstance(given, StiffPart):
            return given
        several = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str) and np.ndim(given) > 0
        numbers = given if several else (given, 0.0)
        if len(numbers) != 2:
            message = f"`regions` must hold a modulus, or it and its standard deviation, got {found(given)} of '{name}'"
            raise MaterialError(message, where=name)
        young, std = (real(f"regions['{name}']", one, unit="kPa", error=MaterialError) for one in numbers)
        if not (young > 0.0 and std >= 0.0):
            message = f"`regions` must hold a modulus above 0 kPa and a standard deviation from 0, got {found(given)}"
            raise MaterialError(message, where=name)
        tets = np.flatnonzero(np.isin(mesh.tets, mesh.node_set(name)).all(axis=1))
        if not len(tets):
            message = f"`regions` must name node sets with whole tets in them; '{name}' has none"
            raise MeshError(message, where=name)
        return cls(tets, young, std)

    def within(self, material: Material, n_tets: int) -> Material:
        """Return a material of n_tets tets with this modulus here."""
        young = material.young_array
        young = np.array(np.broadcast_to(young, (n_tets, *young.shape[1:])))
        young[self.tets] = self.young
        return replace(material, young=young)


@dataclass(frozen=True, eq=False, init=False)
class Body:
    """Prior assumptions about a body: mesh, material, elements, supports; a registration takes one in place of a mesh.

    Parameters
    ----------
    mesh : Mesh or (nodes, tets, fixed_nodes)
        Undeformed body in mm. The nodes of its set ``fixed`` are held in place; those of its set ``perhaps_fixed`` may
        or may not be held. A mesh without either set, or with empty ones, can move freely: a rigid motion is then
        unknown as well. A registration warns of that unless `held` is ``"free"``, and of sets such as ``Fixed``, which
        hold nothing.
    material : Material, optional
        The assumed material, by default ``Material()``. Without a load its stiffness affects only the estimated forces,
        not the shape.
    element : {"auto", "tet4", "tet4-averaged", "tet10"}
        Finite elements of the package's own solves: four-node tets, four-node tets with volume ratios averaged at the
        nodes, or ten-node tets. ``"auto"`` without a trained model: averaged ones on coarse meshes and near
        incompressibility, where plain four-node tets are too stiff; otherwise ``"tet4"``.
    held : {"sure", "perhaps", "free"}
        Without a trained model: whether the nodes of the set ``fixed`` are surely held in place, may be held, or are
        free to move.
    stiffness : {"believed", "graded"}
        Without a trained model: whether the stiffness is distributed as in `material`, up to a small slope of its
        logarithm along each principal axis of the body, or that slope may be large; the markers tell how large.
    held_nodes : array_like of int, optional
        Numbers of the nodes whose displacement the load prescribes, if they differ from the set ``fixed``.
    regions : mapping of str to float or (float, float), optional
        Young's modulus, kPa, of parts of the body, such as a tumour, by the names of node sets: of the tets that have
        all their corners in the set. With a second number, its standard deviation, kPa, the answer's uncertainty
        allows for it. Of parts that overlap the smaller counts. Without a trained model.

    Raises
    ------
    ShapeError, MeshError
        If `mesh` is not a mesh, `held_nodes` are not whole numbers, or a region is no node set with tets in it.
    SupportError
        If `held` is not one of these words, `held_nodes` are no nodes of the mesh, or no node of its surface is free.
    MaterialError, ArgumentError
        If `stiffness` or `element` is not one of these words, `material` is not a material, or a number of `regions` is
        not positive.

    Examples
    --------
    >>> import tissuereg as tr
    >>> body = tr.Body(tr.phantom.phantom_mesh(), tr.Material(young=5.0), held="perhaps")
    >>> body.fitting_element
    'tet4'
    """

    mesh: Mesh
    material: Material
    element: BodyElement
    held: Held
    stiffness: Stiffness
    held_nodes: IntArray | None
    regions: dict[str, StiffPart]

    __repr__ = short_repr

    def __init__(
        self,
        mesh: Mesh | tuple[Any, Any, Any],
        material: Material | None = None,
        element: BodyElement = "auto",
        held: Held = "sure",
        stiffness: Stiffness = "believed",
        held_nodes: Any = None,
        regions: Mapping[str, Any] | None = None,
    ) -> None:
        body = as_mesh(mesh)
        check_choice("element", element, BODY_ELEMENTS, ArgumentError)
        check_choice("stiffness", stiffness, STIFFNESS, MaterialError)
        nodes = None if held_nodes is None else frozen(np.array(index_array("held_nodes", held_nodes, (None,))))
        Supports.of(body, held, nodes)  # refuses another word, and nodes that are not there
        believed = maybe("material", material, Material) or Material()
        parts = {name: StiffPart.of(body, name, given) for name, given in named("regions", regions).items()}
        parts = _apart(parts)
        for part in parts.values():
            believed = part.within(believed, body.n_tets)
        for name, value in zip(_FIELDS, (body, believed, element, held, stiffness, nodes, parts), strict=True):
            object.__setattr__(self, name, value)

    @classmethod
    def of(cls, given: Any) -> "Body":
        """Return `given` if it is a `Body`, otherwise the body of this mesh, or of (nodes, tets, fixed_nodes) in mm."""
        return given if isinstance(given, Body) else cls(given)

    @cached_property
    def supports(self) -> Supports:
        """Nodes that are held, for sure or perhaps."""
        return Supports.of(self.mesh, self.held, self.held_nodes)

    def warn_of_supports(self) -> None:
        """Warn if nothing holds the body though it is not stated to be free, or if a set such as ``Fixed`` does not."""
        for sentence in support_warnings(self.mesh, self.supports, self.held):
            warn(sentence)

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        return notebook("body", self.mesh, self)

    @cached_property
    def held_mesh(self) -> Mesh:
        """The mesh; without the nodes of its set ``fixed`` if these are free to move."""
        unheld = self.held == "free" and len(self.mesh.node_sets.get("fixed", ()))
        return self.mesh.with_node_set("fixed", []) if unheld else self.mesh

    @cached_property
    def fitting_element(self) -> Element:
        """Name of the elements without a trained model: `element`, or for "auto" those that suit mesh and material."""
        return fitting_element(self.mesh, self.material) if self.element == "auto" else self.element

    def to_json(self) -> dict[str, Any]:
        """Return all assumptions but the mesh as a dict of plain numbers and strings; None where a modulus varies."""
        law = self.material
        return {
            "element": self.element,
            "held": self.held,
            "stiffness": self.stiffness,
            "regions": {
                name: {"young_kpa": one.young, "std_kpa": one.std, "tets": len(one.tets)}
                for name, one in self.regions.items()
            },
            "material": {
                "law": law.law,
                "young_kpa": float(law.young) if np.ndim(law.young) == 0 else None,
                "poisson": float(law.poisson) if np.ndim(law.poisson) == 0 else None,
                "density": float(law.density),
                "digest": law.digest(),
            },
        }


def _apart(parts: dict[str, StiffPart]) -> dict[str, StiffPart]:
    """Return parts without the tets that belong to a smaller one, or to a later one of the same size."""
    taken, left = np.empty(0, np.int64), {}
    names = list(parts)
    for name in sorted(names, key=lambda one: (len(parts[one].tets), -names.index(one))):
        own = np.setdiff1d(parts[name].tets, taken)
        left[name], taken = replace(parts[name], tets=own), np.union1d(taken, own)
    return {name: left[name] for name in parts}


def as_mesh(mesh: Any) -> Mesh:
    """Return the mesh given, or the one of (nodes in mm, tets, numbers of fixed nodes); else raise `ShapeError`."""
    if isinstance(mesh, Mesh):
        return mesh
    if not isinstance(mesh, tuple) or len(mesh) != 3:
        message = f"`mesh` must be a Mesh, a Body or (nodes, tets, fixed_nodes), got {type(mesh).__name__}"
        raise ShapeError(message, where="mesh")
    # Answers have one row a node given: none are joined.
    return sound_mesh(mesh[0], mesh[1], {"fixed": mesh[2]}, coincident="keep")[0]


def fitting_element(mesh: Mesh, material: Material) -> Element:
    """Return "tet4-averaged" where plain four-node tets would be much too stiff for mesh and material, else "tet4"."""
    coarse = mesh.n_nodes <= COARSE_NODES
    return "tet4-averaged" if coarse or float(np.max(material.poisson_array)) > STIFF_POISSON else "tet4"
