"""Families of causes: whether the data hold a cause itself, or only the kind of error that it is one of.

A true cause that the catalogue lacks is best imitated by a cause of its family (`Cause.family`). What that leaves of
the data lies along changes that further members of the family make, or along parts in which the cause is inconstant
(`constancy`). The evidence for either is compared with that of data in which nothing but noise and nuisances is left.
Where it is too large the family alone is stated, with its best member.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.constancy import FittedPart, p_value
from tissuereg.diagnosis.evidence import log_mean_exp
from tissuereg.diagnosis.screen import Screen
from tissuereg.diagnosis.settings import ConstancySettings

#: Families by id, in words.
FAMILIES = {
    "law": "elastic laws",
    "region": "regions of other stiffness",
    "memory": "effects of time and load history",
    "rest": "errors of weight and unloaded shape",
    "support": "errors of supports",
    "actuator": "errors of actuators",
    "tracker": "errors of the tracker",
}


@dataclass(frozen=True)
class Membership:
    """Whether the data hold a cause, or its family alone.

    `p`: probability that data which the cause explains speak as much for something else of its family; `level`: p-value
    below which the family alone is stated; `beaten`: whether an effect of the family that is outside the catalogue
    explains the data better (`outside`).
    """

    id: str
    p: float
    level: float
    beaten: bool = False

    @property
    def family(self) -> str:
        """Id of the family."""
        return CAUSES[self.id].family

    @property
    def words(self) -> str:
        """Name of the family."""
        return FAMILIES[self.family]

    @property
    def holds(self) -> bool:
        """Whether the cause itself may be stated."""
        return self.p >= self.level and not self.beaten

    @property
    def reason(self) -> str:
        """Why the family alone is stated, in words."""
        if self.p < self.level:
            return f"what it leaves looks like another one of them (p = {self.p:.1g})"
        return "one of them that the catalogue lacks explains the data as well"

    def to_json(self) -> dict[str, Any]:
        """Return the test as plain data for JSON."""
        said = {} if self.holds else {"reason": self.reason}
        return {"id": self.family, "words": self.words, "p": self.p, "alone": not self.holds, **said}


def memberships(parts: Sequence[FittedPart], screen: Screen, settings: ConstancySettings) -> dict[int, Membership]:
    """Return for causes of a fit, by number, whether the data hold them or their families alone.

    Not in the result are causes without relatives that could change what is left, and without inconstancies; and those
    that begin to act somewhere (`Cause.constant`): what they leave is another effect beside them.
    """
    found = {}
    for part in (one for one in parts if CAUSES[one.id].constant):
        relatives = _of_relatives(part, screen, settings)
        evidence = [] if relatives is None else [relatives]
        if part.inconstancies:
            evidence.append(log_mean_exp(np.array([one for _, one in part.inconstancies]), axis=0))
        if evidence:
            found[part.number] = Membership(part.id, p_value(np.array(evidence)), settings.member_level)
    return found


def _of_relatives(part: FittedPart, screen: Screen, settings: ConstancySettings) -> FloatArray | None:
    """Return the log evidence (1 + n,), nats, of the other members of a cause's family in what its fit leaves."""
    members = []
    for name, blocks in screen.blocks.items():
        if name in (part.id, *part.beside) or CAUSES[name].family != CAUSES[part.id].family:
            continue
        each = []
        for columns in blocks.columns:
            rows = part.errors.reduced(columns.astype(np.float64))
            least = settings.least_change * float(np.linalg.norm(columns, axis=1).max())
            evidence = part.left.evidence(rows, least, settings)
            if evidence is not None:
                each.append(evidence)
        if each:
            members.append(log_mean_exp(np.array(each), axis=0))
    return log_mean_exp(np.array(members), axis=0) if members else None
