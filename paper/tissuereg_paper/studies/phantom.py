"""The phantom experiment (the paper's section IV, Figs. 10 and 11) as studies, from the runs of a contest."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ArgumentError
from tissuereg_paper.rivals import KfAdmm, Network, VariedNetwork
from tissuereg_paper.studies.believed import CONDITIONS, PLAIN, Condition
from tissuereg_paper.studies.claims import Agreement, Claim
from tissuereg_paper.studies.contest import KEYS, Contest, Simulated
from tissuereg_paper.studies.rigs import Rig
from tissuereg_paper.studies.runs import Run

#: Shares by which the paper's method lowers the simulation's error and that of KF-ADMM, and our goals.
PAPER_REDUCTION, PAPER_AGAINST_KF = 0.72, 0.45
GOAL_REDUCTION, GOAL_AGAINST_KF = 0.80, 0.55

#: Our registrations that goals are of, and what tables add to their statements.
_OURS = {Network.name: "", VariedNetwork.name: ", with variants"}

#: Studies, and the scenario that each shows; None: both.
PHANTOM_STUDIES: dict[str, int | None] = {"fig10": 1, "fig11": 2, "phantom": None}

#: Seeds whose rigs are run under conditions other than the plain one: the lowest of those there are.
_FURTHER_SEEDS = 1

#: Resamples of an interval, and their seed.
_RESAMPLES, _SEED = 2000, 27

#: Called with the number of rigs that are done, and of all.
Progress = Callable[[int, int], None]


def phantom_study(name: str, contest: Contest, progress: Progress | None = None) -> dict[str, Any]:
    """Return the entries of a study's JSON.

    Parameters
    ----------
    name : str
        Among `PHANTOM_STUDIES`.
    contest : Contest
        With rigs of the study's scenario.
    progress : callable of (int, int), optional
        Called with the number of rigs and conditions that are done, and of all.

    Returns
    -------
    dict
        ``rows`` (a method under a condition), ``agree``, ``conditions``, ``left_out``, and ``rigs_left_out``, under
        whose pads the believed body has no equilibrium; of a figure ``curves``; of
        ``phantom`` ``goals`` and, all markers seen, ``methods`` by their short names, ``cut_of_simulation`` and
        ``better_than_kf_admm`` (shares of our network; None where a method was not run), the same ``with_variants``,
        ``rigs``, ``seeds``.

    Raises
    ------
    ArgumentError
        If there is no rig of the scenario.
    """
    scenario = PHANTOM_STUDIES[name]
    rigs = [rig for rig in contest.rigs if scenario in (None, rig.scenario)]
    without = [rig.name for rig in rigs if not contest.simulated(rig)]
    rigs = [rig for rig in rigs if rig.name not in without]
    if not rigs:
        message = f"`data` must hold rigs of scenario {scenario} for '{name}' that can be simulated, found none"
        raise ArgumentError(message, where="data")
    conditions = CONDITIONS if scenario is None else (PLAIN,)
    few = sorted({rig.seed for rig in rigs})[:_FURTHER_SEEDS]
    order = [(rig, one) for rig in rigs for one in conditions if one is PLAIN or rig.seed in few]
    runs: dict[str, list[Run]] = {condition.name: [] for condition in conditions}
    for done, (rig, condition) in enumerate(order, start=1):
        runs[condition.name] += contest.runs(rig, condition)
        if progress is not None:
            progress(done, len(order))
    rows = [
        {"study": name, "scenario": scenario, **row}
        for condition in conditions
        for row in _rows(condition, runs[condition.name])
    ]
    found = {
        "rows": rows,
        "agree": {name: _agreement(rows).to_json()},
        "conditions": {condition.name: condition.words for condition in conditions},
        "left_out": list(contest.left_out),
        "rigs_left_out": without,
    }
    if scenario is None:
        counted = {"rigs": len(rigs), "seeds": sorted({rig.seed for rig in rigs})}
        return {**found, "goals": _goals(rows), **_short(rows), **counted}
    return {**found, "curves": _curves(rigs[0], contest.runs(rigs[0], PLAIN))}


def merged(known: dict[str, Any], new: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON of a study in which what was run again takes the place of what was known.

    Parameters
    ----------
    known, new : dict
        JSON of the same study on the same rigs; `new` may be of a few methods.

    Returns
    -------
    dict
        As of `phantom_study`: rows, curves, and all that is counted from them.

    Raises
    ------
    ArgumentError
        If the two are of different rigs or conditions.
    """
    for part in ("rigs_left_out", "conditions", "rigs", "seeds"):
        if known.get(part) != new.get(part):
            message = f"studies that are merged must have the same {part}, got {known.get(part)} and {new.get(part)}"
            raise ArgumentError(message, where=part)
    of_new = {(row["condition"], row["method"]): row for row in new["rows"]}
    rows = [of_new.pop((row["condition"], row["method"]), row) for row in known["rows"]] + list(of_new.values())
    methods = {row["method"] for row in rows}
    (study,) = new["agree"]
    found = {
        **known,
        **new,
        "rows": rows,
        "agree": {study: _agreement(rows).to_json()},
        "left_out": [name for name in known["left_out"] if name not in methods],
    }
    if "curves" in known:
        curves = known["curves"]["sensor_mm"] | new["curves"]["sensor_mm"]
        return {**found, "curves": {**new["curves"], "sensor_mm": curves}}
    return {**found, "goals": _goals(rows), **_short(rows)}


