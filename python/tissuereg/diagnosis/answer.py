"""The result of a diagnosis: verdict, findings, discrepancy and extended model, as a record and as files."""

import os
import platform
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arguments import place
from tissuereg._base.provenance import Provenance
from tissuereg._version import __version__
from tissuereg.diagnosis.causes import Values, catalogue
from tissuereg.diagnosis.constancy import Constancy, Membership
from tissuereg.diagnosis.noise import UnderstatedNoise
from tissuereg.diagnosis.outside import Outside
from tissuereg.diagnosis.readings import RecordingSuspicion
from tissuereg.diagnosis.report import EXTENDED_FILE
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.experiment.experiment import Experiment
from tissuereg.experiment.material_experiment import MaterialExperiment

if TYPE_CHECKING:
    from tissuereg.diagnosis.fit import FitTarget
    from tissuereg.diagnosis.nuisances import Nuisances
    from tissuereg.diagnosis.search import Search

SCHEMA = "tissuereg.diagnosis/1"


@dataclass(frozen=True, eq=False, kw_only=True)
class Accepted:
    """A cause in the model that was found, and its evidence.

    Attributes
    ----------
    id : str
        Id of the likeliest cause.
    group : tuple of str
        Ids of the causes that the data cannot distinguish, `id` itself first; `most_in_group` at most.
    probability : float
        Posterior probability of the id among all causes tried, no cause, and the generic rival (a smooth change without
        a physical cause).
    group_probability : float
        Posterior probability of all ids of the group together; of a finding it is at least `stated`.
    log_bayes_factor : float
        Log Bayes factor of the model with the cause against the model without it, nats.
    threshold : float
        Log Bayes factor that was required, nats.
    """

    id: str
    group: tuple[str, ...]
    probability: float
    group_probability: float
    log_bayes_factor: float
    threshold: float

    def as_possible(self) -> "PossibleCause":
        """Return the cause as one that is not stated."""
        return PossibleCause(self.id, self.group_probability, self.log_bayes_factor, self.threshold)


@dataclass(frozen=True, eq=False, kw_only=True)
class Finding(Accepted):
    """An accepted cause that is stated: an `Accepted`, with its parameters.

    Attributes
    ----------
    parameters : dict
        Fitted parameters by key of the ``[[effect]]`` table; the ending of a key names the unit.
    deviations : dict
        Standard deviations of those parameters that are numbers, by the same keys.
    held_out : dict
        Errors of the predictions of data that were left out of the fit, with and without the cause: ``rms_..._mm`` of a
        marker's coordinate, ``chi_...`` of markers and forces in noise deviations. Empty where there are none.
    sentence : str
        The finding in words.
    membership : Membership or None
        Whether the data hold the cause, or only the family that it is the best member of; None where there is no other
        member that could be told from it.
    """

    parameters: Values
    deviations: Values
    held_out: Mapping[str, Any]
    sentence: str
    membership: Membership | None = None

    @property
    def is_sure(self) -> bool:
        """Whether one cause is stated: not a group that the data cannot distinguish, nor a family alone."""
        return len(self.group) == 1 and (self.membership is None or self.membership.holds)

    def to_json(self) -> dict[str, Any]:
        """Return the finding as plain data for JSON; a number with a standard deviation becomes a pair of both."""
        of_cause = {key.name: getattr(self, key.name) for key in fields(Accepted)}
        return {
            **of_cause,
            "group": list(self.group),
            "parameters": _pairs(self.parameters, self.deviations),
            "held_out": dict(self.held_out),
            "sentence": self.sentence,
            "family": None if self.membership is None else self.membership.to_json(),
        }


@dataclass(frozen=True)
class PossibleCause:
    """A cause that explains much and is not stated, as its evidence or its probability does not suffice.

    `id`: id of the cause; `probability`: of it, or of its group; `log_bayes_factor`, `threshold`: evidence found and
    required, nats.
    """

    id: str
    probability: float
    log_bayes_factor: float
    threshold: float


