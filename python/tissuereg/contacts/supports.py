"""What holds a body: nodes held for sure, nodes perhaps held, or nothing but what lies around it."""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray, IntArray
from tissuereg.errors import SupportError
from tissuereg.mesh import Mesh

#: Node set of nodes that are perhaps held.
PERHAPS = "perhaps_fixed"

#: Ways to take the node set ``fixed``.
HELD = ("sure", "perhaps", "free")

#: Stiffness of what lies around a free body, over Young's modulus of one kPa and the body's extent.
_BED = 0.1


@dataclass(frozen=True, eq=False)
class Supports:
    """Nodes that are held.

    Attributes
    ----------
    sure : ndarray of int64, shape (n,)
        Held for sure.
    perhaps : ndarray of int64, shape (m,)
        Perhaps held: they stay, or move by an unknown, smooth motion.
    """

    sure: IntArray
    perhaps: IntArray

    @property
    def holds(self) -> bool:
        """Whether any node is held, for sure or perhaps."""
        return bool(len(self.sure) + len(self.perhaps))

    @property
    def moves(self) -> bool:
        """Whether no node is held for sure: a rigid motion is then unknown."""
        return len(self.sure) == 0

    def digest(self) -> str:
        """Return a fingerprint."""
        parts = (self.sure.astype("<i8").tobytes(), b"|", self.perhaps.astype("<i8").tobytes())
        return hashlib.sha256(b"".join(parts)).hexdigest()

    @classmethod
    def of(cls, mesh: Mesh, held: str, held_nodes: Any = None) -> "Supports":
        """Return the supports of a mesh.

        Parameters
        ----------
        mesh : Mesh
            Its node sets ``fixed`` and ``perhaps_fixed`` count; a mesh without either is free.
        held : {"sure", "perhaps", "free"}
            How the set ``fixed`` is taken.
        held_nodes : array_like of int, optional
            Nodes in place of the set ``fixed``.

        Returns
        -------
        Supports
            Without nodes in both parts.

        Raises
        ------
        SupportError
            If `held` is none of these.
        """
        if held not in HELD:
            message = f"`held` must be 'sure', 'perhaps' or 'free', got {held!r}"
            raise SupportError(message, where="held")
        none = np.empty(0, np.int64)
        fixed = mesh.node_sets.get("fixed", none) if held_nodes is None else np.unique(np.asarray(held_nodes))
        perhaps = mesh.node_sets.get(PERHAPS, none)
        if held == "perhaps":
            return cls(none, np.union1d(fixed, perhaps))
        sure = fixed if held == "sure" else none
        return cls(np.asarray(sure, np.int64), np.setdiff1d(perhaps, sure))


def springs_of(mesh: Mesh) -> list[tuple[IntArray, FloatArray]]:
    """Return the soft bed of a body that nothing holds: springs on all of its surface, kPa/mm."""
    stiffness = _BED / mesh.extent
    return [(mesh.surface, np.array([stiffness, stiffness]))]