def of_rigs(runs: Sequence[Run], value: Callable[[Run], float]) -> FloatArray:
    """Return a value of every rig (n_rigs,), in their order."""
    return np.array([value(run) for run in runs])


def interval(values: FloatArray) -> tuple[float, float]:
    """Return the 95 % interval of the mean of values (n_rigs,) by the bootstrap over rigs."""
    draws = np.random.default_rng(_SEED).integers(len(values), size=(_RESAMPLES, len(values)))
    low, high = np.quantile(values[draws].mean(axis=1), (0.025, 0.975))
    return float(low), float(high)


def _rows(condition: Condition, runs: Sequence[Run]) -> list[dict[str, Any]]:
    by_method: dict[str, list[Run]] = {}
    for run in runs:
        by_method.setdefault(run.method, []).append(run)
    start = of_rigs(by_method[Simulated.name], _sensor) if Simulated.name in by_method else None
    return [_row(condition, method, its, start) for method, its in by_method.items()]


def _sensor(run: Run) -> float:
    return float(run.sensor_mm.mean())


def _row(condition: Condition, method: str, runs: Sequence[Run], start: FloatArray | None) -> dict[str, Any]:
    sensor = of_rigs(runs, _sensor)
    inner = of_rigs(runs, lambda run: float(run.inner_mm.mean()))
    reduction = None if start is None or not (start > 0.0).all() else 1.0 - sensor / start
    covered = [run.coverage90 for run in runs if run.coverage90 is not None]
    return {
        "condition": condition.name,
        "method": method,
        "rigs": len(runs),
        "sensor_mean_mm": float(sensor.mean()),
        "sensor_interval95_mm": interval(sensor),
        "sensor_q95_mm": float(np.quantile(np.concatenate([run.sensor_mm for run in runs]), 0.95)),
        "inner_mean_mm": float(inner.mean()),
        "inner_interval95_mm": interval(inner),
        "inner_q95_mm": float(np.quantile(np.concatenate([run.inner_mm.ravel() for run in runs]), 0.95)),
        "reduction": None if reduction is None else float(reduction.mean()),
        "reduction_interval95": None if reduction is None else interval(reduction),
        "coverage90": float(np.mean(covered)) if covered else None,
        "ms": float(np.median([run.ms for run in runs])),
        "frames": sum(run.frames for run in runs),
        "failed": sum(run.failed for run in runs),
    }


