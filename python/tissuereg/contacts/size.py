"""What a registration by contacts will take on a body, said and checked before anything is factored."""

from tissuereg._clock import Clock
from tissuereg.contacts.body import ContactBody
from tissuereg.contacts.posed import MOST_KEPT
from tissuereg.contacts.seen import Seen
from tissuereg.inputs import RegisterInput
from tissuereg.simulate.size import BodySize, Estimate, Work

#: Passes to expect with markers, and with points that are matched anew.
_PASSES, _PASSES_OF_POINTS = 2, 6

#: Factors that are held at the same time: the closest pass and the next one; with points that of the stage before too.
_FACTORS, _FACTORS_OF_POINTS = 2, 3

#: Whole fields beside the responses: errors of the model, and draws with what they are made of.
_FIELDS = 260

#: Numbers a tet: fields of uncertain stiffness with a copy of each, and what the solver keeps.
_TET_FIELDS = 160

#: What is imported and drawn later, in bytes.
_LATER = 200_000_000

#: Reading, attaching, regions, files and pictures, in operations a tet.
_TET_FLOPS = 7e6


def announce(body: ContactBody, seen: Seen, given: RegisterInput, clock: Clock) -> Estimate:
    """Say how large a body is and what it will take, and refuse it where that is too much.

    Parameters
    ----------
    body : ContactBody
        Analysed.
    seen : Seen
        Data.
    given : RegisterInput
        Input, with targets, settings and threads.
    clock : Clock
        Its listener gets ``"size"``, and ``"warning"`` where it takes long.

    Returns
    -------
    Estimate
        What was said.

    Raises
    ------
    LargeBodyError
        If it would not fit into memory.
    """
    n_draws = given.settings.contacts.n_draws
    work = expected_work(seen.n_obs, 3 * len(given.targets.names), n_draws, matched=seen.rematches)
    estimate = Estimate.of(BodySize.of(body.simulator), work, given.threads)
    clock.tell("size", estimate.sentence())
    estimate.check()
    if estimate.is_long:
        clock.tell("warning", f"this takes {estimate.duration()}; a coarser mesh is faster (docs/large-bodies.md)")
    return estimate


def expected_work(n_obs: int, n_targets: int, n_draws: int, *, matched: bool) -> Work:
    """Return what to expect of a registration.

    Parameters
    ----------
    n_obs, n_targets : int
        Observations, and components of targets.
    n_draws : int
        Draws for the spread of the nodes.
    matched : bool
        Whether points of a surface are matched anew in every pass.

    Returns
    -------
    Work
        Factors of single precision.
    """
    passes = _PASSES_OF_POINTS if matched else _PASSES
    again = min(n_obs, MOST_KEPT) if matched else n_obs
    right_hand_sides = n_obs + (passes - 1) * again + n_targets + n_draws
    fields = n_obs + again + n_targets + _FIELDS
    return Work(
        passes,
        _FACTORS_OF_POINTS if matched else _FACTORS,
        4,
        right_hand_sides,
        fields,
        _TET_FIELDS,
        _LATER,
        _TET_FLOPS,
    )


__all__ = ["announce", "expected_work"]
