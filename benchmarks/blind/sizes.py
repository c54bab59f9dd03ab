"""Are the nuisances' prior standard deviations right? ``python -m blind.sizes PREDICTIONS`` or ``--open DIR``.

The wider the priors of the nuisances of `tissuereg.diagnose`, the more of a weak effect they absorb. On data without an
effect, this finds for every kind of nuisance the factor on its prior standard deviations that maximises the likelihood
of the residuals of all diagnosed nulls, the other kinds kept: 1 is right, below 1 the prior in use is too wide. The
errors of forces are reported too. The result is ``PREDICTIONS/sizes.json``, which `blind.score` shows. ``--open DIR``
uses the experiment folders in DIR instead, which are known to have no effect, for tuning (``python -m
blind.generator.open_cases nulls DIR``, or those of another solver).
"""

import argparse
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from blind.materialise import folder_of
from blind.run import BUILD
from blind.scored import of_kind, read_predictions, scored
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.evidence import fit_amplitudes
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.noise import estimate_noise
from tissuereg.diagnosis.refined import solvable
from tissuereg.diagnosis.run import make_believed
from tissuereg.diagnosis.signals import SignalLayout, load_history
from tissuereg.io.experiments import read_experiment
from tissuereg.io.json import write_json
from tissuereg.simulation.fine.meshing import rim_of

#: Candidate factors.
FACTORS = np.geomspace(0.25, 4.0, 49)

#: Factors that cost at most this many nats are in the reported range: two standard deviations.
IN_RANGE = 2.0


@dataclass(frozen=True, eq=False)
class Needs:
    """What the likelihood of one case's nuisances depends on.

    Attributes
    ----------
    kinds : ndarray of str, shape (n,)
        Kind of every nuisance.
    columns : ndarray of float64, shape (n, size)
        Whitened, times prior standard deviations.
    left : ndarray of float64, shape (size,)
        Residual of the believed model, whitened.
    forces : ndarray of float64, shape (n, 3)
        Errors of every active pad, see `force_errors`.
    """

    kinds: np.ndarray
    columns: np.ndarray
    left: np.ndarray
    forces: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))

    def log_likelihood(self, factors: np.ndarray) -> float:
        """Return the log likelihood, up to a constant, for prior standard deviations scaled by factors (n,)."""
        return fit_amplitudes(self.left, factors[:, None] * self.columns)[0]


def needs_of(folder: Path, threads: int = 0) -> Needs:
    """Return the data of one experiment on the nuisances, with the modulus fitted."""
    experiment = read_experiment(folder)
    bench = solvable(Bench(experiment, SignalLayout(experiment), threads=threads))
    layout = bench.layout
    noise = estimate_noise(bench.experiment, layout)
    believed = make_believed(bench, noise)
    # Only the residual's part in the span of the nuisances matters: as many numbers as columns.
    basis, along = np.linalg.qr(believed.target.null.nuisances.T)
    fitted = fit(believed.target, [])
    left = fitted.residual @ basis
    pads = {pad.name: "nodes" if rim_of(pad) is None else "ball" for pad in bench.experiment.actuators}
    names = [name for name in believed.nuisances.names if name != "stiffness"]
    kinds = np.array([kind_of(name, pads) for name in names])
    return Needs(kinds, along.T, left, force_errors(layout, fitted.prediction, bench.base, noise.force_std))