@dataclass(frozen=True, eq=False)
class DiagnosisDetails:
    """What the report draws of a diagnosis.

    `search`: all rounds of the search for causes; `target`: data, believed model and noise of its first fit;
    `nuisances`: nuisance parameters of every model; `thresholds`: log Bayes factor required of every cause, nats.
    """

    search: "Search"
    target: "FitTarget"
    nuisances: "Nuisances"
    thresholds: Mapping[str, float]


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis(ABC):
    """The result of a diagnosis: `BodyDiagnosis`, or that of a material test.

    Attributes
    ----------
    verdict : str
        ``named`` (causes were found), ``group`` (found up to a group of causes that the data cannot distinguish, or up
        to a family), ``consistent`` (the data agree with the model), ``understated-noise`` (they do, but for noise that
        is larger than stated) or ``unexplained`` (they do not, and no cause accounts for it).
    findings : tuple of Finding
        Accepted causes.
    candidates : tuple of dict
        One entry for every cause that was tried: its ``id``, ``probability``, ``log_bayes_factor`` in nats, and
        ``detectability``, the size of its effect in noise deviations.
    possible : tuple of dict
        Causes that came close and are not stated: ``id``, ``probability`` (of it, or of its group),
        ``log_bayes_factor`` and the ``threshold`` that was required, nats.
    p_misfit : float
        p-value of the residual after the findings: probability that data without further effects misfit as much.
    discrepancy : dict
        Where, when and under which load the believed model differs from the data.
    extended : Experiment or MaterialExperiment
        The believed experiment with the findings as effects, and the fitted modulus where the data determine it.
    next_experiment : dict or None
        Action that would distinguish causes that these data cannot; what to check where the verdict is ``unexplained``.
    seed : int
        Seed of all random draws.
    versions : dict of str to str
        Versions of the package, numpy and Python.
    provenance : Provenance
        Date, version, call or command, hashes of the input files, warnings.
    settings : dict
        Arguments of the diagnosis, by name.
    numbers : DiagnoseSettings
        All numbers that may change a diagnosis.
    """

    verdict: str
    findings: tuple[Finding, ...]
    candidates: tuple[dict[str, Any], ...]
    p_misfit: float
    discrepancy: dict[str, Any]
    extended: Experiment | MaterialExperiment
    next_experiment: dict[str, Any] | None
    seed: int
    versions: dict[str, str]
    possible: tuple[dict[str, Any], ...] = ()
    provenance: Provenance = field(default_factory=Provenance)
    settings: dict[str, Any] = field(default_factory=dict)
    numbers: DiagnoseSettings = DEFAULT

    def __repr__(self) -> str:
        names = ", ".join(" or ".join(finding.group) for finding in self.findings) or "nothing named"
        return f"{type(self).__name__}({self.verdict}: {names}; p_misfit {self.p_misfit:.2g})"

    @property
    @abstractmethod
    def provisional(self) -> bool:
        """Whether the data are too few to predict a part of them from several others."""

    @abstractmethod
    def _own_json(self) -> dict[str, Any]:
        """Return the entries of the answer that depend on its kind."""

    @abstractmethod
    def _page(self, folder: Path) -> str:
        """Return the page, HTML, for a folder to which paths in it are relative."""

    def to_json(self) -> dict[str, Any]:
        """Return the diagnosis as plain data for JSON, in the schema ``tissuereg.diagnosis/1``."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "provisional": self.provisional,
            "causes": [finding.to_json() for finding in self.findings],
            "possible": list(self.possible),
            "candidates": list(self.candidates),
            "p_misfit": self.p_misfit,
            "discrepancy": self.discrepancy,
            **self._own_json(),
            "extended_model": EXTENDED_FILE,
            "next_experiment": self.next_experiment,
            "seed": self.seed,
            "versions": self.versions,
            "provenance": self.provenance.to_json(self.settings),
        }

    def report(self, path: str | os.PathLike[str]) -> Path:
        """Write one self-contained HTML page: verdict, residuals, ranking of causes, proof, assumptions.

        The proof of a cause is its prediction of data that were left out of the fit.

        Parameters
        ----------
        path : path-like
            File to write, whole or not at all.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        from tissuereg.io.atomic import OutputError, atomic_file

        target = place("path", path, error=OutputError)
        with atomic_file(target) as draft:
            draft.write_text(self._page(target.parent), encoding="utf-8")
        return target

    def save(self, folder: str | os.PathLike[str], extra: Mapping[str, Any] | None = None) -> Path:
        """Write ``diagnosis.json``, ``experiment.extended.toml`` and ``report.html``, all or none.

        Parameters
        ----------
        folder : path-like
            Folder to write into; files of these names in it are replaced, others stay.
        extra : mapping, optional
            Entries added to ``diagnosis.json``; they replace entries of the same name.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        ExperimentError
            If the extended model cannot be written as a file.
        OutputError
            If the folder cannot be written.
        """
        from tissuereg.io.atomic import OutputError, atomic_folder
        from tissuereg.io.experiment_out import write_experiment
        from tissuereg.io.json import write_json

        out = place("folder", folder, error=OutputError)
        with atomic_folder(out) as draft:
            write_json(draft / "diagnosis.json", {**self.to_json(), **(extra or {})})
            write_experiment(self.extended, draft / EXTENDED_FILE, seen_from=out)
            (draft / "report.html").write_text(self._page(out), encoding="utf-8")
        return out


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class BodyDiagnosis(Diagnosis):
    """The diagnosis of a body: a `Diagnosis`, and what only a body has.

    Attributes
    ----------
    extended : Experiment
        The believed experiment with the findings as effects, and the fitted modulus where the data determine it.
    constancy : tuple of Constancy
        For every cause that was found whether its change is the same in all parts of the data. Where that of the first
        is not, no cause is stated; a later one is given up with those found after it, which stand last.
    outside : tuple of Outside
        Comparison of every cause that was found with effects outside the catalogue; where one of these is likelier, no
        cause is stated, or its family alone.
    left : dict or None
        Residual misfit after the findings, None where there is none: its p-value ``p``, ``where`` (markers and pads),
        ``when``, the cause that it ``looks_like``, and a ``sentence``.
    suspicions : tuple of RecordingSuspicion
        Reason to suspect that the recording is misread; empty if it is plausible. Where it is in another unit, frame or
        sign, no cause is looked for and the verdict is ``unexplained``; where forces are below their noise, no modulus
        is found.
    understated : tuple of UnderstatedNoise
        Channels whose noise is larger than stated; the diagnosis is made with the larger one.
    details : DiagnosisDetails or None
        Objects that the report draws; None where no cause was looked for.
    """

    extended: Experiment
    left: dict[str, Any] | None = None
    constancy: tuple[Constancy, ...] = ()
    outside: tuple[Outside, ...] = ()
    suspicions: tuple[RecordingSuspicion, ...] = ()
    understated: tuple[UnderstatedNoise, ...] = ()
    details: DiagnosisDetails | None = None

    @property
    def provisional(self) -> bool:
        """Whether fewer than `least_cases` cases load the body, too few to hold one out and fit several others."""
        acts = [case for case in self.extended.cases.values() if case.displacements or case.applied_forces]
        return len(acts) < self.numbers.report.least_cases

    def _own_json(self) -> dict[str, Any]:
        return {
            "constancy": [one.to_json() for one in self.constancy],
            "outside": [one.to_json() for one in self.outside],
            "suspicions": [one.to_json() for one in self.suspicions],
            "understated_noise": [one.to_json() for one in self.understated],
            "left": self.left,
            "settings": self.numbers.to_json(catalogue(self.numbers)),
        }

    def _page(self, folder: Path) -> str:
        from tissuereg.diagnosis.report.page import page

        return page(self, folder)


