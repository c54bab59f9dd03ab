"""Every exception that tissuereg raises on purpose, and its named warnings.

Every message says what must hold, what was found, and where. The command line prints an error as one paragraph and ends
with the exit code that the error's class states in `exit_code`. This module imports nothing.
"""


class TissueRegError(Exception):
    """Base of all errors raised on purpose; catch this for anything that is not a bug.

    Parameters
    ----------
    message : str
        Text that says what must hold, what was found, and where.
    where : str, optional
        The place alone, for programs that handle the error: a file, an argument, or a member of an ensemble. It becomes
        the attribute `where`, None if no place is known.
    **details
        Further values for programs that handle the error (indices, fractions); each becomes an attribute of its name.
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
    """The memory that a mesh needs exceeds the memory that the process may still take.

    Attributes
    ----------
    needed_bytes : int
        Estimate of the further memory that the work needs, in bytes.
    available_bytes : int
        Memory that the process may still take, in bytes.
    """

    exit_code = 3
    needed_bytes: int
    available_bytes: int


class UnitError(MeshError):
    """The lengths of a mesh or surface cannot be in mm: as such, its extent is too small or too large for a body."""


class SupportError(MeshError):
    """The body, or a loose part of it, can move as a rigid body, or held nodes or springs do not fit the mesh."""


class MaterialError(TissueRegError, ValueError):
    """A material parameter lies outside its admissible range."""


class LoadError(TissueRegError, ValueError):
    """A load is not finite or does not fit the body: its shape, place, number or order in time is wrong."""


class MarkerError(TissueRegError, ValueError):
    """Markers or targets (inner points of interest) cannot be used, for example because one is not finite."""


class SurfaceError(TissueRegError, ValueError):
    """Measured points of a surface cannot be used, for example because they are too few or not finite."""


class FormatError(TissueRegError, ValueError):
    """A file does not have the format or content that its name implies."""


class ExperimentError(FormatError):
    """An experiment folder or a recipe contains something impossible or unknown."""


class ModelError(TissueRegError, ValueError):
    """A trained model cannot be used: it is of another mesh, a file is missing or corrupt, or an argument bars it."""


class ScheduleError(TissueRegError, ValueError):
    """Inflation coefficients of an ES-MDA are not admissible, for example since their reciprocals do not sum to 1."""


class NoiseError(TissueRegError, ValueError):
    """A noise covariance is not positive definite, or a standard deviation not positive."""


class MissingPackageError(TissueRegError, ImportError):
    """An optional package is needed for the requested operation."""


class ClusterError(TissueRegError, RuntimeError):
    """Worker processes for tasks cannot be had, or are lost; running the same command again resumes the work."""

    exit_code = 3


class ConvergenceError(TissueRegError, RuntimeError):
    """A solve found no equilibrium, or a search no minimum.

    Attributes
    ----------
    report : dict
        Facts about the failure by name; empty where the raising function states none. A solve gives its last
        equilibrium as `load_fraction` (share of the load, 0 to 1) and `displacement` (n_nodes, 3), mm; the state where
        it ended as `tried_fraction` (share of the load), `residual_mN` and `tolerance_mN` (norm of the unbalanced
        forces, found and required), `min_det_f` (smallest determinant of a tet's deformation gradient F), `worst_tets`
        (pairs of a tet's index and its det F) and `reason` (text); and its work as the counts `iterations` and
        `factorisations`.
    """

    exit_code = 3
    report: "dict[str, object]" = {}  # noqa: RUF012  (a default for instances that carry none)


class EnsembleError(TissueRegError, RuntimeError):
    """Too few members of an ensemble survive.

    Attributes
    ----------
    dropped : list of (int, str)
        The index of each member that was lost, and the reason why; empty where the raising function lists none.
    """

    exit_code = 3
    dropped: "list[tuple[int, str]]" = []  # noqa: RUF012


class MeshingError(TissueRegError, RuntimeError):
    """A surface could not be filled with tetrahedra."""

    exit_code = 3


class ParityError(TissueRegError, RuntimeError):
    """A network exported to ONNX and the network from which it was exported give different outputs."""

    exit_code = 3


class UnitWarning(UserWarning):
    """A number is implausible in its unit, and plausible in another."""


class LostMarkerWarning(UserWarning):
    """A measured place is no measurement, such as 0, 0, 0 or an old pose: the marker counts as not seen."""


class LargeBodyWarning(UserWarning):
    """The memory that a mesh needs is more than half of the memory that the process may still take."""


class LockingWarning(UserWarning):
    """Four-node tets are used where they lock: displacements are too small on any affordable mesh."""