def force_errors(layout: SignalLayout, predicted: np.ndarray, base: np.ndarray, std: float) -> np.ndarray:
    """Return the errors of pad forces, over the largest force of their case.

    Parameters
    ----------
    layout : SignalLayout
        Order of the data.
    predicted, base : ndarray of float64, shape (size,)
        Predictions of the fitted model, and of the believed one on the user's mesh, mm and mN.
    std : float
        Standard deviation of a force's noise, mN.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        One row per case and pad: mean error along the pad's force over the frames under more than half of the load, the
        same across it (per direction), and the standard deviation of such a mean by noise alone.
    """
    rows = []
    for part in layout.parts:
        loaded = load_history(part, base) > 0.5
        for pad in range(len(part.pads) if loaded.any() else 0):
            force = part.forces(predicted)[loaded, pad]
            off = np.nanmean(part.forces(layout.measured)[loaded, pad] - force, axis=0)
            direction = force.sum(axis=0) / np.linalg.norm(force.sum(axis=0))
            along = float(off @ direction)
            across = float(np.linalg.norm(off - along * direction)) / np.sqrt(2.0)
            largest = np.linalg.norm(force, axis=1).max()
            rows.append(np.array([along, across, std / np.sqrt(loaded.sum())]) / largest)
    return np.array(rows).reshape(-1, 3)


def kind_of(name: str, pads: dict[str, str]) -> str:
    """Return the kind of a nuisance: its first word, with errors of the mesh in markers and in forces kept apart.

    Parameters
    ----------
    name : str
        Name of the nuisance.
    pads : dict of str
        How each pad is given, as a ball or by nodes, which is a part of the kind of its own shape.
    """
    words = name.split()
    for pad, given in pads.items():
        if f" of {pad} " in f"{name} ":
            return f"{words[0]}, {given}"
    if name == "bent alike":
        return name
    if words[0] not in ("mesh", "bent"):
        return words[0]
    return f"{words[0]}, forces" if words[-2] in pads else "mesh, markers"


def sizes_of(needs: list[Needs]) -> dict[str, dict[str, float]]:
    """Return for every kind the most likely factor, and the range of those hardly less likely."""
    found = {}
    for kind in sorted({kind for case in needs for kind in case.kinds}):
        logs = np.array([_together(needs, kind, factor) for factor in FACTORS])
        likely = FACTORS[logs >= logs.max() - IN_RANGE]
        found[kind] = {
            "factor": float(FACTORS[logs.argmax()]),
            "low": float(likely.min()),
            "high": float(likely.max()),
            "gain_nats": float(logs.max() - _together(needs, kind, 1.0)),
        }
    return found


def _together(needs: list[Needs], kind: str, factor: float) -> float:
    return sum(case.log_likelihood(np.where(case.kinds == kind, factor, 1.0)) for case in needs)


def found_on(nulls: list[Path], threads: int) -> dict:
    """Return factors and errors of forces of experiments without an effect, and print progress."""
    needs = []
    for number, null in enumerate(nulls, start=1):
        needs.append(needs_of(null, threads))
        print(f"{number}/{len(nulls)} {null.name}", flush=True)
    found = {"nulls": len(nulls), "sizes": sizes_of(needs)}
    if needs:
        rms = np.sqrt((np.concatenate([case.forces for case in needs]) ** 2).mean(axis=0))
        found["forces"] = dict(zip(("along", "across", "noise"), rms.tolist(), strict=True))
    return found


def main() -> None:
    """Find the factors for the nulls of a folder of predictions and save them."""
    parser = argparse.ArgumentParser(prog="python -m blind.sizes", description=__doc__)
    parser.add_argument("predictions", type=Path, nargs="?", help="answers; only the nulls among them are used")
    parser.add_argument("--open", type=Path, help="folder of experiments without an effect")
    parser.add_argument("--work", type=Path, default=BUILD)
    parser.add_argument("--threads", type=int, default=0)
    options = parser.parse_args()
    os.environ.setdefault("TISSUEREG_CACHE", str((options.work / "cache").resolve()))
    if (options.predictions is None) == (options.open is None):
        parser.error("give either a folder of answers or --open")
    if options.open is not None:
        nulls = sorted(file.parent for file in options.open.glob("*/experiment.toml"))
    else:
        answered = of_kind(scored(read_predictions(options.predictions)), "null")
        nulls = [folder_of(null.case, options.work) for null in answered]
    kept = (options.predictions or options.open) / "sizes.json"
    write_json(kept, found_on(nulls, options.threads))
    print(kept.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
