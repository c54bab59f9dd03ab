"""The hydrogel under a ball: registered to beads near its top, evaluated at beads below. 1 um is read as 1 mm."""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import tissuereg as tr
from support.meshes import kuhn

#: Width of the view and height of the body.
VIEW_MM, TOP_MM = 409.0, 76.0

#: Beyond the view the gel goes on; so far out it is taken to rest, 1.7 times the height of the body.
BEYOND_MM = (35.0, 80.0, 130.0)

#: Cells across the view and over the height.
CELLS = (16, 5)

#: Heights of markers and of targets.
MARKERS_MM, TARGETS_MM = (62.0, 76.0), (10.0, 50.0)

#: Noise of a bead along each axis.
STD_MM = (0.05, 0.05, 0.3)

#: Beads farther from a local affine fit are matched wrongly.
LARGEST_RESIDUAL = 0.9

#: Targets of one draw.
N_TARGETS = 200

#: Square of the radius of the ball that holds 90 % of a standard normal in three dimensions.
QUANTILE90 = 6.251


@dataclass(frozen=True, eq=False)
class Draw:
    """Beads of one draw: places before and after of markers and of targets, (n, 3)."""

    markers: tuple[Any, Any]
    targets: tuple[Any, Any]


def gel() -> tr.Mesh:
    """Return the gel with what lies around the view; its bottom and its far sides are held."""
    beyond = np.array(BEYOND_MM)
    across = np.concatenate([-beyond[::-1], np.linspace(0.0, VIEW_MM, CELLS[0] + 1), VIEW_MM + beyond])
    nodes, tets = kuhn([across, across, np.linspace(0.0, TOP_MM, CELLS[1] + 1)])
    side = ((nodes[:, :2] == across[0]) | (nodes[:, :2] == across[-1])).any(axis=1)
    return tr.Mesh(nodes, tets, {"fixed": np.flatnonzero(side | (nodes[:, 2] == 0.0))})


def draw(folder: Path, n_markers: int, seed: int, n_targets: int = N_TARGETS) -> Draw:
    """Return the beads of one draw: markers far from each other from a random first one, targets at random."""
    with np.load(folder / "beads.npz") as beads:
        good = beads["local_residual_um"] <= LARGEST_RESIDUAL
        before, after = (beads[name][good].astype(np.float64) for name in ("reference_um", "measured_um"))
    rng = np.random.default_rng(seed)
    within = lambda low, high: np.flatnonzero((before[:, 2] >= low) & (before[:, 2] <= high))  # noqa: E731
    high = within(*MARKERS_MM)
    chosen = high[far_apart(before[high], n_markers, int(rng.integers(len(high))))]
    held_out = rng.choice(within(*TARGETS_MM), n_targets, replace=False)
    return Draw((before[chosen], after[chosen]), (before[held_out], after[held_out]))


def far_apart(places: Any, count: int, first: int) -> Any:
    """Return indices of places each of which lies farthest from those before it."""
    chosen, gap = [first], np.linalg.norm(places - places[first], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(gap)))
        gap = np.minimum(gap, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.array(chosen)


def run(folder: Path, n_markers: int, seed: int, n_targets: int = N_TARGETS) -> dict[str, Any]:
    """Return one row of the table."""
    beads = draw(folder, n_markers, seed, n_targets)
    markers = tr.Markers(*beads.markers, np.tile(STD_MM, (n_markers, 1)))
    before, after = beads.targets
    started = perf_counter()
    result = tr.register(
        gel(),
        markers,
        targets={f"{i}": place for i, place in enumerate(before)},
        seed=seed,
    )
    spent = perf_counter() - started
    found = list(result.targets.values())
    off = after - np.array([target.mean for target in found])
    covariance = np.array([target.covariance for target in found]) + np.diag(np.square(STD_MM))
    squared = np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariance), off)
    moved, rms = after - before, lambda rows: float(np.sqrt(np.mean(np.sum(rows**2, axis=1))))
    return {
        "n_markers": n_markers,
        "seed": seed,
        "none": rms(moved),
        "registered": rms(off),
        "registered_xyz": np.sqrt(np.mean(off**2, axis=0)).tolist(),
        "mean_xyz": off.mean(axis=0).tolist(),
        "coverage90": float(np.mean(squared <= QUANTILE90)),
        "said_rms": float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)))),
        "flagged": float(np.mean([target.flag is not None for target in found])),
        "trust": result.trust.ok,
        "seconds": spent,
    }
