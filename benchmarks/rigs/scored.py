"""Compares predictions with the sealed answers, ``answers.json.gz``. No other module of this bench opens them.

An answer is checked against its seal. Right group: the id or group of every finding contains an id that the answer
accepts. Wrong group: a finding contains none of them.
"""

from functools import partial

import blind.scored as blind
from rigs.materialise import DATA, rig_of

open_answers = partial(blind.open_answers, data=DATA)
scored = partial(blind.scored, data=DATA)


def by_rig(cases: list[blind.Scored], flags: list[bool]) -> tuple[tuple[int, int], ...]:
    """Return (hits, cases) of each rig."""
    counts: dict[str, list[int]] = {}
    for case, flag in zip(cases, flags, strict=True):
        cell = counts.setdefault(rig_of(case.case), [0, 0])
        cell[0] += bool(flag)
        cell[1] += 1
    return tuple((hits, n) for hits, n in counts.values())
