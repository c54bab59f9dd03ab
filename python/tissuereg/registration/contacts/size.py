"""Estimate of the memory and time of a registration by contacts, reported and checked before anything is factored."""

from tissuereg._base.clock import Clock
from tissuereg.registration.contacts.body import ContactBody
from tissuereg.registration.contacts.measured import ObservedData
from tissuereg.registration.contacts.settings import EFFORT, MATCHING
from tissuereg.registration.inputs import RegisterInput
from tissuereg.simulation.size import BodySize, Estimate, Work


def announce(body: ContactBody, observed: ObservedData, given: RegisterInput, clock: Clock) -> Estimate:
    """Report a body's size and the estimated memory and time, and refuse a body that would not fit into memory.

    `body`: prepared mesh; `observed`: data; `given`: input, with targets, settings and threads; `clock`: its listener
    gets messages ``"size"`` and ``"work"``, and a ``"warning"`` if the registration takes long. Result: the reported
    estimate of time in s and memory in bytes. Raises `LargeBodyError` if it would not fit into memory.
    """
    n_draws = given.settings.contacts.n_draws
    work = expected_work(observed.n_obs, 3 * len(given.targets.names), n_draws, matched=observed.rematches)
    estimate = Estimate.of(BodySize.of(body.simulator), work, given.threads)
    clock.tell("size", estimate.sentence())
    clock.tell("work", estimate.work_sentence())
    estimate.check()
    if estimate.is_long:
        clock.tell("warning", f"this takes {estimate.duration()}; a coarser mesh is faster (docs/large-bodies.md)")
    return estimate


def expected_work(n_obs: int, n_targets: int, n_draws: int, *, matched: bool) -> Work:
    """Return the numbers of factorisations, right-hand sides and stored arrays to expect of a registration.

    `n_obs`, `n_targets`: number of observations, and of coordinates of targets; `n_draws`: number of draws for the
    spread of the nodes; `matched`: whether points of a surface are matched anew in every round of the fit. Factors are
    taken to be in single precision, 4 bytes per entry.
    """
    passes = EFFORT.passes_of_points if matched else EFFORT.passes
    again = min(n_obs, MATCHING.most_kept) if matched else n_obs
    right_hand_sides = n_obs + (passes - 1) * again + n_targets + n_draws
    fields = n_obs + again + n_targets + EFFORT.fields
    return Work(
        passes,
        EFFORT.factors_of_points if matched else EFFORT.factors,
        4,
        right_hand_sides,
        fields,
        EFFORT.tet_fields,
        EFFORT.later_bytes,
        EFFORT.tet_flops,
    )


__all__ = ["announce", "expected_work"]