def verdict_of(
    findings: Sequence[Finding], misfit: float, *, withdrawn: bool = False, level: float = DEFAULT.nulls.misfit
) -> str:
    """Return the verdict by the findings and the p-value of the residual; `withdrawn`: whether there were others."""
    if not findings:
        return "consistent" if misfit >= level and not withdrawn else "unexplained"
    return "named" if all(finding.is_sure for finding in findings) else "group"


def to_check(action: str, kind: str, name: str, **more: Any) -> dict[str, Any]:
    """Return the next experiment of an answer, where it is to check something and separates no causes.

    `action`: what to do; `kind`, `name`, `more`: what to check.
    """
    return {"action": action, "separates": [], "separability": None, "check": {"kind": kind, "name": name, **more}}


def versions_now() -> dict[str, str]:
    """Return the versions of the package, numpy and Python that an answer states."""
    return {"tissuereg": __version__, "numpy": np.__version__, "python": platform.python_version()}


def _pairs(values: Values, deviations: Values) -> dict[str, Any]:
    """Return fitted parameters by key, numbers as pairs [value, deviation]; a place also by axis, and a radius."""
    pairs: dict[str, Any] = {}
    for key, value in values.items():
        spread = deviations.get(key)
        if spread is None:
            pairs[key] = value
        elif isinstance(value, list) and isinstance(spread, list):
            pairs[key] = [list(pair) for pair in zip(value, spread, strict=True)]
            if key in ("centre_mm", "direction") and len(value) == 3:
                # Also by component, as in the example of the format.
                stem, _, unit = key.partition("_")
                for axis, pair in zip("xyz", pairs[key], strict=True):
                    pairs[f"{axis}_{unit}" if unit else f"{stem}_{axis}"] = pair
        else:
            pairs[key] = [value, spread]
    if "semi_axes_mm" in values:
        pairs["radius_mm"] = pairs["semi_axes_mm"][0]
    return pairs
