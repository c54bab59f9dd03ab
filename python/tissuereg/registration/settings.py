"""Settings of a registration: every number and word that may change an answer, beside what is believed of the body."""

from dataclasses import asdict, dataclass, field
from typing import Any

from tissuereg import _core
from tissuereg._base.arguments import MOST_COUNTED, check_choice, check_running, flag, of_kind, real, whole
from tissuereg.errors import ArgumentError
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.contacts.state import TRACKERS

#: How the latents of a trained model are found.
UPDATES = ("esmda", "gauss-newton")

#: When a registrar with a model examines how markers are read.
READINGS = ("doubtful", "always")


@dataclass(frozen=True)
class SmootherSettings:
    """How the latents of a trained model are found.

    Parameters
    ----------
    update : {"esmda", "gauss-newton"}
        By an ensemble, or as the most probable ones with the Gaussian about them, which needs fewer decodes.
    n_members, n_steps : int
        Ensemble size N_e and number of assimilations N_a. With ``update="gauss-newton"`` so many draws from the
        Gaussian stand for the posterior, and there are no steps.
    decrease : float
        Ratio of successive inflation coefficients.
    decode_all : bool
        Decode the ensemble before every update. By default a calibrated model, whose answer is found about the
        ensemble's mean, decodes before the first and the last; between them predictions follow their regression.

    Raises
    ------
    ArgumentError
        If a value is not a number or out of its range.
    """

    update: str = "esmda"
    n_members: int = 60
    n_steps: int = 5
    decrease: float = 2.0
    decode_all: bool = False

    def __post_init__(self) -> None:
        check_choice("update", self.update, UPDATES, ArgumentError)
        whole("n_members", self.n_members, least=2)
        whole("n_steps", self.n_steps, least=1)
        real("decrease", self.decrease, above=0.0)
        flag("decode_all", self.decode_all)

    def alphas(self) -> tuple[float, ...]:
        """Return the inflation coefficients of all steps."""
        return tuple(map(float, _core.schedule_geometric(self.n_steps, self.decrease)))


@dataclass(frozen=True)
class RegisterSettings:
    """Settings of a registration; those of the other method must be left as they are.

    Parameters
    ----------
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    tracker : {"fixed", "drifts"}
        Without a model: whether the tracker stayed fixed relative to the body's supports, or may have drifted by a
        small rigid motion. The answer is in the tracker's frame at the measurement.
    contacts : ContactSettings
        Without a model: prior and sampling of unknown contacts.
    ensemble : int
        Without a model: the number of posterior loads to solve for the covariance of every node, instead of linear
        draws; for large motions, where the posterior is not Gaussian.
    smoother : SmootherSettings
        With a model: how its latents are found.
    polish : bool
        With a model: use its answer as the simulation of a registration by contacts, so that the body is in equilibrium
        and meets the markers. What belongs to a registration without a model then means something as well.
    readings : {"doubtful", "always"}
        With a model: when a registrar examines markers for other units, axes, motions and orders
        (`tissuereg.registration.readings`), which takes as long as several registrations. "doubtful": until a first
        moment is free of suspicion, and where the answer cannot be trusted for another reason. Without a model always;
        `Registrar.register` with `after` then as "doubtful".

    Raises
    ------
    ArgumentError
        If a value has the wrong type or is out of its range.

    Examples
    --------
    >>> RegisterSettings(tracker="drifts").smoother.n_members
    60
    """

    threads: int = 0
    tracker: str = "fixed"
    contacts: ContactSettings = field(default_factory=ContactSettings)
    ensemble: int = 0
    smoother: SmootherSettings = field(default_factory=SmootherSettings)
    polish: bool = False
    readings: str = "doubtful"

    def __post_init__(self) -> None:
        check_running(threads=self.threads)
        check_choice("tracker", self.tracker, TRACKERS, ArgumentError)
        of_kind("contacts", self.contacts, ContactSettings)
        whole("ensemble", self.ensemble, most=MOST_COUNTED)
        of_kind("smoother", self.smoother, SmootherSettings)
        flag("polish", self.polish)
        check_choice("readings", self.readings, READINGS, ArgumentError)

    def changed(self, *names: str) -> dict[str, Any]:
        """Return those of some settings that differ from their defaults, by name."""
        usual = RegisterSettings()
        return {name: getattr(self, name) for name in names if getattr(self, name) != getattr(usual, name)}

    def to_json(self) -> dict[str, Any]:
        """Return all settings but the threads, which change no answer, as plain numbers, lists and strings."""
        return {name: _plain(value) for name, value in asdict(self).items() if name != "threads"}


def _plain(value: Any) -> Any:
    """Return a setting as JSON has it."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    return list(value) if isinstance(value, tuple) else value
