"""Compares predictions with the sealed answers. No other module of this bench opens them.

An answer is checked against its seal. Right group: the id or group of every finding contains an id that the answer
accepts. Wrong group: a finding contains none of them.
"""

import csv
import gzip
import hashlib
import json

from blind.scored import Scored
from rigs.materialise import DATA, rig_of


def open_answers(names: set[str]) -> dict[str, dict]:
    """Return the answers of cases, each checked against its seal.

    Raises ValueError where an answer is not the sealed one.
    """
    with (DATA / "seals.csv").open(encoding="utf-8") as file:
        seals = {row["case"]: row["sha256"] for row in csv.DictReader(file)}
    stored = json.loads(gzip.decompress((DATA / "answers.json.gz").read_bytes()))
    found = {}
    for name in names & set(stored["answers"]):
        text = json.dumps(stored["answers"][name], sort_keys=True)
        if hashlib.sha256(f"{stored['salt']}/{name}/{text}".encode()).hexdigest() != seals[name]:
            message = f"the answer of {name} must be the sealed one; its hash is another"
            raise ValueError(message)
        found[name] = stored["answers"][name]
    return found


def scored(predictions: dict[str, dict]) -> list[Scored]:
    """Return the cases that have a prediction, with their answers."""
    answers = open_answers(set(predictions))
    return [Scored(name, answers[name], predictions[name]) for name in sorted(answers)]


def by_rig(cases: list[Scored], flags: list[bool]) -> tuple[tuple[int, int], ...]:
    """Return (hits, cases) of each rig."""
    counts: dict[str, list[int]] = {}
    for case, flag in zip(cases, flags, strict=True):
        cell = counts.setdefault(rig_of(case.case), [0, 0])
        cell[0] += bool(flag)
        cell[1] += 1
    return tuple((hits, n) for hits, n in counts.values())