def _plain(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {row["method"]: row for row in rows if row["condition"] == PLAIN.name}


def _short(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the contest in short: each method with all markers seen, and what the goals are of."""
    plain = _plain(rows)
    return {
        "methods": {
            KEYS.get(name, name): {
                "sensor_mean_mm": row["sensor_mean_mm"],
                "inner_mean_mm": row["inner_mean_mm"],
                "inner_95_mm": row["inner_q95_mm"],
                "ms_a_frame": row["ms"],
                "coverage90": row["coverage90"],
            }
            for name, row in plain.items()
        },
        **_shares(plain, Network.name),
        "with_variants": _shares(plain, VariedNetwork.name),
    }


def _shares(plain: dict[str, dict[str, Any]], method: str) -> dict[str, float | None]:
    """Return by which shares a method lowers the simulation's error and is better than KF-ADMM; None if not run."""
    reduction = plain[method]["reduction"] if method in plain else None
    return {"cut_of_simulation": reduction, "better_than_kf_admm": _against_kf(plain, method)}


def _against_kf(plain: dict[str, dict[str, Any]], method: str) -> float | None:
    """Return by which share a method's error at the sensor is below that of KF-ADMM; None where either was not run."""
    rival, ours = plain.get(KfAdmm.name), plain.get(method)
    return None if rival is None or ours is None else 1.0 - ours["sensor_mean_mm"] / rival["sensor_mean_mm"]


def _agreement(rows: Sequence[dict[str, Any]]) -> Agreement:
    plain, claims = _plain(rows), []
    for method, words in _OURS.items():
        ours = plain.get(method)
        if ours is not None and ours["reduction"] is not None:
            low, high = ours["reduction_interval95"]
            text = f"registration lowers the simulation's error by {PAPER_REDUCTION:.0%}{words}"
            found = f"{ours['reduction']:.0%}, interval {low:.0%} to {high:.0%}"
            claims.append(Claim(text, ours["reduction"] >= PAPER_REDUCTION, found))
        gain = _against_kf(plain, method)
        if gain is not None:
            text = f"it is {PAPER_AGAINST_KF:.0%} better than KF-ADMM{words}"
            claims.append(Claim(text, gain >= PAPER_AGAINST_KF, f"{gain:.0%}"))
    return Agreement({"error at the sensor": tuple(claims)} if claims else {})


def _goals(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    plain = _plain(rows)
    return [goal for method, words in _OURS.items() for goal in _goals_of(plain, method, words)]


def _goals_of(plain: dict[str, dict[str, Any]], method: str, words: str) -> list[dict[str, Any]]:
    """Return what one of ours reaches."""
    ours = plain.get(method)
    if ours is None or ours["reduction"] is None:
        return []
    text = f"simulation's error lowered by {GOAL_REDUCTION:.0%}"
    goals = [_goal(f"{text}, mean over rigs{words}", ours["reduction"], GOAL_REDUCTION)]
    if Simulated.name in plain:
        for part, place in (("sensor", "at the sensor"), ("inner", "at inner points")):
            whole = 1.0 - ours[f"{part}_mean_mm"] / plain[Simulated.name][f"{part}_mean_mm"]
            goals.append(_goal(f"{text}, of the mean errors {place}{words}", whole, GOAL_REDUCTION))
    gain = _against_kf(plain, method)
    if gain is not None:
        goals.append(_goal(f"{GOAL_AGAINST_KF:.0%} better than KF-ADMM{words}", gain, GOAL_AGAINST_KF))
    better = sorted(
        (row for name, row in plain.items() if row["sensor_mean_mm"] < ours["sensor_mean_mm"] and name not in _OURS),
        key=lambda row: float(row["sensor_mean_mm"]),
    )
    names = ", ".join(f"{row['method']} ({row['sensor_mean_mm']:.2f} mm)" for row in better) or "none is better"
    return [*goals, {"goal": f"better than every other method{words}", "found": names, "met": not better}]


def _goal(text: str, found: float, wanted: float) -> dict[str, Any]:
    return {"goal": text, "found": f"{found:.0%}", "met": found >= wanted}


def _curves(rig: Rig, runs: Sequence[Run]) -> dict[str, Any]:
    return {
        "rig": rig.name,
        "motion_times_s": ((np.arange(len(rig.motion)) + 1) * rig.frame_s).tolist(),
        "motion": rig.motion.tolist(),
        "times_s": runs[0].times_s.tolist(),
        "sensor_mm": {run.method: run.sensor_mm.tolist() for run in runs},
    }
