"""What a simulation gets wrong: shown, named, extended, and the gain measured.

`diagnose` takes an experiment and answers. How it goes, step by step, is told in `run`; each cause is a module of
`causes`.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, overload

from tissuereg._arguments import called, check_running, flag, of_kind
from tissuereg._choice import check_choice
from tissuereg.errors import ArgumentError
from tissuereg.experiment import Experiment
from tissuereg.material_experiment import MaterialExperiment
from tissuereg.simulate.solve import ELEMENTS

if TYPE_CHECKING:
    from tissuereg.diagnose.answer import Diagnosis
    from tissuereg.diagnose.material import MaterialDiagnosis

__all__ = ["diagnose"]


@overload
def diagnose(
    experiment: Experiment,
    *,
    seed: int = 0,
    threads: int = 0,
    keep: bool = True,
    element: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> "Diagnosis": ...
@overload
def diagnose(
    experiment: MaterialExperiment,
    *,
    seed: int = 0,
    threads: int = 0,
    keep: bool = True,
    element: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> "MaterialDiagnosis": ...
def diagnose(
    experiment: Experiment | MaterialExperiment,
    *,
    seed: int = 0,
    threads: int = 0,
    keep: bool = True,
    element: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> "Diagnosis | MaterialDiagnosis":
    """Return what the simulation of an experiment gets wrong, and why.

    Parameters
    ----------
    experiment : Experiment or MaterialExperiment
        What is believed and what was measured (`tissuereg.read_experiment`, `tissuereg.read_material_experiment`).
    seed : int
        Of all chance.
    threads : int
        Threads to use; 0 takes all cores. The answer does not depend on it.
    keep : bool
        Whether the bank of causes and the fine meshes' answers are kept for the next experiment of this mesh and rig.
    element : {"tet4", "tet4-averaged", "tet10"}, optional
        Elements of the believed model of a body; ``"tet4"`` where absent, and those that the data were simulated with
        where they are a plain simulation's (``[simulated]`` in the experiment's file). Four-node ones are stiff in
        bending; a fine mesh corrects what the believed model says, but not what moves only with a cause: a slender body
        under its own weight wants others.
    progress : callable of str, optional
        Called with what is at work.

    Returns
    -------
    Diagnosis or MaterialDiagnosis
        Verdict, findings with the extended model, what else was tried. Both have `verdict` and `to_json`.

    Raises
    ------
    ArgumentError
        If an argument is of another kind than said, or out of its range.
    ExperimentError
        If nothing was measured.
    NoiseError
        If forces were measured and their noise is not stated.
    MeshError
        If the body cannot be meshed anew, finer.
    ConvergenceError
        If the believed model itself finds no equilibrium.

    Notes
    -----
    Bodies of 4,000 nodes with three load cases take some minutes the first time, most of them for the bank of causes.
    """
    of_kind("experiment", experiment, (Experiment, MaterialExperiment))
    check_running(seed=seed, threads=threads)
    flag("keep", keep)
    called("progress", progress)
    if element is not None:
        check_choice("element", element, ELEMENTS, ArgumentError)
    if isinstance(experiment, MaterialExperiment):
        from tissuereg.diagnose.material import diagnose_material

        return diagnose_material(experiment, seed=seed, progress=progress)
    from tissuereg.diagnose.run import diagnose_body

    return diagnose_body(experiment, seed=seed, threads=threads, keep=keep, element=element, progress=progress)
