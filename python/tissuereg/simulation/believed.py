"""Simulation of an experiment, on the fine mesh that `diagnose` uses or on the mesh as it is."""

from collections.abc import Callable

from tissuereg._base.arguments import called, check_choice, check_running, found, of_kind
from tissuereg._base.choices import ELEMENTS, Element
from tissuereg.errors import ArgumentError, ExperimentError
from tissuereg.experiment.experiment import Experiment
from tissuereg.simulation.experiment import CaseSimulation, simulate_plain


def simulate_experiment(
    experiment: Experiment,
    *,
    model: str = "fine",
    element: Element = "tet4",
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, CaseSimulation]:
    """Return the prediction of the believed model, effects included, for every case of an experiment.

    An effect is a property that the basic elastic model lacks, such as relaxation or a sliding support; a case is one
    load history of the experiment, and a frame is one moment of it.

    Parameters
    ----------
    experiment : Experiment
        The believed model (`tissuereg.read_experiment`): mesh, material, supports, loads and effects as stated.
    model : {"fine", "plain"}
        `fine`: pads cut out of the surface along their rims, with small ten-node elements around them: the model that
        `tissuereg.diagnose` uses (`tissuereg.FineModel`). `plain`: the mesh as it is.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements of the plain model: four-node, four-node with averaged volume ratios, or ten-node. The fine model has
        its own elements and ignores this.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    progress : callable of (int, int), optional
        Called with the number of frames done and the number of all frames.

    Returns
    -------
    dict of str to CaseSimulation
        One prediction per case, in the experiment's order: displacement of the nodes of its mesh and places of markers
        and targets in mm, forces of the actuators in mN.

    Raises
    ------
    ConvergenceError
        If no frame of a case finds equilibrium, or a mesh that was imaged under gravity has no unloaded shape.
    ExperimentError
        If there is no such model, or an effect does not fit the experiment.
    MeshError
        If the mesh cannot be refined.

    Examples
    --------
    >>> import tissuereg as tr
    >>> rig = tr.read_experiment("rig")  # doctest: +SKIP
    >>> tr.simulate_experiment(rig)["push_x"].markers.shape  # doctest: +SKIP
    (24, 25, 3)
    """
    of_kind("experiment", experiment, Experiment)
    check_choice("element", element, ELEMENTS, ArgumentError)
    check_running(threads=threads)
    called("progress", progress)
    if isinstance(model, str) and model == "plain":
        return simulate_plain(experiment, element=element, threads=threads, progress=progress)
    if not isinstance(model, str) or model != "fine":
        message = f"`model` must be 'fine' or 'plain', got {found(model)}"
        raise ExperimentError(message, where="model")
    from tissuereg.simulation.fine import FineModel

    return FineModel(experiment).simulate(threads=threads, progress=progress)
