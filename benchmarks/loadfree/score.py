"""Scores of one registration, and figures over many with intervals from whole events."""

from collections import defaultdict
from collections.abc import Callable, Iterable

import numpy as np
from scipy.special import ndtr
from scipy.stats import chi2

#: Shares of the regions that are looked at.
SHARES = (0.5, 0.9, 0.95)

#: A target off by less than this share of its true motion needs no flag.
GOOD_SHARE = 0.2

#: Resamplings of whole events, and their seed.
N_RESAMPLED, SEED = 1000, 5

#: Squared Mahalanobis distances are cut here, so that numbers stay short.
LARGEST_M2 = 1e6


def scored(nodes, targets, answer) -> dict:
    """Return the scores of one registration; lengths in mm, or in um according to the name.

    Parameters
    ----------
    nodes, targets : ndarray, shape (n, 3)
        True displacements, mm.
    answer : rivals.Answer
        Answer of the method.
    """
    off = answer.targets - targets
    row = {
        "body_mm": round(float(np.linalg.norm(answer.nodes - nodes, axis=1).mean()), 5),
        "off_um": _whole(np.linalg.norm(off, axis=1)),
        "crps_um": round(1e3 * float(crps(off, answer.covariances).mean()), 2),
    }
    if answer.covariances is not None:
        row["m2"] = [float(f"{min(value, LARGEST_M2):.3g}") for value in mahalanobis(off, answer.covariances)]
        widest = np.linalg.eigvalsh(answer.covariances)[:, -1]
        row["half_axis_um"] = _whole(np.sqrt(chi2.ppf(0.9, 3) * np.maximum(widest, 0.0)))
    if answer.constrained is not None:
        row["constrained"] = [round(share, 3) for share in answer.constrained]
    if answer.flagged is not None:
        row["flagged"] = [int(flag) for flag in answer.flagged]
    if answer.trusted is not None:
        row["trusted"] = answer.trusted
    if answer.counters:
        row["counters"] = answer.counters
    return row


def mahalanobis(off, covariances):
    """Return squared Mahalanobis distances (n,) of errors (n, 3) under covariances (n, 3, 3)."""
    return np.einsum("ni,ni->n", off, np.linalg.solve(covariances, off[..., None])[..., 0])


def crps(off, covariances):
    """Return the continuous ranked probability score (n,) in mm of Gaussian forecasts, mean over components.

    A forecast without a covariance is a point: its score is the absolute error.
    """
    if covariances is None:
        return np.abs(off).mean(axis=1)
    spread = np.sqrt(np.einsum("nii->ni", covariances))
    z = off / spread
    density = np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
    return (spread * (z * (2 * ndtr(z) - 1) + 2 * density - 1 / np.sqrt(np.pi))).mean(axis=1)


Part = Callable[[dict, dict], tuple[float, float]]


def _covered(share: float, unflagged: bool = False) -> Part:
    limit = chi2.ppf(share, 3)

    def part(row: dict, event: dict) -> tuple[float, float]:
        inside = np.array(row["m2"]) <= limit
        kept = np.array(row["flagged"]) == 0 if unflagged else np.ones(len(inside), dtype=bool)
        return float(inside[kept].sum()), float(kept.sum())

    return part


def _moving(row: dict, event: dict) -> tuple[float, float]:
    moved = np.array(event["moved_um"])
    most = np.argsort(moved, kind="stable")[-(len(moved) // 3) :]
    return float(np.array(row["off_um"])[most].mean() / 1e3), 1.0


def _good(row: dict, event: dict) -> np.ndarray:
    return np.array(row["off_um"]) < GOOD_SHARE * np.array(event["moved_um"])


def _good_flagged(row: dict, event: dict) -> tuple[float, float]:
    good = _good(row, event)
    return float((good & (np.array(row["flagged"]) > 0)).sum()), float(good.sum())


def _flags_good(row: dict, event: dict) -> tuple[float, float]:
    flagged = np.array(row["flagged"]) > 0
    return float((_good(row, event) & flagged).sum()), float(flagged.sum())


#: Figures that are a sum over a sum, over registrations; each with the key that a row must have.
RATIOS: dict[str, tuple[str, Part]] = {
    "body_mm": ("body_mm", lambda row, event: (row["body_mm"], 1.0)),
    "moving_mm": ("off_um", _moving),
    "worse": ("body_mm", lambda row, event: (float(row["body_mm"] > event["body_moved_mm"]), 1.0)),
    "crps_mm": ("crps_um", lambda row, event: (row["crps_um"] / 1e3, 1.0)),
    **{f"cover{100 * share:.0f}": ("m2", _covered(share)) for share in SHARES},
    "cover90_unflagged": ("flagged", _covered(0.9, unflagged=True)),
    "flagged": ("flagged", lambda row, event: (float(sum(row["flagged"])), float(len(row["flagged"])))),
    "good_flagged": ("flagged", _good_flagged),
    "flags_good": ("flagged", _flags_good),
    "trusted": ("trusted", lambda row, event: (float(row["trusted"]), 1.0)),
}


def figures(rows: list[dict], events: dict[tuple[str, int], dict]) -> dict[str, dict]:
    """Return figures over registrations: ``{name: {"value", "low", "high"}}``, the last two where there is an interval.

    Parameters
    ----------
    rows : list of dict
        Of `scored`, with ``body``, ``event`` and ``seconds``.
    events : dict
        By body and number: ``moved_um`` (true motion of targets) and ``body_moved_mm``.
    """
    found = {"n": {"value": len(rows)}}
    for name, (key, part) in RATIOS.items():
        usable = [row for row in rows if key in row]
        if usable:
            found[name] = _ratio(usable, events, part)
    if m2 := _all(rows, "m2"):
        found["largest_m2"] = {"value": max(m2)}
        found["half_axis_mm"] = {"value": float(np.median(_all(rows, "half_axis_um"))) / 1e3}
    if rows:
        found["seconds"] = {"value": float(np.median([row["seconds"] for row in rows]))}
    return found


def _all(rows: Iterable[dict], key: str) -> list:
    return [value for row in rows for value in row.get(key, ())]


def _ratio(rows: list[dict], events: dict, part: Part) -> dict:
    """Return a ratio of sums with its 95 % interval by resampling events with all their layouts."""
    sums: dict = defaultdict(lambda: np.zeros(2))
    for row in rows:
        cluster = row["body"], row["event"]
        sums[cluster] += part(row, events[cluster])
    clusters = np.array([sums[cluster] for cluster in sorted(sums)])
    top, low = clusters.sum(axis=0)
    if not low:
        return {"value": None}
    drawn = np.random.default_rng(SEED).integers(len(clusters), size=(N_RESAMPLED, len(clusters)))
    again = clusters[drawn].sum(axis=1)
    again = again[again[:, 1] > 0]
    ends = np.quantile(again[:, 0] / again[:, 1], [0.025, 0.975])
    return {"value": float(top / low), "low": float(ends[0]), "high": float(ends[1])}


def _whole(values_mm) -> list[int]:
    return [int(value) for value in np.rint(1e3 * values_mm)]
