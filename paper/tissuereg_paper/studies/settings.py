"""Settings of a registration in a study: method, C_d in both readings, N_e and N_a."""

from dataclasses import dataclass

#: mm^2 in a unit of C_d, by reading: the paper works in cm and states no unit of C_d.
READINGS = {"cm2": 100.0, "mm2": 1.0}

#: How a reading is written.
READING_WORDS = {"cm2": "cm²", "mm2": "mm²"}


@dataclass(frozen=True)
class Method:
    """A way to register a start mesh to markers.

    Attributes
    ----------
    name : str
        Of the method.
    prior : {"encoder", "family", "encoder-std"}
        The encoder's q(z | start mesh), the distribution of the codes of all training shapes, or q with its standard
        deviations in the place of variances.
    own_errors : bool
        Whether typical errors of the model's reconstruction are added to C_d and to the regions.
    balanced : bool
        Whether draws have exact sample moments, where the ensemble is large enough.
    words : str
        What it is, for tables.
    """

    name: str
    prior: str
    own_errors: bool
    balanced: bool
    words: str


#: The paper's Algorithm 1, with the encoder's own q as prior; the same with another prior; and that with balanced
#: draws and the model's own errors.
METHODS = (
    Method("paper", "encoder", False, False, "Algorithm 1, prior q(z | start mesh)"),
    Method("family", "family", False, False, "Algorithm 1, prior of all training codes"),
    Method("ours", "family", True, True, "prior of all training codes, balanced draws, C_d with the model's own error"),
)

#: A mistake of public code of the method: q's standard deviations are drawn from as if they were variances.
STD_AS_VARIANCE = Method(
    "paper-std", "encoder-std", False, False, "Algorithm 1, prior q with standard deviations taken for variances"
)


@dataclass(frozen=True)
class Setting:
    """One point of a sweep.

    Attributes
    ----------
    method : Method
        How.
    cd : float
        Variance C_d of a marker's component as the paper writes it.
    reading : {"cm2", "mm2"}
        The unit in which it is read.
    n_e, n_a : int
        Members and assimilations.
    """

    method: Method
    cd: float
    reading: str
    n_e: int
    n_a: int

    @property
    def cd_mm2(self) -> float:
        """C_d in mm^2."""
        return self.cd * READINGS[self.reading]

    @property
    def key(self) -> tuple[str, float, int, int]:
        """What is run: settings that read alike are run once."""
        return self.method.name, round(self.cd_mm2, 12), self.n_e, self.n_a
