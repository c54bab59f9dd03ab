"""Figures 6, 7 and 8 of the paper as sweeps, with what the paper says about each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg_paper.studies.cases import Cases
from tissuereg_paper.studies.claims import Agreement, Claim, Compared
from tissuereg_paper.studies.settings import METHODS, READING_WORDS, READINGS, STD_AS_VARIANCE, Method, Setting
from tissuereg_paper.studies.study import Given, Study
from tissuereg_paper.studies.sweep import Sweep

#: The paper's values.
CDS, MEMBERS, ASSIMILATIONS = (0.1, 0.01, 0.001), (10, 50, 100), (1, 2, 3, 5, 8, 10)
CD, N_E, N_A = 0.001, 100, 5

#: Fig. 8: error of the paper's start mesh and of its registered one; how near to it starts lie here; our goal. All mm.
PAPER_START_MM, PAPER_END_MM, WITHIN_MM, GOAL_MM = 7.3, 0.54, 0.5, 0.3

#: Most pairs of Fig. 8's class.
_MOST_FAR = 100


def fig6_settings() -> list[Setting]:
    """Return the settings of Fig. 6: C_d and N_e, at N_a = 5."""
    return [Setting(m, cd, r, n_e, N_A) for m in METHODS for r in READINGS for cd in CDS for n_e in MEMBERS]


def fig7_settings() -> list[Setting]:
    """Return the settings of Fig. 7: N_a and N_e, at C_d = 0.001."""
    return [Setting(m, CD, r, n_e, n_a) for m in METHODS for r in READINGS for n_a in ASSIMILATIONS for n_e in MEMBERS]


def fig8_settings() -> list[Setting]:
    """Return the settings of Fig. 8: N_e = 100, N_a = 5, C_d = 0.001."""
    return [Setting(method, CD, reading, N_E, N_A) for method in (*METHODS, STD_AS_VARIANCE) for reading in READINGS]


def far_cases(cases: Cases, seed: int) -> Cases:
    """Return pairs of Fig. 8's class: shapes that lie about 7.3 mm apart."""
    return cases.far(PAPER_START_MM, WITHIN_MM, _MOST_FAR, np.random.default_rng([seed, 23]))


def fig6_agreement(sweep: Sweep, method: Method = METHODS[0]) -> Agreement:
    """Return what holds of the paper's statements on Fig. 6."""

    def claims(reading: str) -> tuple[Claim, ...]:
        errors = _errors(sweep, method, reading)
        compared = Compared(sweep.clusters)
        return (
            compared.worse("C_d = 0.1 is worse than 0.001", errors(0.1, N_E, N_A), errors(CD, N_E, N_A)),
            compared.alike("C_d = 0.01 and 0.001 are alike", errors(0.01, N_E, N_A), errors(CD, N_E, N_A)),
            compared.worse("N_e = 10 is worse than 50", errors(CD, 10, N_A), errors(CD, 50, N_A)),
            compared.worse("N_e = 10 is worse than 100", errors(CD, 10, N_A), errors(CD, N_E, N_A)),
            compared.alike("N_e = 50 and 100 are alike", errors(CD, 50, N_A), errors(CD, N_E, N_A)),
        )

    return _by_reading(claims)


def fig7_agreement(sweep: Sweep, method: Method = METHODS[0]) -> Agreement:
    """Return what holds of the paper's statements on Fig. 7."""

    def claims(reading: str) -> tuple[Claim, ...]:
        errors = _errors(sweep, method, reading)
        compared = Compared(sweep.clusters)
        five = errors(CD, N_E, N_A)
        fewer = [n for n in ASSIMILATIONS if n < N_A]
        more = [n for n in ASSIMILATIONS if n > N_A]
        return (
            *(compared.worse(f"N_a = {n} is worse than 5", errors(CD, N_E, n), five) for n in fewer),
            *(compared.no_better(f"N_a = {n} gains nothing over 5", errors(CD, N_E, n), five) for n in more),
        )

    return _by_reading(claims)


