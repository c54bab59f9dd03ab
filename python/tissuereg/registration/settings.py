"""Settings of a registration: every number and word that may change a result, beside the assumptions on the body."""

from dataclasses import asdict, dataclass, field
from typing import Any

from tissuereg import _core
from tissuereg._base.arguments import MOST_COUNTED, check_choice, check_running, of_kind, real, whole
from tissuereg._base.choices import READINGS, TRACKERS, Readings, TrackerKind
from tissuereg.errors import ArgumentError
from tissuereg.registration.contacts.settings import ContactSettings


@dataclass(frozen=True)
class SmootherSettings:
    """Settings of the estimation of a trained model's latents from the markers.

    Parameters
    ----------
    n_members, n_steps : int
        Members of each ensemble, N_e, and number of assimilations, N_a.
    decrease : float
        Ratio of successive inflation coefficients, the factors on the noise covariance in each assimilation.

    Raises
    ------
    ArgumentError
        If a value is not a number or out of its range.
    """

    n_members: int = 40
    n_steps: int = 4
    decrease: float = 2.0

    def __post_init__(self) -> None:
        whole("n_members", self.n_members, least=2)
        whole("n_steps", self.n_steps, least=1)
        real("decrease", self.decrease, above=0.0)

    def alphas(self) -> tuple[float, ...]:
        """Return the inflation coefficients of all steps."""
        return tuple(map(float, _core.schedule_geometric(self.n_steps, self.decrease)))


@dataclass(frozen=True)
class RegisterSettings:
    """Settings of a registration; those that belong to the method not used must be left at their defaults.

    Parameters
    ----------
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    tracker : {"fixed", "drifts"}, optional
        Without a model: whether the tracker is known to have stayed fixed relative to the body's supports, or may have
        drifted by a small rigid motion, of an amount that the markers tell. The answer is in the tracker's frame at the
        measurement. By default it may have drifted where the supports are sure.
    contacts : ContactSettings
        Without a model: prior and sampling of unknown contacts.
    ensemble : int
        Without a model: the number of posterior loads whose equilibria are solved for the covariance of every node; 0
        takes linearised draws instead. It serves large motions, where the posterior is not Gaussian.
    smoother : SmootherSettings
        With a model: how its latents are estimated.
    readings : {"doubtful", "always"}
        With a model: when a registrar examines whether the markers may be in other units, axes, motions and orders
        (`tissuereg.registration.readings`), which takes as long as several registrations. "always": at every moment.
        "doubtful": until a first moment is free of suspicion, and where the result cannot be trusted for another
        reason. Without a model they are always examined, except by `Registrar.register` with `after`, which acts as
        with "doubtful".

    Raises
    ------
    ArgumentError
        If a value has the wrong type or is out of its range.

    Examples
    --------
    >>> RegisterSettings(tracker="fixed").smoother.n_members
    40
    """

    threads: int = 0
    tracker: TrackerKind | None = None
    contacts: ContactSettings = field(default_factory=ContactSettings)
    ensemble: int = 0
    smoother: SmootherSettings = field(default_factory=SmootherSettings)
    readings: Readings = "doubtful"

    def __post_init__(self) -> None:
        check_running(threads=self.threads)
        if self.tracker is not None:
            check_choice("tracker", self.tracker, TRACKERS, ArgumentError)
        of_kind("contacts", self.contacts, ContactSettings)
        whole("ensemble", self.ensemble, most=MOST_COUNTED)
        of_kind("smoother", self.smoother, SmootherSettings)
        check_choice("readings", self.readings, READINGS, ArgumentError)

    def changed(self, *names: str) -> dict[str, Any]:
        """Return, by name, the values of those of the settings `names` that differ from their defaults."""
        usual = RegisterSettings()
        return {name: getattr(self, name) for name in names if getattr(self, name) != getattr(usual, name)}

    def to_json(self) -> dict[str, Any]:
        """Return all settings but the threads, which change no answer, as plain numbers, lists and strings."""
        return {name: _plain(value) for name, value in asdict(self).items() if name != "threads"}


def _plain(value: Any) -> Any:
    """Return a setting in the types of JSON: the entries of a dict are converted, and a tuple becomes a list."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    return list(value) if isinstance(value, tuple) else value
