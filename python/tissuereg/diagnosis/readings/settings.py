"""Numbers that decide whether a recording is misread, each with its unit and its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class RecordingSettings:
    """How recordings are weighed against the believed model; shares of lengths are of the body's extent.

    Attributes
    ----------
    frames : int
        Frames of a case that are used, at most: readings differ in all of them alike.
    markers : int
        Markers that count, at most: what the model gets wrong is alike in neighbours.
    motion, force : float
        Commands by which the response is computed: of a displacement as a share of the extent, of a force as a share of
        modulus times squared extent. Small enough to be linear, and far above the solver's tolerance.
    tolerance : float
        Residual over load of these solutions.
    errors : tuple of float
        Errors of the believed model, as shares of the prediction: from a good model to one without any relation.
    modulus_std : float
        Least prior standard deviation of the modulus' logarithm.
    n_moduli, moduli_within : int, float
        Moduli that are tried, evenly within so many standard deviations about their mean.
    places : float
        How far places may be off without a command, as a share.
    most_nats : float
        Largest penalty for places, nats: beyond, they are wrong for another reason.
    explained : float
        Share of the squares beyond the noise that a reading must explain in every channel it changes.
    loud, quiet : float
        A pad is silent where the believed model predicts `loud` times the noise (rms) and no more than `quiet` times is
        measured.
    nothing : float
        Share of the prediction under another reading below which nothing is predicted as given.
    most_digits : int
        Odds are stated up to this power of ten.
    """

    frames: int = 12
    markers: int = 5
    motion: float = 1e-3
    force: float = 1e-4
    tolerance: float = 1e-6
    errors: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4, 0.8)
    modulus_std: float = 0.3
    n_moduli: int = 33
    moduli_within: float = 4.0
    places: float = 0.02
    most_nats: float = 30.0
    explained: float = 0.5
    loud: float = 10.0
    quiet: float = 2.0
    nothing: float = 1e-6
    most_digits: int = 9


RECORDINGS = RecordingSettings()
