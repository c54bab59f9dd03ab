"""The linearisation at one body: tangent, responses of the observations to the causes, and the sampling problem."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.clock import Clock
from tissuereg.body.material import Material
from tissuereg.registration.contacts.columns import Columns, sampler
from tissuereg.registration.contacts.measured import Observations, ObservedData
from tissuereg.registration.contacts.observations import Basis, LinearObservations, moving_variances, plain, projected
from tissuereg.registration.contacts.sensed import Row
from tissuereg.registration.contacts.settings import MATCHING, ContactSettings
from tissuereg.registration.contacts.state import BodyState
from tissuereg.registration.contacts.tangent import Tangent, tangent_at


@dataclass(frozen=True, eq=False)
class AtBody:
    """The equilibrium, observations and sampling problem linearised at one deformed body.

    `tangent`: the linearised equilibrium; `observations`: observations with their responses to a unit coefficient of
    every cause; `sampler`: compiled sampler with these responses, the prior and the data.
    """

    tangent: Tangent
    observations: LinearObservations
    sampler: Any


@dataclass(eq=False)
class Linearisation:
    """Object that linearises a body and its observations; it counts its work and keeps the last projection it made.

    Many observations are projected onto few combinations of them. `columns`: possible causes of motion; `material`:
    material of the body; `settings`: prior; `threads`: threads to use, 0 takes all cores; `clock`: records the times of
    the stages; `counters`: counts factorisations and right-hand sides; `kept`: a linearised equilibrium near the first
    body, used once in place of the one there; None without one.
    """

    columns: Columns
    material: Material
    settings: ContactSettings
    threads: int
    clock: Clock
    counters: Counter[str]
    kept: Tangent | None = None
    _basis: tuple[ObservedData, Basis] | None = field(default=None, repr=False)

    def at(self, state: BodyState, observed: ObservedData) -> AtBody:
        """Return equilibrium, `observed` data and sampling problem linearised at a body `state` in equilibrium."""
        tangent = self.tangent(state)
        with self.clock.stage("match"):
            reading = observed.read(state, tangent.moved)
        observations = self.observations(tangent, reading, state.coefficients, observed)
        with self.clock.stage("prepare"):
            data = {
                "innovation": observations.innovation,
                "noise": np.diag(observations.variances),
                "groups": observations.groups,
            }
            return AtBody(tangent, observations, sampler(self.columns, self.settings, observations.responses, data))

    def tangent(self, state: BodyState) -> Tangent:
        """Return the linearised equilibrium at a body; in the first call the one kept from before, if there is one.

        `state`: the body in equilibrium. Raises `ConvergenceError` if it is not an equilibrium, or not a stable one.
        """
        if self.kept is not None:
            found, self.kept = self.kept, None
            return found
        with self.clock.stage("linearise"):
            found, factored = tangent_at(self.columns, self.material, state, self.threads)
        self.counters["factorisations"] += factored
        return found

    def observations(
        self, tangent: Tangent, reading: Observations, coefficients: FloatArray, observed: ObservedData
    ) -> LinearObservations:
        """Return observations linearised at a body; if they are many, a projection that keeps nearly all information.

        `tangent`: linearised equilibrium of the body; `reading`: observations at the body; `coefficients` (n_columns,):
        coefficients of the causes there; `observed`: the data. Result: n_obs observations in mm, or n_kept projected
        ones over their standard deviations, dimensionless.
        """
        rigid = self.columns.rigid_rows(reading.places, reading.directions)
        if not observed.weighed:
            return plain(reading, self._responses(tangent, reading.rows, rigid), coefficients)
        if self._basis is None or self._basis[0] is not observed:
            every = self._responses(tangent, reading.rows, rigid)
            with self.clock.stage("prepare"):
                most = MATCHING.most_kept_coarse if observed.rough else MATCHING.most_kept
                basis = Basis.of(reading, every, moving_variances(self.columns, self.settings), most)
            self._basis = (observed, basis)
            return projected(reading, basis, (basis.vectors / reading.std) @ every, coefficients)
        basis = self._basis[1]
        few = self._responses(tangent, basis.rows(reading), (basis.vectors / reading.std) @ rigid)
        return projected(reading, basis, few, coefficients)

    def _responses(self, tangent: Tangent, rows: list[Row], rigid: FloatArray) -> FloatArray:
        """Return the displacement of observations by a unit coefficient of every cause, (n_rows, n_columns), in mm.

        `tangent`: linearised equilibrium; `rows`: nodes (k,) and weights (k, 3) of each observation; `rigid` (n_rows,
        6): their displacement by unit rigid motions, mm.
        """
        with self.clock.stage("sensitivities"):
            sensed, solved = tangent.sensed(rows, self._solved)
            self.counters["right_hand_sides"] += solved
            return self.columns.responses(sensed, np.empty((0, 3)), rigid, (rows, tangent.stiffness_forces))

    def _solved(self, done: int, in_all: int) -> None:
        self.clock.tell("stage", f"sensitivities {done} of {in_all}")


__all__ = ["AtBody", "Linearisation"]