def fig8_agreement(sweep: Sweep, method: Method = METHODS[0]) -> Agreement:
    """Return what holds of the paper's figures in Fig. 8."""

    def claims(reading: str) -> tuple[Claim, ...]:
        end = sweep.outcome(Setting(method, CD, reading, N_E, N_A)).end.mean
        start = sweep.start
        low, high = sweep.clusters.interval(end)
        return (
            Claim(
                f"{PAPER_START_MM} mm fall to {PAPER_END_MM} mm or less",
                float(end.mean()) <= PAPER_END_MM,
                f"{start.mean():.2f} to {end.mean():.3f} mm, interval {low:.3f} to {high:.3f}",
            ),
        )

    return _by_reading(claims)


def fig8_goal(sweep: Sweep) -> dict[str, Any]:
    """Return whether a method ends below our goal on Fig. 8's class, and which ends lowest."""
    ends = {
        (setting.method.name, setting.reading): float(sweep.outcome(setting).end.mean.mean())
        for setting in fig8_settings()
    }
    (method, reading), least = min(ends.items(), key=lambda item: item[1])
    return {"goal_mm": GOAL_MM, "end_mean_mm": least, "method": method, "reading": reading, "met": least < GOAL_MM}


def fig8_steps(sweep: Sweep, setting: Setting) -> list[float]:
    """Return the mean error of the start, and after each assimilation, mm."""
    return [float(sweep.start.mean()), *(float(step.mean.mean()) for step in sweep.outcome(setting).steps)]


def _errors(sweep: Sweep, method: Method, reading: str) -> Callable[[float, int, int], FloatArray]:
    def end(cd: float, n_e: int, n_a: int) -> FloatArray:
        return sweep.outcome(Setting(method, cd, reading, n_e, n_a)).end.mean

    return end


def _by_reading(claims: Callable[[str], tuple[Claim, ...]]) -> Agreement:
    return Agreement({f"C_d in {READING_WORDS[reading]}": claims(reading) for reading in READINGS})


@dataclass(frozen=True)
class Figure:
    """A study that is a sweep.

    Attributes
    ----------
    settings : callable
        Its settings.
    agreement : callable
        What holds of the paper's statements by a method, after the sweep has run its settings.
    """

    settings: Callable[[], Sequence[Setting]]
    agreement: Callable[[Sweep, Method], Agreement]


FIGURES = {
    "fig6": Figure(fig6_settings, fig6_agreement),
    "fig7": Figure(fig7_settings, fig7_agreement),
    "fig8": Figure(fig8_settings, fig8_agreement),
}


def figure_study(name: str) -> Study:
    """Return the study of a figure.

    Parameters
    ----------
    name : str
        Among `FIGURES`.

    Returns
    -------
    Study
        Its entries: ``methods``, ``encoder_spread`` (standard deviation of q over that of all training codes, median),
        ``rows``, ``agree``, and for Fig. 8 ``goal``.
    """
    figure, is_fig8 = FIGURES[name], name == "fig8"

    def study(given: Given) -> dict[str, Any]:
        cases = far_cases(given.cases, given.seed) if is_fig8 else given.cases
        sweep = Sweep(given.subject, cases, given.seed, thorough=is_fig8)
        settings = figure.settings()
        sweep.run(settings, given.threads, given.progress)
        rows = [sweep.row(name, setting) for setting in settings]
        # The paper's own method decides; the same statements with another prior are reported as well.
        paper, family = (figure.agreement(sweep, method).to_json() for method in METHODS[:2])
        found = {
            "methods": {setting.method.name: setting.method.words for setting in settings},
            "encoder_spread": sweep.encoder_spread,
            "rows": rows,
            "agree": {name: {**paper, METHODS[1].name: family}},
        }
        if not is_fig8:
            return found
        for row, setting in zip(rows, settings, strict=True):
            row |= {"paper_mm": PAPER_END_MM, "steps_mm": fig8_steps(sweep, setting)}
        return {**found, "goal": fig8_goal(sweep)}

    return study
