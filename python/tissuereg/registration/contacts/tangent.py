"""The tangent at a body, with a cache of sensitivities of observations; the tangent at rest is kept between calls."""

import sys
import threading
from collections.abc import Callable, Hashable, Sequence
from copy import copy
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.machine import n_cores
from tissuereg.body.material import Material
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.sensed import KeptRows, Row, Sensed, apart, matrix, together
from tissuereg.registration.contacts.settings import EFFORT
from tissuereg.registration.contacts.state import BodyState
from tissuereg.simulation.sensitivity import Cause, Compliance, Linearised, ModulusField, Observation, Parameter

#: Uncertain parameters of the material or of springs.
Uncertain = Parameter | ModulusField


class Tangent:
    """A linearised equilibrium, with a cache of the sensitivities of observations to nodal forces.

    `linearised`: the equilibrium; `threads`: threads to use, 0 takes all cores; `stiffness`: changes of the stiffness;
    `spent`: iterations that moments have taken with it, beyond those with a tangent of their own; `moved` (n_nodes, 3):
    displacement of the body there, mm, at which observations are linearised too; None for that of the moment.
    """

    def __init__(
        self,
        linearised: Linearised,
        threads: int = 0,
        stiffness: Sequence[Cause] = (),
        moved: FloatArray | None = None,
    ) -> None:
        self.linearised = linearised
        self.moved = moved
        self.spent = 0
        self._stiffness = stiffness
        body = linearised.simulator.body
        self._at_once = (
            EFFORT.block * (threads or n_cores()) if body.n_unknowns >= EFFORT.many_unknowns else sys.maxsize
        )
        self._known: dict[bytes, Compliance] = {}
        self._kept = KeptRows()
        self._unbalanced: dict[Hashable, FloatArray] = {}
        self._lock = threading.Lock()
        self._first: Tangent | None = None

    def anew(self) -> "Tangent":
        """Return this tangent for another registration: it knows the same rows, but sums none that only others used.

        A sum has not the bits of a row that is solved, and an answer must not depend on what was registered before.
        """
        made = copy(self)
        made._first, made._kept = self, KeptRows()
        return made

    def onwards(self) -> "Tangent":
        """Return this tangent for the registration of a later moment: it knows the same rows, and adds to none of here.

        Several may go on from one moment, and none of them depends on the others.
        """
        made = copy(self)
        made._kept = self._kept.copy()
        return made

    @cached_property
    def stiffness_forces(self) -> FloatArray:
        """Forces that unit changes of the stiffness leave unbalanced, (n, n_element_nodes, 3), mN."""
        if self._first is not None:
            return self._first.stiffness_forces
        return np.asarray(-self.linearised.unbalanced(self._stiffness))

    @cached_property
    def by_stiffness(self) -> FloatArray:
        """Displacements (n, n_element_nodes, 3), mm, by unit changes of the stiffness, to first order."""
        if self._first is not None:
            return self._first.by_stiffness
        forces = self.stiffness_forces
        return self.linearised.responses(forces) if forces.any() else np.zeros_like(forces)

    def unbalanced(self, cause: Uncertain) -> FloatArray:
        """Return the forces (n_element_nodes, 3), mN, that a unit of a cause leaves unbalanced; they are kept."""
        key = _key(cause)
        if key not in self._unbalanced:
            self._unbalanced[key] = self.linearised.unbalanced([cause])[0]
        return self._unbalanced[key]

    def by_cause(self, sensed: Sensed, cause: Uncertain) -> FloatArray:
        """Return minus the derivative of observations by a cause, (n_rows,), in mm per unit of the cause."""
        forces = self.unbalanced(cause).ravel()
        return sensed.image(_key(cause), lambda one: one.forces.reshape(-1, len(forces)) @ forces)

    def compliance(
        self, rows: Sequence[Row], progress: Callable[[int, int], None] | None = None
    ) -> tuple[Compliance, int]:
        """Return the sensitivities of observations as of `sensed`, one row each, mm per mN, and the number solved."""
        sensed, solved = self.sensed(rows, progress)
        return sensed.compliance, solved

    def sensed(self, rows: Sequence[Row], progress: Callable[[int, int], None] | None = None) -> tuple[Sensed, int]:
        """Return the sensitivities of observations to nodal forces, and the number of right-hand sides solved for them.

        `rows`: nodes (k,) and weights (k, 3) of each observation; `progress`: called with right-hand sides solved and
        to solve, on large bodies. Rows that are known, or sums of known ones of the same nodes, are not solved again.
        """
        keys = [nodes.tobytes() + b"|" + weights.tobytes() for nodes, weights in rows]
        kept = self._kept
        with kept.lock:
            shares = kept.shares(dict(zip(keys, rows, strict=True)))
            left = {key: row for key, row in zip(keys, rows, strict=True) if key not in shares}
            with self._lock:
                known = {key: self._known[key] for key in left if key in self._known}
            missing = {key: row for key, row in left.items() if key not in known}
            every = list(known.values())
            if missing or not rows:
                solved = self._solved(list(missing.values()), progress)
                every.append(solved)
                self._remember(missing, solved)
            if len(kept) + len(left) <= EFFORT.remembered and rows:
                if left:
                    kept.add({key: left[key] for key in [*known, *missing]}, together(every))
                    shares |= kept.shares(left)
                return Sensed(None, kept, matrix(keys, shares, len(kept))), len(missing)
            if len(missing) == len(rows):
                return Sensed(solved), len(missing)
            some = [key for key in dict.fromkeys(keys) if key in shares]
            if some:
                every.append(Sensed(None, kept, matrix(some, shares, len(kept))).compliance)
        parts = dict(zip([*known, *missing, *some], apart(together(every)), strict=True))
        return Sensed(together([parts[key] for key in keys])), len(missing)

    def _solved(self, rows: list[Row], progress: Callable[[int, int], None] | None) -> Compliance:
        """Return the sensitivities of observations to nodal forces, one row each, computed anew, in mm per mN.

        `rows`: nodes (k,) and weights (k, 3) of each observation. On a large body they are computed in parts, so that
        `progress` can be told how many are done.
        """
        parts = []
        for first in range(0, max(1, len(rows)), self._at_once):
            if progress is not None and first > 0:
                progress(first, len(rows))
            some = rows[first : first + self._at_once]
            parts.append(self.linearised.compliance([Observation(*row) for row in some]))
        return together(parts)

    def _remember(self, rows: dict[bytes, Row], solved: Compliance) -> None:
        with self._lock:
            if len(self._known) + len(rows) <= EFFORT.remembered:
                self._known |= dict(zip(rows, apart(solved), strict=True))


