"""The tangent at a body, with a cache of sensitivities of observations; the tangent at rest is kept between calls."""

import sys
import threading
from collections.abc import Callable, Sequence
from copy import copy
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.machine import n_cores
from tissuereg.body.material import Material
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.settings import EFFORT
from tissuereg.registration.contacts.state import BodyState
from tissuereg.simulation.sensitivity import Cause, Compliance, Linearised, Observation

Row = tuple[IntArray, FloatArray]


class Tangent:
    """A linearised equilibrium, with a cache of the sensitivities of observations to nodal forces.

    `linearised`: the equilibrium; `threads`: threads to use, 0 takes all cores; `stiffness`: changes of the stiffness;
    `moved` (n_nodes, 3): displacement of the body there, mm, at which observations are linearised too; None for that of
    the moment.
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
        self._stiffness = stiffness
        body = linearised.simulator.body
        self._at_once = (
            EFFORT.block * (threads or n_cores()) if body.n_unknowns >= EFFORT.many_unknowns else sys.maxsize
        )
        self._known: dict[bytes, Compliance] = {}
        self._own: set[bytes] = set()
        self._of_nodes: dict[bytes, tuple[FloatArray, Compliance]] = {}
        self._lock = threading.Lock()
        self._first: Tangent | None = None

    def anew(self) -> "Tangent":
        """Return this tangent for another registration: it knows the same rows, but sums none that only others used.

        A sum has not the bits of a row that is solved, and an answer must not depend on what was registered before.
        """
        made = copy(self)
        made._first, made._own, made._of_nodes = self, set(), {}
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

    def compliance(
        self, rows: Sequence[Row], progress: Callable[[int, int], None] | None = None
    ) -> tuple[Compliance, int]:
        """Return the sensitivities of observations to nodal forces, and the number of right-hand sides solved for them.

        `rows`: nodes (k,) and weights (k, 3) of each observation; `progress`: called with right-hand sides solved and
        to solve, on large bodies. Result: one row per observation, mm per mN. Rows that are known, or sums of known
        ones of the same nodes (a place seen along other axes), are not solved again.
        """
        keys = [nodes.tobytes() + b"|" + weights.tobytes() for nodes, weights in rows]
        with self._lock:
            every = dict(zip(keys, rows, strict=True))
            found = self._combined({key: row for key, row in every.items() if key not in self._own})
            known = {key: self._known[key] for key in every if key in self._known and key not in found}
            self._use(known, every)
        found |= known
        missing = {key: row for key, row in every.items() if key not in found}
        if missing or not rows:
            solved = self._solved(list(missing.values()), progress)
            new = dict(zip(missing, _apart(solved), strict=True))
            self._remember(new, missing)
            if len(missing) == len(rows):
                return solved, len(missing)
            found |= new
        parts = [found[key] for key in keys]
        return _together(parts), len(missing)

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
        return parts[0] if len(parts) == 1 else _together(parts)

    def _remember(self, new: dict[bytes, Compliance], rows: dict[bytes, Row]) -> None:
        with self._lock:
            if len(self._known) + len(new) <= EFFORT.remembered:
                self._known |= new
                self._use(new, rows)

    def _use(self, given: dict[bytes, Compliance], rows: dict[bytes, Row]) -> None:
        """Let rows be summed from now on."""
        new = {key: rows[key] for key in given if key not in self._own}
        if len(self._own) + len(new) > EFFORT.remembered:
            return
        self._own |= new.keys()
        for name, keys in _by_nodes(new).items():
            weights, parts = np.stack([new[key][1] for key in keys]), [given[key] for key in keys]
            if name in self._of_nodes:
                weights = np.concatenate([self._of_nodes[name][0], weights])
                parts = [self._of_nodes[name][1], *parts]
            self._of_nodes[name] = weights, _together(parts)

    def _combined(self, rows: dict[bytes, Row]) -> dict[bytes, Compliance]:
        """Return the sensitivities of those of some observations that are sums of known ones of their nodes."""
        found: dict[bytes, Compliance] = {}
        for name, keys in _by_nodes(rows).items():
            if name not in self._of_nodes:
                continue
            known, sensitivities = self._of_nodes[name]
            every = known.reshape(len(known), -1)
            wanted = np.stack([rows[key][1].ravel() for key in keys])
            shares = np.linalg.lstsq(every.T, wanted.T)[0].T
            off = np.abs(shares @ every - wanted).max(axis=1)
            # Shares are small unless the known rows are nearly alike: then their errors would be multiplied.
            sums = (off <= 1e-12 * np.abs(wanted).max(axis=1)) & (np.abs(shares).max(axis=1) <= 2.0)
            exact = np.flatnonzero(sums)
            if len(exact):
                parts = (sensitivities.forces, sensitivities.body_force, sensitivities.prescribed)
                made = _apart(Compliance(*(np.tensordot(shares[exact], part, 1) for part in parts)))
                found |= {keys[i]: one for i, one in zip(exact, made, strict=True)}
        return found


def _by_nodes(rows: dict[bytes, Row]) -> dict[bytes, list[bytes]]:
    """Return the keys of observations by their nodes."""
    found: dict[bytes, list[bytes]] = {}
    for key, (nodes, _) in rows.items():
        found.setdefault(nodes.tobytes(), []).append(key)
    return found


def _apart(whole: Compliance) -> list[Compliance]:
    """Return the sensitivities of many observations to nodal forces as a list with one entry for each observation."""
    return [
        Compliance(whole.forces[i : i + 1], whole.body_force[i : i + 1], whole.prescribed[i : i + 1])
        for i in range(len(whole.forces))
    ]


def _together(parts: list[Compliance]) -> Compliance:
    return Compliance(
        np.concatenate([part.forces for part in parts]),
        np.concatenate([part.body_force for part in parts]),
        np.concatenate([part.prescribed for part in parts]),
    )


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
    # The body itself, not its address: the address of a deleted body may be reused by another.
    return columns.body, material.digest(), springs, threads
