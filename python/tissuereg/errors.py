"""Every exception that tissuereg raises on purpose, and its named warnings.

Message form: what must hold, what was found, where. The command line turns an error into one
paragraph and the exit code its class states; nothing here imports anything.
"""


class TissueRegError(Exception):
    """Base of all errors raised on purpose; catch this for anything that is not a bug.

    Parameters
    ----------
    message : str
        What must hold, what was found, where.
    where : str, optional
        The place alone (file, argument, member), for programs.
    **details
        Values for programs (indices, fractions); they become attributes.
    """

    exit_code = 2

    def __init__(self, message: str = "", *, where: "str | None" = None, **details: object) -> None:
        super().__init__(message)
        self.where = where
        for name, value in details.items():
            setattr(self, name, value)


class ShapeError(TissueRegError, ValueError):
    """An array has the wrong shape, dtype or memory order."""


class ArgumentError(TissueRegError, ValueError):
    """An argument has the wrong type, or is out of its range."""


class MeshError(TissueRegError, ValueError):
    """A mesh cannot carry a simulation: degenerate, inverted, out of range or not finite."""


class LargeBodyError(MeshError):
    """What a mesh needs would not fit into the memory that the process may take.

    Attributes
    ----------
    needed_bytes, available_bytes : int
        Further memory that is estimated, and what there is.
    """

    exit_code = 3
    needed_bytes: int
    available_bytes: int


class UnitError(MeshError):
    """Lengths cannot be millimetres."""


class SupportError(MeshError):
    """The body, or a loose part of it, can move without deforming."""


class MaterialError(TissueRegError, ValueError):
    """A material parameter lies outside its admissible range."""


class LoadError(TissueRegError, ValueError):
    """A load is not finite or does not fit the body."""


class MarkerError(TissueRegError, ValueError):
    """Markers or targets cannot be used."""


class SurfaceError(TissueRegError, ValueError):
    """Points of a surface cannot be used."""


class FormatError(TissueRegError, ValueError):
    """A file does not have the format or content that its name implies."""


class ExperimentError(FormatError):
    """An experiment folder or a recipe contains something impossible or unknown."""


class ModelError(TissueRegError, ValueError):
    """A trained model cannot be used: another mesh, a missing or corrupt file."""


class ScheduleError(TissueRegError, ValueError):
    """Inflation coefficients of an ES-MDA are not admissible."""


class NoiseError(TissueRegError, ValueError):
    """A noise covariance is not positive definite, or a standard deviation not positive."""


class MissingPackageError(TissueRegError, ImportError):
    """An optional package is needed for the requested operation."""


class ClusterError(TissueRegError, RuntimeError):
    """Workers for tasks cannot be had, or are lost; running the same command again resumes."""

    exit_code = 3


class ConvergenceError(TissueRegError, RuntimeError):
    """A solve found no equilibrium, or a search no minimum.

    Attributes
    ----------
    report : dict
        The last equilibrium found: `load_fraction` and `displacement` (n_nodes, 3), mm. Where the search ended:
        `tried_fraction`, `residual_mN`, `tolerance_mN`, `min_det_f`, `worst_tets`, `reason`. Work done: `iterations`,
        `factorisations`. Of a search by Gauss-Newton: `evaluations`, `last_step` and `tolerance`.
    """

    exit_code = 3
    report: "dict[str, object]" = {}  # noqa: RUF012  (a default for instances that carry none)


class EnsembleError(TissueRegError, RuntimeError):
    """Too few ensemble members survive.

    Attributes
    ----------
    dropped : list of (int, str)
        Members that were lost, each with its reason.
    """

    exit_code = 3
    dropped: "list[tuple[int, str]]" = []  # noqa: RUF012


class MeshingError(TissueRegError, RuntimeError):
    """A surface could not be filled with tetrahedra."""

    exit_code = 3


class ParityError(TissueRegError, RuntimeError):
    """An exported network and its source disagree."""

    exit_code = 3


class UnitWarning(UserWarning):
    """A number is implausible in its unit, and plausible in another."""


class LargeBodyWarning(UserWarning):
    """What a mesh needs would take more than half of the memory that the process may take."""


class LockingWarning(UserWarning):
    """Four-node tets are used where they lock: displacements are too small on any affordable mesh."""
