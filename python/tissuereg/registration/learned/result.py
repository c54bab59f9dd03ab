"""The result of a registration with a trained model."""

from dataclasses import dataclass
from typing import Any

from tissuereg.registration.result import Registration


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class LearnedRegistration(Registration):
    """A registration with a trained model: a body deformed by the field decoded from the mean of the posterior latents.

    Attributes
    ----------
    dropped_members : list of (int, str)
        Number of each ensemble member that was lost, with the reason.
    """

    dropped_members: list[tuple[int, str]]

    def _found_json(self) -> dict[str, Any]:
        lost = [{"member": index, "reason": reason} for index, reason in self.dropped_members]
        return {**super()._found_json(), "dropped_members": lost}
