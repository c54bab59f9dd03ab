"""Find the physical causes of the difference between a simulation and its measurements.

`diagnose` takes an experiment (the believed model and what was measured) and returns a verdict, the causes found with
their evidence, and the believed model extended by them. `run` holds the sequence of steps for a body, `material` the
one for material tests, and each cause of the catalogue is a module of `causes`. The method: ``docs/diagnose.md``.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, overload

from tissuereg._base.arguments import called, check_choice, check_running, flag, of_kind
from tissuereg._base.blas import BlasThreads
from tissuereg._base.choices import ELEMENTS, Element
from tissuereg._base.provenance import call_text, note_origins, provenance_now, recorded
from tissuereg.errors import ArgumentError
from tissuereg.experiment.experiment import Experiment
from tissuereg.experiment.material_experiment import MaterialExperiment

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import BodyDiagnosis, Diagnosis
    from tissuereg.diagnosis.material import MaterialDiagnosis
    from tissuereg.diagnosis.settings import DiagnoseSettings

__all__ = ["diagnose"]


@overload
def diagnose(
    experiment: Experiment,
    *,
    seed: int = 0,
    threads: int = 0,
    keep: bool = True,
    element: Element | None = None,
    progress: Callable[[str], None] | None = None,
    settings: "DiagnoseSettings | None" = None,
) -> "BodyDiagnosis": ...
@overload
def diagnose(
    experiment: MaterialExperiment,
    *,
    seed: int = 0,
    threads: int = 0,
    keep: bool = True,
    element: Element | None = None,
    progress: Callable[[str], None] | None = None,
    settings: "DiagnoseSettings | None" = None,
) -> "MaterialDiagnosis": ...
def diagnose(
    experiment: Experiment | MaterialExperiment,
    *,
    seed: int = 0,
    threads: int = 0,
    keep: bool = True,
    element: Element | None = None,
    progress: Callable[[str], None] | None = None,
    settings: "DiagnoseSettings | None" = None,
) -> "Diagnosis":
    """Compare an experiment's measurements with its simulation and name the causes of the difference.

    Parameters
    ----------
    experiment : Experiment or MaterialExperiment
        The believed model and the measurements (`tissuereg.read_experiment`, `tissuereg.read_material_experiment`).
    seed : int
        Seed of all random draws.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    keep : bool
        Whether the bank of hypotheses and the predictions on fine meshes are cached for further experiments with this
        mesh and rig.
    element : {"tet4", "tet4-averaged", "tet10"}, optional
        Elements of the believed model of a body. Default: the elements that the data were simulated with where they
        come from a plain simulation (``[simulated]`` in the experiment's file), ``"tet4"`` otherwise. Four-node
        elements are too stiff in bending. A fine mesh corrects the believed model's predictions, but not deformations
        that occur only under a cause: use other elements for a slender body under its own weight.
    progress : callable of str, optional
        Called with the name of the step that begins.
    settings : DiagnoseSettings, optional
        All numbers that may change the result (`tissuereg.diagnosis.settings`); the defaults where none are given.
        A material test has numbers of its own (`MaterialSettings`), and none of a cause.

    Returns
    -------
    Diagnosis
        Verdict, findings, extended model, and the evidence of all causes tried: a `BodyDiagnosis`, or a
        `MaterialDiagnosis` of a material test.

    Raises
    ------
    ArgumentError
        If an argument has the wrong type or is out of range, or `settings` name a cause that the catalogue lacks.
    ExperimentError
        If nothing was measured.
    NoiseError
        If forces were measured and their noise is not stated.
    MeshError
        If no finer mesh of the body can be made.
    ConvergenceError
        If the believed model itself has no equilibrium.

    Notes
    -----
    A body of 4,000 nodes with three load cases takes some minutes the first time, most of them for the bank.
    """
    of_kind("experiment", experiment, (Experiment, MaterialExperiment))
    numbers = check_asked(settings, seed=seed, threads=threads, keep=keep, element=element, progress=progress)
    given = {"seed": seed, "element": element}
    with recorded(call_text("tissuereg.diagnose", experiment=experiment, **given)), BlasThreads().one():
        note_origins(experiment)
        if isinstance(experiment, MaterialExperiment):
            from tissuereg.diagnosis.material import diagnose_material

            tested = diagnose_material(experiment, seed=seed, progress=progress, settings=numbers)
            return replace(tested, provenance=provenance_now(), settings=given)
        from tissuereg.diagnosis.run import diagnose_body

        found = diagnose_body(
            experiment, seed=seed, threads=threads, keep=keep, element=element, progress=progress, settings=numbers
        )
        return replace(found, provenance=provenance_now(), settings=given)


def check_asked(
    settings: "DiagnoseSettings | None",
    *,
    seed: int,
    threads: int,
    keep: bool,
    element: Element | None,
    progress: Callable[..., None] | None,
) -> "DiagnoseSettings":
    """Return the settings of a diagnosis, the default ones for None, after checking all that is asked of it.

    Raises `ArgumentError` if an argument has the wrong type or is out of range, or `settings` name a cause that the
    catalogue lacks.
    """
    from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings

    check_running(seed=seed, threads=threads)
    flag("keep", keep)
    called("progress", progress)
    if element is not None:
        check_choice("element", element, ELEMENTS, ArgumentError)
    numbers = DEFAULT if settings is None else of_kind("settings", settings, DiagnoseSettings)
    if numbers.left_out or numbers.causes or numbers.search.repeated:
        from tissuereg.diagnosis.causes import CAUSES, Cause

        changed = [of_kind("settings.causes", one, Cause).id for one in numbers.causes]
        for where, ids in (
            ("settings.left_out", numbers.left_out),
            ("settings.causes", changed),
            ("settings.search.repeated", numbers.search.repeated or ()),
        ):
            for name in ids:
                check_choice(where, name, CAUSES, ArgumentError)
    return numbers
