"""What a study is given, and what it returns: the place where further studies join."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tissuereg_paper.studies.cases import Cases
from tissuereg_paper.studies.subject import Subject

#: Called with the number of lots that are done, and of all.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Given:
    """What studies have in common.

    Attributes
    ----------
    subject : Subject
        Body and model.
    cases : Cases
        Pairs of held-out shapes, markers, inner points.
    seed : int
        Of all that a study draws.
    threads : int
        Threads to use; 0 takes all cores.
    progress : callable of (int, int), optional
        Called with the number of lots that are done, and of all.
    """

    subject: Subject
    cases: Cases
    seed: int = 0
    threads: int = 0
    progress: Progress | None = None


#: Returns the entries of a study's JSON: ``rows``, ``agree`` by the study's name, and what else it has.
Study = Callable[[Given], dict[str, Any]]
