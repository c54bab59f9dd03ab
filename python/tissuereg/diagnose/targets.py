"""What a finding gains at inner targets, which were measured and never fitted."""

import numpy as np

from tissuereg.errors import TissueRegError
from tissuereg.experiment import Experiment
from tissuereg.simulate.experiment import simulate_plain


def target_rms(experiment: Experiment, *, element: str, threads: int) -> float | None:
    """Return how far an experiment's model is from its measured targets.

    Parameters
    ----------
    experiment : Experiment
        With its effects; the user's mesh, uncorrected.
    element : str
        Elements to use, as `simulate_plain` takes it.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    float or None
        Root mean square over coordinates, frames and targets in mm; None where nothing was measured or simulated.
    """
    measured = {name: case.targets for name, case in experiment.cases.items() if case.targets}
    if not measured:
        return None
    try:
        answers = simulate_plain(experiment, element=element, threads=threads)
    except TissueRegError:  # a model without equilibrium says nothing of its targets
        return None
    left = [answers[case].targets[name] - found for case, of in measured.items() for name, found in of.items()]
    errors = np.concatenate([error.ravel() for error in left])
    errors = errors[np.isfinite(errors)]
    return float(np.sqrt(np.mean(errors**2))) if errors.size else None
