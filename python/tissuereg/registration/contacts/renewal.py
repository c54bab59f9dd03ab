"""A tangent that is made beside the moments of measurement, in a thread, and used from a later one on."""

import threading
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissuereg._base.machine import n_cores
from tissuereg.body.material import Material
from tissuereg.errors import TissueRegError
from tissuereg.registration.contacts.fit import ContactFit
from tissuereg.registration.contacts.measured import ObservedData
from tissuereg.registration.contacts.sensed import Row
from tissuereg.registration.contacts.settings import DISCRETISATION
from tissuereg.registration.contacts.tangent import Tangent, tangent_at


class Renewal:
    """The tangent at the end of one moment, with the sensitivities that the moments after it will ask for.

    It is used from a stated moment on, not as soon as it is there: answers do not depend on the machine's speed. Its
    thread is no daemon: at its exit the interpreter waits for it.

    `fit`: contacts and equilibrium of the moment; `observed`: its data; `targets`: nodes (k,) and weights (k, 3) of the
    targets' displacements; `material`: material of the body; `moment`: number of the first moment that uses it.
    """

    def __init__(
        self, fit: ContactFit, observed: ObservedData, targets: Sequence[Row], material: Material, moment: int
    ) -> None:
        self.moment = moment
        self._found: Tangent | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, args=(fit, observed, list(targets), material))
        self._thread.start()

    def threads_beside(self, threads: int) -> int:
        """Return how many of some threads, 0 for all cores, are left to a moment that is registered beside it."""
        return max(1, (threads or n_cores()) - 1) if self._thread.is_alive() else threads

    def tangent(self) -> Tangent | None:
        """Return the tangent, once it is made; None if there is none, as at a limit point of the load.

        What went wrong otherwise is raised here, at the same moment on every machine.
        """
        self._thread.join()
        if self._error is not None:
            raise self._error
        return self._found

    def _run(self, fit: ContactFit, observed: ObservedData, targets: list[Row], material: Material) -> None:
        try:
            self._found = _made(fit, observed, targets, material)
        except TissueRegError:
            return
        except BaseException as error:  # a thread has nobody to tell it
            self._error = error


def _made(fit: ContactFit, observed: ObservedData, targets: list[Row], material: Material) -> Tangent:
    """Return the tangent at the end of a fit, with all that the moments after it ask for; see `Renewal`."""
    columns, state = fit.columns, fit.state
    # Moments that follow each other meet equilibrium only nearly.
    settled = fit.tangent.linearised.solve_near(
        columns.load(state.coefficients), springs=columns.springs, tolerance=DISCRETISATION.tolerance, threads=1
    )
    state = replace(state, displacement=settled.all_displacement)
    made, _ = tangent_at(columns, material, state, 1)
    rows = [*observed.read(state, made.moved).rows, *targets]
    sensed, _ = made.sensed(rows)
    rigid = np.zeros((len(rows), 6))
    columns.responses(sensed, np.empty((0, 3)), rigid, (rows, made.stiffness_forces))
    if made.stiffness_forces.any():
        made.by_stiffness  # noqa: B018 - computed once, kept
    return made


__all__ = ["Renewal"]
