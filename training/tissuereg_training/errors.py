"""Every exception that the training package raises on purpose.

Names, meaning and exit codes are those of the main package, so that a reader of the error JSON need not know
which of the two spoke. Message form: what must hold, what was found, where. Nothing here imports anything.
"""


class TissueRegError(Exception):
    """Base of all errors raised on purpose; catch this for anything that is not a bug.

    Parameters
    ----------
    message : str
        What must hold, what was found, where.
    where : str, optional
        The place alone (file, key, member), for machine readers.
    """

    exit_code = 2

    def __init__(self, message: str = "", *, where: "str | None" = None) -> None:
        super().__init__(message)
        self.where = where


class FormatError(TissueRegError, ValueError):
    """A file is not what its name or place promises."""


class ExperimentError(FormatError):
    """A recipe contains something impossible or unknown."""


class MeshError(TissueRegError, ValueError):
    """Data and mesh do not belong together, or the mesh cannot carry the network."""


class OutputError(TissueRegError, OSError):
    """The model cannot be written to the requested folder."""


class CheckpointError(TissueRegError, ValueError):
    """A checkpoint is missing, spoilt, or belongs to another run."""


class EnsembleError(TissueRegError, RuntimeError):
    """Too few members are left to train on."""

    exit_code = 3


class DivergenceError(TissueRegError, RuntimeError):
    """Training left the finite numbers."""

    exit_code = 3


class ParityError(TissueRegError, RuntimeError):
    """The exported network and its source disagree."""

    exit_code = 3