def _key(cause: Uncertain) -> Hashable:
    return (cause.name, np.asarray(cause.rates).tobytes()) if isinstance(cause, ModulusField) else cause


#: The last tangent at rest, with its key.
_rest: tuple[tuple[object, ...], Tangent] | None = None
_lock = threading.Lock()


def tangent_at(columns: Columns, material: Material, state: BodyState, threads: int) -> tuple[Tangent, int]:
    """Return the linearised equilibrium at a body, and the number of factorisations that were made for it, 0 or 1.

    `columns`: causes, with the supports of the body; `material`: material of the body; `state`: an equilibrium;
    `threads`: threads to use, 0 takes all cores. The tangent at rest is cached, unless it is very large: the next call
    on the same mesh and material reuses it, with the sensitivities of markers at the same positions.
    """
    global _rest
    key = _rest_key(columns, material, state, threads)
    if key is not None:
        with _lock:
            if _rest is not None and _rest[0] == key:
                return _rest[1].anew(), 0
    linearised = Linearised(
        columns.body.simulator,
        columns.load(state.coefficients),
        material,
        state.displacement,
        springs=columns.springs,
        precision="single",
        threads=threads,
    )
    made = Tangent(linearised, threads, columns.stiffness_causes(material), state.moved[: columns.body.mesh.n_nodes])
    if key is not None and columns.body.simulator.body.factor_size[0] <= EFFORT.kept_entries:
        with _lock:
            _rest = (key, made)
            made = made.anew()
    return made, 1


def forget_rest() -> None:
    """Empty the cache of the tangent at rest."""
    global _rest
    with _lock:
        _rest = None


def _rest_key(columns: Columns, material: Material, state: BodyState, threads: int) -> tuple[object, ...] | None:
    """Return the key under which the tangent of a body at rest is cached; None if the body is not at rest."""
    loaded = any(part is not None for part in columns.believed.values())
    if loaded or state.displacement.any() or state.coefficients.any():
        return None
    springs = None if columns.springs is None else columns.springs.tobytes()
    graded = any(family.name == "stiffness" for family in columns.families)
    # The body itself, not its address: the address of a deleted body may be reused by another.
    return columns.body, material.digest(), springs, threads, graded
