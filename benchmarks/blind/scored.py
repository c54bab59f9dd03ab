"""Compares predictions with the sealed answers. No other module that is scored or tested opens the answers.

An answer is opened only if the prediction for its case has been written, and is checked against its seal. Right group:
the id or group of every finding contains an id that the answer accepts. Wrong group: a finding contains none of them.
Silently wrong: nor does it say that its family alone holds, which is that of a hidden cause.
"""

import csv
import gzip
import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from blind.materialise import DATA
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.causes.laws import STIFFENING

#: Least reduction of the sum of squares on held-out data for a gain to be defined.
LEAST_TO_GAIN = 9.0

#: Nats that the oracle fit must gain for an effect to be visible: the diagnoser's smallest threshold.
SEEN = 6.0

NAMED = ("named", "group")

#: Causes with a second form that the fit did not have when the bench was sealed, and has now.
OWNED_SINCE = ("asymmetry", "mooney", "sliding", "softening")


@dataclass
class Scored:
    """A case with its true answer and its prediction."""

    case: str
    truth: dict
    prediction: dict
    ids: list = field(default_factory=list)
    groups: list = field(default_factory=list)
    families: list = field(default_factory=list)

    def __post_init__(self) -> None:
        causes = self.prediction.get("causes", []) if self.prediction["verdict"] in NAMED else []
        self.ids = [c["id"] for c in causes]
        self.groups = [set(c.get("group", [])) | {c["id"]} for c in causes]
        stated = [c.get("family") or {"alone": False} for c in causes]
        self.families = [family["id"] if family["alone"] else None for family in stated]

    @property
    def wrong(self) -> bool:
        """Whether the group of some finding contains no id that the answer accepts."""
        return any(not group & set(self.truth["group_ok"]) for group in self.groups)

    @property
    def silent(self) -> bool:
        """Whether some finding is wrong and does not say that only its family holds, with a hidden cause in it."""
        hidden = {CAUSES[name].family for name in self.truth["cause"] if name in CAUSES}
        return any(
            not group & set(self.truth["group_ok"]) and family not in hidden
            for group, family in zip(self.groups, self.families, strict=True)
        )

    @property
    def right(self) -> bool:
        """Whether something is named, and every finding is accepted by the answer."""
        return bool(self.groups) and not self.wrong

    @property
    def exact(self) -> bool:
        """Whether the first-named ids are exactly the hidden ones, and none is stated as a family alone."""
        return sorted(self.ids) == sorted(self.truth["cause"]) and not any(self.families)

    @property
    def foreign(self) -> bool:
        """Whether the single hidden effect has a form that the fit cannot represent."""
        cause = self.truth["cause"][0]
        if cause == "stiffening":
            return not STIFFENING.get(self.truth["parameters"][cause]["law"])
        return not self.truth["own_form"] and cause not in OWNED_SINCE


def wilson(hits: int, n: int, z: float = 1.96) -> tuple[float, float]:
    """Return the Wilson interval of a share.

    Source: E. B. Wilson, Journal of the American Statistical Association 22, 1927.
    """
    if n == 0:
        return 0.0, 1.0
    p = hits / n
    middle, spread = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = (middle - spread) / (1 + z * z / n), (middle + spread) / (1 + z * z / n)
    return max(0.0, float(low)), min(1.0, float(high))


def open_answers(names: set[str], data: Path | None = None) -> dict[str, dict]:
    """Return the answers of cases, each checked against its seal; `data`: stored data of another bench.

    Raises ValueError where an answer is not the sealed one.
    """
    data = data or DATA
    with (data / "seals.csv").open(encoding="utf-8") as file:
        seals = {row["case"]: row["sha256"] for row in csv.DictReader(file)}
    stored = json.loads(gzip.decompress((data / "answers.json.gz").read_bytes()))
    found = {}
    for name in names & set(stored["answers"]):
        text = json.dumps(stored["answers"][name], sort_keys=True)
        if hashlib.sha256(f"{stored['salt']}/{name}/{text}".encode()).hexdigest() != seals[name]:
            message = f"the answer of {name} must be the sealed one; its hash is another"
            raise ValueError(message)
        found[name] = stored["answers"][name]
    return found


def read_predictions(folder: Path, files: str = "b*.json") -> dict[str, dict]:
    """Return the predictions in a folder, by case."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob(files))}


def scored(predictions: dict[str, dict], data: Path | None = None) -> list[Scored]:
    """Return the cases that have a prediction, with their answers; `data`: stored data of another bench."""
    answers = open_answers(set(predictions), data)
    return [Scored(name, answers[name], predictions[name]) for name in sorted(answers)]


def of_kind(cases: list[Scored], *kinds: str) -> list[Scored]:
    """Return the cases of some kinds."""
    return [c for c in cases if c.truth["kind"] in kinds]


def singles(cases: list[Scored]) -> list[Scored]:
    """Return the cases with one effect of the catalogue."""
    return of_kind(cases, "single", "fine")


def clear_singles(cases: list[Scored]) -> list[Scored]:
    """Return the single effects that should be named: large enough, and separable."""
    return [c for c in singles(cases) if c.truth["detectability"] >= 7.8 and c.truth["separable"]]


def seen(cases: list[Scored], oracle: dict[str, dict]) -> list[Scored]:
    """Return the cases whose effect is visible: the oracle fit gains at least `SEEN` nats, given all nuisances."""
    gained = {name: sum(cause["log_bayes_factor"] for cause in fit["causes"]) for name, fit in oracle.items()}
    return [case for case in cases if gained.get(case.case, 0.0) >= SEEN]


def held_out(case: Scored) -> dict:
    """Return the held-out figures of the last finding, which are those of all findings together."""
    causes = case.prediction.get("causes", [])
    return causes[-1].get("held_out", {}) if causes and case.ids else {}


def held_out_chi(prediction: dict, blocks: list[str]) -> tuple[float, float, float] | None:
    """Return the number of values in blocks, and the errors of base and final model there; None if not known."""
    table = prediction.get("by_block", {})
    if not blocks or not set(blocks) <= set(table):
        return None
    n, base, final = np.array([table[block] for block in blocks]).T
    return float(n.sum()), float(np.sqrt(n @ base**2 / n.sum())), float(np.sqrt(n @ final**2 / n.sum()))


def gains(cases: list[Scored], oracle: dict[str, dict]) -> tuple[list[float], int]:
    """Return (base - reached) / (base - oracle) in held-out chi, and how many cases had too little to gain.

    Blocks, base and oracle are those of the oracle fit. Without one, the case's own blocks and base are used, and a chi
    of 1 for the oracle. Cases in which the two saw different data are left out.
    """
    found, small = [], 0
    for case in cases:
        reference = oracle.get(case.case, case.prediction)
        causes = reference.get("causes", [])
        blocks = causes[-1].get("held_out", {}).get("cases", []) if causes else []
        best_fit, mine = held_out_chi(reference, blocks), held_out_chi(case.prediction, blocks)
        if best_fit is None or mine is None or best_fit[0] != mine[0]:
            continue
        n, base, best = best_fit if case.case in oracle else (best_fit[0], best_fit[1], 1.0)
        # Where too little of the effect is held out, the ratio is meaningless.
        if n * (base**2 - best**2) < LEAST_TO_GAIN:
            small += 1
            continue
        found.append((base - mine[2]) / (base - best))
    return found, small
