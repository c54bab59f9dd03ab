"""Prediction errors at inner targets, which may be measured and are never fitted."""

import numpy as np

from tissuereg.errors import TissueRegError
from tissuereg.experiment.experiment import Experiment
from tissuereg.simulation.experiment import simulate_plain


def target_rms(experiment: Experiment, *, element: str, threads: int) -> float | None:
    """Return the error of an experiment's model at its measured targets.

    Parameters
    ----------
    experiment : Experiment
        With its effects; simulated on the user's mesh, without correction.
    element : str
        Elements, as in `simulate_plain`.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    float or None
        Root mean square over coordinates, frames and targets in mm; None where no target was measured or the model has
        no equilibrium.
    """
    measured = {name: case.targets for name, case in experiment.cases.items() if case.targets}
    if not measured:
        return None
    try:
        answers = simulate_plain(experiment, element=element, threads=threads)
    except TissueRegError:  # no equilibrium, no prediction
        return None
    differences = [answers[case].targets[name] - found for case, of in measured.items() for name, found in of.items()]
    errors = np.concatenate([difference.ravel() for difference in differences])
    errors = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(errors**2))) if errors.size else None
