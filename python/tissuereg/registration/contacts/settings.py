"""Prior of contacts, and how the posterior is sampled."""

from dataclasses import dataclass, fields
from typing import Any

from tissuereg._base.arguments import each, real, whole
from tissuereg.errors import ArgumentError


@dataclass(frozen=True)
class ContactSettings:
    """Prior of contacts, noise of the model, and chains.

    Parameters
    ----------
    n_slots : int
        Largest number of contacts.
    odds : float
        Prior odds that a slot is filled.
    sizes : tuple of float
        Candidate sizes of a contact: motion of its patch under this contact alone, over the body's extent.
    largest_share : float
        Sizes above this share of the patch's radius become unlikely.
    background : tuple of float
        Median of the size of a background on all patches, over the body's extent, and standard deviation of its
        logarithm.
    weight : tuple of float
        The same for a body force, measured by the motion it causes.
    believed : tuple of float
        The same for the error of a believed load, over the load.
    supports : tuple of float
        The same for tractions of doubtful supports.
    support_stiffness : float
        Default stiffness of doubtful supports, in Young's modulus over the extent of the body.
    stiffness_tried : tuple of float
        Candidate stiffnesses, among which the evidence of the markers decides.
    support_log_std : float
        Standard deviation of the logarithm of their stiffness from place to place.
    frame : tuple of float
        The same as `weight` for a rigid motion of a body that nothing surely holds.
    drift : tuple of float
        The same for a drift of the tracker relative to a body that is held (``tracker="drifts"``).
    wrong_odds : float
        Prior odds that a marker is wrong.
    wrong_share : float
        Additional standard deviation of a wrong marker, over the extent of the body.
    model_error : float
        Standard deviation of the model's error at a marker, over the marker's motion.
    local_error : float
        The same, over the variation of the motion across the element under the marker; used in tests of residuals only.
    young_log_std, poisson_std : float
        Uncertainty of the stiffness (smooth fields of its logarithm) and of Poisson's ratio.
    graded_log_std : float
        Standard deviation of the logarithm of the stiffness at the ends of the body against its middle
        (``stiffness="graded"``).
    unseen_chance, unseen_share : float
        Probability of one more contact that no marker detects, and its size over its radius.
    n_chains : int
        Independent chains.
    n_chains_first : int
        The same in the first pass, which need only come close.
    powers : tuple of float
        Power of the likelihood in each sweep of the first pass.
    powers_again : tuple of float
        The same in later passes, which start from the previous samples.
    n_kept : int
        Number of final sweeps of each chain whose samples are kept.
    sharpness, n_local, n_level : float, int, int
        See ``tissuereg_contacts::ChainSettings``.
    max_passes : int
        Largest number of linearisations.
    fit_limit : float
        Passes end when the markers' root mean square residual is below this many standard deviations,
    promise_margin : float
        and exceeds the linear model's prediction by less than this.
    n_draws : int
        Number of draws for the spread of nodes.
    """

    n_slots: int = 3
    odds: float = 0.8
    sizes: tuple[float, ...] = (0.0008, 0.0025, 0.008, 0.025, 0.08, 0.25)
    largest_share: float = 0.5
    background: tuple[float, float] = (0.00025, 1.0)
    weight: tuple[float, float] = (0.0008, 2.0)
    believed: tuple[float, float] = (0.5, 0.7)
    supports: tuple[float, float] = (0.0008, 1.5)
    support_stiffness: float = 100.0
    stiffness_tried: tuple[float, ...] = (0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
    support_log_std: float = 1.0
    frame: tuple[float, float] = (0.008, 1.5)
    drift: tuple[float, float] = (0.0025, 1.0)
    wrong_odds: float = 0.02
    wrong_share: float = 0.05
    model_error: float = 0.02
    local_error: float = 0.2
    young_log_std: float = 0.2
    poisson_std: float = 0.02
    graded_log_std: float = 1.0
    unseen_chance: float = 0.03
    unseen_share: float = 0.25
    n_chains: int = 16
    n_chains_first: int = 8
    powers: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    powers_again: tuple[float, ...] = (0.5, 1.0, 1.0, 1.0, 1.0, 1.0)
    n_kept: int = 4
    sharpness: float = 0.5
    n_local: int = 4
    n_level: int = 2
    max_passes: int = 8
    fit_limit: float = 1.3
    promise_margin: float = 0.4
    n_draws: int = 64

    def __post_init__(self) -> None:
        # A field must have the type of its default: a count, a number, a pair, or a list of numbers.
        for one in fields(self):
            value, usual = getattr(self, one.name), one.default
            if isinstance(usual, int):
                whole(one.name, value)
            elif isinstance(usual, float):
                real(one.name, value, least=0.0)
            else:
                _numbers(one.name, value, n_numbers=2 if "tuple[float, float]" in str(one.type) else None)


def _numbers(name: str, value: Any, n_numbers: int | None) -> None:
    numbers = each(name, value, (int, float))
    if not numbers or len(numbers) != (n_numbers or len(numbers)):
        message = f"`{name}` must be a list of {n_numbers or 'one or more'} numbers, got {len(numbers)}"
        raise ArgumentError(message, where=name)
    for number in numbers:
        real(name, number, least=0.0)
