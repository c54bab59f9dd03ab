"""What the paper says about a study, tried on the answer: agreement is computed, never stated."""

from dataclasses import dataclass
from typing import Any

from tissuereg._base.arrays import FloatArray
from tissuereg_paper.studies.measures import Clusters

#: Means that differ by less than this share of the larger one are alike ("not substantial", "not tangible").
ALIKE = 0.10


@dataclass(frozen=True)
class Claim:
    """A sentence of the paper, whether it holds here, and the figures by which."""

    text: str
    holds: bool
    found: str

    def to_json(self) -> dict[str, Any]:
        """Return it as a JSON entry."""
        return {"claim": self.text, "holds": self.holds, "found": self.found}


@dataclass(frozen=True, eq=False)
class Compared:
    """Compares mean end errors of settings on the same pairs.

    Parameters
    ----------
    clusters : Clusters
        Of the pairs.
    """

    clusters: Clusters

    def worse(self, text: str, one: FloatArray, other: FloatArray) -> Claim:
        """Claim that `one` has larger errors (n_pairs,) than `other`, and not only by chance or by a trifle.

        The interval of the mean difference is above zero, and the means are not alike.
        """
        low, high = self.clusters.interval(one - other)
        found = f"{one.mean():.3f} against {other.mean():.3f} mm, difference {low:.3f} to {high:.3f}"
        tangible = float(one.mean()) * (1.0 - ALIKE) >= float(other.mean())
        return Claim(text, low > 0.0 and tangible, found)

    def alike(self, text: str, one: FloatArray, other: FloatArray) -> Claim:
        """Claim that two means differ by less than a tenth of the larger one."""
        first, second = float(one.mean()), float(other.mean())
        holds = abs(first - second) < ALIKE * max(first, second)
        return Claim(text, holds, f"{first:.3f} against {second:.3f} mm")

    def no_better(self, text: str, one: FloatArray, other: FloatArray) -> Claim:
        """Claim that `one` is not below `other` by a tenth of it or more."""
        first, second = float(one.mean()), float(other.mean())
        return Claim(text, first > (1.0 - ALIKE) * second, f"{first:.3f} against {second:.3f} mm")


@dataclass(frozen=True)
class Agreement:
    """Whether a study agrees with the paper: all claims hold in one of the readings of C_d.

    Attributes
    ----------
    readings : dict of str to tuple of Claim
        Claims by reading; one reading where C_d plays no part.
    """

    readings: dict[str, tuple[Claim, ...]]

    @property
    def agrees(self) -> bool:
        """Whether all claims hold in a reading."""
        return any(all(claim.holds for claim in claims) for claims in self.readings.values())

    @property
    def why(self) -> str:
        """One sentence a reading."""
        return " ".join(_sentence(reading, claims) for reading, claims in self.readings.items())

    def to_json(self) -> dict[str, Any]:
        """Return it as the entry of a study in ``agree``."""
        claims = {reading: [claim.to_json() for claim in claims] for reading, claims in self.readings.items()}
        return {"agree": "yes" if self.agrees else "no", "why": self.why, "claims": claims}


def _sentence(reading: str, claims: tuple[Claim, ...]) -> str:
    wrong = [f"{claim.text} ({claim.found})" for claim in claims if not claim.holds]
    head = f"{reading}: {len(claims) - len(wrong)} of {len(claims)} statements hold"
    return f"{head}; not: {'; '.join(wrong)}." if wrong else f"{head}."
