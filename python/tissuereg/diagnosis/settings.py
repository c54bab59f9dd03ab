"""All numbers that may change a diagnosis: gates, levels, prior deviations and steps, each with unit and reason.

`DiagnoseSettings` is passed to `diagnose` and written whole into its answer. What belongs to one cause stands in its
class (`causes`): a changed cause is passed in `DiagnoseSettings.causes`.
"""

from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from math import log
from typing import TYPE_CHECKING, Any, cast

from tissuereg._base.arguments import of_kind, real

if TYPE_CHECKING:
    from tissuereg.diagnosis.causes import Cause


@dataclass(frozen=True)
class ModelSettings:
    """The believed model: its solutions, derivatives and fine meshes."""

    #: Default prior deviation of the modulus, over its mean.
    young_spread: float = 0.3
    #: Residual over load on the user's mesh. The error is some 1e-6 mm and 1e-3 mN, 1e-4 mm at most: far below noise.
    tolerance: float = 1e-5
    #: Number of solutions that are kept for models that differ in the tracker alone.
    most_solved: int = 4
    #: Tangents of bodies up to this many nodes stay in memory; of larger bodies only the last one does.
    kept_up_to_nodes: int = 8000
    #: Step of finite differences by the shape, over the mesh's shortest edge.
    shape_step: float = 1e-5
    #: Number of fine meshes in addition to the one that corrects.
    thirds: int = 3
    #: Whether predictions on the user's mesh are corrected for their discretisation error.
    corrected: bool = True
    #: Hypotheses that change a number by more than this many times the largest believed one are left out.
    largest_change: float = 1e6
    #: Nats that the correction of a fit's discretisation error may add to its log evidence, at most.
    correction_gain: float = 30.0
    #: Discretisation error, in noise deviations, that may remain uncorrected in a fit.
    uncorrected: float = 1.0
    #: Number of corrections of one fit, at most: friction needs six.
    most_corrections: int = 6


@dataclass(frozen=True)
class NoiseSettings:
    """Estimation of the noise from rest frames and holds."""

    #: Level of the test of the stated standard deviations against rest frames.
    level: float = 1e-3
    #: Least estimate of the noise, as a share of the stated one: rest frames may be simulated and without noise.
    least_share: float = 0.1
    #: Least number of frames for an estimate.
    least_frames: int = 6
    #: Least number of frames in a hold that is used.
    least_hold: int = 4
    #: Frames count as correlated beyond this many standard errors of the correlation of white noise.
    correlated: float = 4.0
    #: How far a rightly stated standard deviation may be off: deviation of its logarithm.
    spread: float = 0.05
    #: Largest factor by which a standard deviation may be understated.
    largest_factor: float = 100.0
    #: Least factor, and least evidence for it, nats, of understated noise.
    least_factor: float = 1.25
    least_evidence: float = 6.0
    #: Least degrees of freedom of a marker, or of all forces, that count for it.
    least_freedom: float = 6.0

    def __post_init__(self) -> None:
        for name in ("spread", "least_factor", "least_freedom"):
            real(f"noise.{name}", getattr(self, name), above=0.0)
        real("noise.largest_factor", self.largest_factor, above=1.0)


@dataclass(frozen=True)
class NuisanceSettings:
    """Prior deviations of the nuisance parameters that are not shape."""

    #: Prior deviations of the tracker's frame: shift in mm, turn in degrees.
    frame_shift: float = 0.02
    frame_turn: float = 0.02
    #: Prior deviation of the drift of the camera over the whole session, mm.
    drift: float = 0.02
    #: Remaining discretisation error of the corrected markers, as a share of the difference between fine meshes.
    mesh_share: float = 0.4
    #: The same for forces, whose difference between meshes is in large part due to the shape of the pads.
    force_share: float = 0.2
    #: Least relative error of forces.
    force_left: float = 0.0015
    #: Relative error of forces that is quadratic in the force, as a share of the largest force: strains at the rim of a
    #: pad, where they are singular, grow faster than the load.
    force_bent: float = 0.007
    #: The same of all forces alike: a mesh resolves all rims alike, and stiffens there.
    force_bent_alike: float = 0.02
    #: Whether the error of mesh and shape is a nuisance.
    of_mesh: bool = True
    #: Error of a found cause's form and of its correction, as a share of the change it makes.
    effect_error: float = 0.07
    #: Error of a found cause's form along its other hypotheses, as a share of its change.
    form_error: float = 0.3
    #: Hypotheses count as forms that reproduce this share of the change, in squares.
    form_alike: float = 0.5
    #: Number of directions of other forms that are kept.
    most_forms: int = 12
    #: Number of smooth patterns over the markers.
    patterns: int = 10
    #: Correlation length of the patterns' Gaussian process, over the extent of the body.
    pattern_length: float = 0.35


@dataclass(frozen=True)
class ShapeSettings:
    """Default prior deviations of the shape of a body and of its patches."""

    #: Of a patch's place and its rim's waves, over its radius.
    place_share: float = 0.03
    #: Of a patch's radius, over it.
    size_share: float = 0.01
    #: Of where the edge of a patch lies that is given by nodes, over the length of the mesh's edges there: between what
    #: the size of pads asks for and what their rims do, on foreign rigs without an effect (`benchmarks/rigs`).
    edge_share: float = 0.12
    #: A patch given by a ball is as large, in another solver, as the nodes in it make it. The number of nodes of a
    #: lattice in a disc deviates by this times the root of its radius over their distance.
    lattice: float = 0.68
    #: Its mesh is taken to be this many times as fine.
    finer: float = 2.0
    #: Of a patch's height, over its radius.
    height_share: float = 0.02
    #: Deviation of the height of a tilted patch's edge, over the deviation of the patch's height.
    tilt_share: float = 0.5
    #: Numbers of periods of a rim's wave around its patch. One period would be a shift.
    waves: tuple[int, ...] = (2, 3)
    #: Distance over which the mesh around a patch moves with it, over the patch's radius.
    reach: float = 0.6
    #: A patch whose unit normals have a mean below this surrounds the body, and has no plane to be shifted in.
    round_below: float = 0.3
    #: Default correlation length of the surface's offset, over the extent of the body.
    length_share: float = 0.2
    #: Share of the variance of the surface's offset that the patterns kept represent.
    held_variance: float = 0.9
    #: Number of patterns of the surface's offset, at most.
    most_patterns: int = 40
    #: Number of places from which these are computed, at most.
    most_places: int = 1500


@dataclass(frozen=True)
class NullSettings:
    """Draws of data without any effect, thresholds from them, and the test of the residual."""

    #: Number of draws.
    draws: int = 500
    #: Share of the draws in which any cause may pass its threshold (false-alarm rate).
    level: float = 0.02
    #: Number of false-alarm rates of a single cause that are tried.
    shares: int = 40
    #: Least threshold, nats.
    least_threshold: float = 6.0
    #: Threshold of every cause, nats, in place of that of the draws, for a fit that is told its cause.
    required: float | None = None
    #: Whether the draws are of noise alone, without nuisances and mesh errors.
    noise_alone: bool = False
    #: Relative uncertainty of the noise's size, as a whole and marker by marker.
    noise_spread: float = 0.03
    marker_spread: float = 0.05
    #: Discretisation errors are drawn larger or smaller than computed, by this factor at most.
    mesh_spread: float = 1.3
    #: Number of patterns over the markers in a smooth subspace of the misfit test, the smoothest ones.
    smooth: int = 3
    #: Level of the misfit test: a residual with a smaller p-value is a misfit.
    misfit: float = 0.01
    #: Findings with a misfit are named only if they explain this share of the believed model's misfit.
    explained: float = 0.5


@dataclass(frozen=True)
class ConstancySettings:
    """The test whether the change that a cause makes is the same in all parts of the data."""

    #: Level of the test: findings with a smaller p-value are withdrawn; 0 withdraws none. Chosen on half of the blind
    #: bench, where 0.01 to 0.001 withdraw nearly as many wrong names, and 0.001 the fewest right ones.
    level: float = 0.001
    #: Level of the test whether the data hold a cause itself: with a smaller p-value its family alone is stated. So is
    #: that of five in a hundred true causes.
    member_level: float = 0.05
    #: Sizes of inconstant changes that are tried, in noise deviations.
    sizes: tuple[float, ...] = (2.0, 5.0, 15.0)
    #: A true cause may be off in its form by this share of its change, in any part of the data.
    form_error: float = 0.03
    #: Commands below this share of a case's largest are no load.
    least_load: float = 0.02
    #: Changes in a part of the data count if they exceed this share of the whole change.
    least_change: float = 0.05
    #: Directions count whose singular value exceeds this share of the largest.
    least_direction: float = 0.05


@dataclass(frozen=True)
class OutsideSettings:
    """Effects outside the catalogue that a finding must beat."""

    #: Sizes of each kind that are tried: deviation of the modulus over it, stiffness that holds a place over modulus
    #: times extent of the body, linear strain of a place that grows, motion of a pad over its command.
    variations: tuple[float, ...] = (0.25, 0.5, 1.0)
    holds: tuple[float, ...] = (0.1, 0.3, 1.0)
    strains: tuple[float, ...] = (0.01, 0.03, 0.1)
    motions: tuple[float, ...] = (0.02, 0.06, 0.2)
    #: Lengths over which the modulus varies, over the extent of the body.
    lengths: tuple[float, ...] = (0.15, 0.3, 0.7)
    #: Share of the variance that the patterns of a modulus represent, their number at most, and the number of places
    #: from which they are computed, at most.
    held_variance: float = 0.99
    most_patterns: int = 150
    most_places: int = 700
    #: Radii of places that are held or grow, over the extent of the body, and spacing of their grid over the radius.
    radii: tuple[float, ...] = (0.07, 0.13)
    spacing: float = 1.5
    #: A finding whose share of the probability is less, but with effects of its family is as probable as `stated`, is
    #: stated as the family alone down to this share.
    least_share: float = 0.05

    def sizes(self, kind: str) -> tuple[float, ...]:
        """Return the sizes of a kind."""
        return {
            "stiffness-field": self.variations,
            "held-place": self.holds,
            "growing-place": self.strains,
            "pad-motion": self.motions,
        }[kind]


@dataclass(frozen=True)
class ProbabilitySettings:
    """From evidence to probabilities."""

    #: Log Bayes factors are divided by this first, because the models of mesh error and noise are not exact.
    temper: float = 2.0
    #: Share of a cause's probability that is assigned to effects outside the catalogue that look like it, which no
    #: evidence can distinguish: of 159 findings with a probability above 0.8 on the blind bench seven were such.
    look_alike: float = 0.04
    #: Sizes of the generic rival: of marker patterns in noise deviations, and of forces as a share of the largest.
    generic_sizes: tuple[tuple[float, float], ...] = ((0.7, 0.003), (2.0, 0.01), (6.0, 0.03), (20.0, 0.15))
    #: Prior deviation of a jammed frame, as a share of the motion since the frame before.
    jam: float = 0.5
    #: A frame may be jammed where a marker moves by more than this many noise deviations since the frame before.
    jam_above: float = 3.0
    #: Time in which the load's memory fades, over the duration of a case: of the generic rival and the misfit test.
    fading: float = 0.25


@dataclass(frozen=True)
class FitSettings:
    """The nonlinear fit."""

    #: Iterations at most.
    most_iterations: int = 12
    #: Decrease of the objective, nats, below which a step counts as no progress.
    least_gain: float = 0.2
    #: Predicted decrease, nats, below which a step is not tried; it would move no parameter by more than a fifth of its
    #: deviation.
    least_predicted: float = 0.02
    #: The iterations that remain are expected to gain at most this many times the last gain, all together.
    further_gains: int = 3
    #: A step whose gain is that predicted, within this share, shows that its Jacobian is right.
    as_expected: float = 0.5
    #: Nats by which the evidence may be off where the Jacobian is in part that of a similar model (0.1 in examples).
    borrowed: float = 2.0
    #: Shares of a step that the line search tries.
    shares: tuple[float, ...] = (1.0, 0.4, 0.15, 0.05)
    #: A step moves no parameter by more than this many prior deviations.
    longest: float = 1.5


@dataclass(frozen=True)
class SearchSettings:
    """Which causes are fitted, accepted, grouped and stated."""

    #: Number of causes in an answer, at most.
    most_causes: int = 3
    #: Causes that are fitted: this many, and all within so many nats of the best.
    refitted: int = 4
    within: float = 10.0
    #: Linear evidence that a cause needs to be fitted, as a share of its threshold: as first and as a further cause.
    likely: float = 0.4
    likely_further: float = 0.5
    #: Ids that may be found more than once; None: those whose effects are repeatable.
    repeated: tuple[str, ...] | None = None
    #: Whether a cause must be proved on held-out data.
    judged: bool = True
    #: Gain in log predictive density that the held-out proof requires, nats, but not more than this share of true
    #: causes, of the size and in the place that were fitted, would fall short of in these data.
    proved: float = 4.0
    refused: float = 0.1
    #: A case is held out in a proof only if the other data determine the cause's parameters: their posterior variance
    #: without the case is at most this share of the prior variance, on average.
    determined: float = 0.5
    #: Errors are stated for a case only if the other data determine the cause's change in it: the predictive variance
    #: of the change is at most this share of its square.
    undetermined: float = 0.75
    #: Number of blocks of frames, where one case alone shows a cause.
    time_blocks: int = 4
    #: A cause is stated where it, or the group that the data cannot distinguish from it, is at least this probable.
    stated: float = 0.5
    #: Least separability of two causes that the data distinguish: the norm of the difference between their predictions
    #: in noise deviations. The log evidence then differs by half its square.
    separable: float = 4.0
    #: Number of ids in a group, at most.
    most_in_group: int = 3
    #: A cause within the separability of the one found is in its group if it passes the threshold too, or if its
    #: probability is at least this share of the other's.
    as_likely: float = 0.1
    #: Rivals that are tried in place of one of several causes: their number, and nats within which they come to it.
    most_rivals: int = 2
    rivals_within: float = 40.0
    #: Gain in log evidence, nats, that an exchange requires.
    better: float = 2.0
    #: The modulus is a finding beyond this many prior deviations.
    far_modulus: float = 3.0
    #: And only if its posterior deviation is at most this share of the prior's.
    determined_modulus: float = 0.3
    #: The fitted modulus is in the extended model where its posterior deviation is below this share of the prior's.
    known_modulus: float = 0.5


@dataclass(frozen=True)
class RecordingSettings:
    """How recordings are weighed against the believed model; shares of lengths are of the body's extent."""

    #: Frames of a case that are used, at most: readings differ in all of them alike.
    frames: int = 12
    #: Markers that count, at most: what the model gets wrong is alike in neighbours.
    markers: int = 5
    #: Commands by which the response is computed: of a displacement as a share of the extent, of a force as a share of
    #: modulus times squared extent. Small enough to be linear, and far above the solver's tolerance.
    motion: float = 1e-3
    force: float = 1e-4
    #: Residual over load of these solutions.
    tolerance: float = 1e-6
    #: Errors of the believed model, as shares of the prediction: from a good model to one without any relation.
    errors: tuple[float, ...] = (0.05, 0.1, 0.2, 0.4, 0.8)
    #: Least prior standard deviation of the modulus' logarithm.
    modulus_std: float = 0.3
    #: Moduli that are tried, evenly within so many standard deviations about their mean.
    n_moduli: int = 33
    moduli_within: float = 4.0
    #: How far places may be off without a command, as a share.
    places: float = 0.02
    #: Largest penalty for places, nats: beyond, they are wrong for another reason.
    most_nats: float = 30.0
    #: Share of the squares beyond the noise that a reading must explain in every channel it changes.
    explained: float = 0.5
    #: A pad is silent where the believed model predicts `loud` times the noise (rms) and no more than `quiet` times is
    #: measured.
    loud: float = 10.0
    quiet: float = 2.0
    #: Share of the prediction under another reading below which nothing is predicted as given.
    nothing: float = 1e-6
    #: Odds are stated up to this power of ten.
    most_digits: int = 9


@dataclass(frozen=True)
class AdviceSettings:
    """What is described of the residual, and which experiments are advised."""

    #: Number of load cases below which a verdict is provisional: a held-out case is then not predicted from two others.
    least_cases: int = 3
    #: Number of markers, and of markers and pads, that are listed at most.
    most_markers: int = 5
    most_places: int = 5
    #: Least root mean square, in noise deviations, of those that are listed.
    above: float = 1.3
    #: Least log Bayes factor, nats, with which the residual resembles a cause of the catalogue.
    looks_like: float = 6.0
    #: Width of the Gaussian weights of a component by which a residual is localised, over the body's extent.
    reach: float = 0.15
    #: A measured number belongs to a component where its weight exceeds this.
    near: float = 0.5
    #: Variances of a component that are tried: the least, the largest (noise variances), and their number.
    variances: tuple[float, float, int] = (0.01, 1e6, 49)
    #: Assumed noise of a force where none has been measured yet, mN.
    measured_to: float = 5.0
    #: Durations, s, of the ramp, the hold, and the long hold of a stock case.
    ramp_s: float = 2.0
    hold_s: float = 6.0
    long_hold_s: float = 30.0


@dataclass(frozen=True)
class MaterialSettings:
    """Material tests, where stresses along curves are compared."""

    #: Number of rows of all curves together, at most; more would only repeat the same correlated errors.
    most_rows: int = 320
    #: Default standard deviation of the logarithm of the modulus, and the one it has as a cause.
    young_spread: float = 0.3
    wide_young: float = 1.5
    #: Spread of Ogden's exponents about 0, and the largest: rubber has some -5 to 10, brain -20.
    alpha_spread: float = 15.0
    largest_alpha: float = 80.0
    #: Number of Prony terms of a relaxation, at most.
    most_terms: int = 3
    #: Least noise of a stress over the curve's peak, typical of load cells and digitised plots.
    least_noise: float = 1e-3
    #: Typical values where no curves are repeated: correlated error along a curve over its stress, and standard
    #: deviation of a specimen's factor. They count as so many repeats in addition to measured ones.
    usual_along: float = 0.02
    usual_factor: float = 0.05
    prior_repeats: float = 1.0
    #: Correlation length of the error along a curve, in progress along the load history.
    along_length: float = 0.25
    #: Share of that error's variance which is uncorrelated between rows: corners of a path, and other rough errors.
    rough: float = 0.2
    #: Sizes of a generic misfit over the stress.
    misfit_shares: tuple[float, ...] = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
    #: Correlation lengths of a generic misfit: strain over the largest, progress (long and short), decades of rate.
    misfit_strain: float = 0.5
    misfit_arc: float = 0.25
    misfit_short_arc: float = 0.06
    misfit_rate: float = 1.0
    #: Prior probability that there is no generic misfit beside the causes; the rest is divided among its sizes.
    no_misfit: float = 0.5
    #: Log evidence that a form must gain over one with fewer parameters, nats.
    simpler: float = 3.0
    #: Whitened residual where a law has no stress.
    no_stress: float = 1e4
    #: Step of finite differences over the prior standard deviation.
    step: float = 1e-4
    #: Least threshold, nats.
    least_threshold: float = 5.0
    #: Quantile of null experiments that the threshold is, and the number of these experiments.
    quantile: float = 0.99
    thresholds_from: int = 400
    #: Number of residuals of noise alone in the test of the residual.
    misfits_from: int = 500
    #: Relative uncertainty of the white noise, which is estimated from some tens of rows.
    noise_spread: float = 0.15
    #: Further causes need so many times the threshold where no curve is repeated: the noise is then an assumption.
    further: float = 4.0
    #: Specimens are divided into so many folds at most.
    most_folds: int = 4
    #: Progress along the load history up to which a single curve is fitted; the rest is predicted.
    part: float = 0.8
    #: Rates with a ratio below this are held out together, because one would predict the other.
    same_rate: float = 1.5
    #: Required share of the generic patch's gain where specimens or rates are held out: the patch then copies other
    #: curves.
    share_of_patch: float = 0.75
    #: A cause that removes this share of the misfit on held-out data may predict one fold worse.
    most_of_misfit: float = 0.5
    #: Share of the misfit that findings must explain where a misfit remains.
    explained: float = 0.8
    #: Noise of a row over the peak of its curve, where all rows of a curve have equal weights.
    rows_alike: float = 0.01
    #: Share by which a form with more parameters, or other weights, must lower the error.
    worth: float = 0.1
    #: Number of rows of an advised test.
    advised_rows: int = 40


@dataclass(frozen=True)
class DiagnoseSettings:
    """Every number that may change a diagnosis, with its default; their units and reasons stand beside them.

    Attributes
    ----------
    model, noise, nuisances, shape, nulls, constancy, outside, evidence, fit, search, readings, report, material
        Settings of each step, a frozen dataclass each: ``replace(settings, search=SearchSettings(most_causes=1))``.
    causes : tuple of Cause
        Causes of bodies with changed numbers, in place of those of the catalogue with the same id.
    left_out : tuple of str
        Ids of the catalogue that are not tried.
    """

    model: ModelSettings = field(default_factory=ModelSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    nuisances: NuisanceSettings = field(default_factory=NuisanceSettings)
    shape: ShapeSettings = field(default_factory=ShapeSettings)
    nulls: NullSettings = field(default_factory=NullSettings)
    constancy: ConstancySettings = field(default_factory=ConstancySettings)
    outside: OutsideSettings = field(default_factory=OutsideSettings)
    evidence: ProbabilitySettings = field(default_factory=ProbabilitySettings)
    fit: FitSettings = field(default_factory=FitSettings)
    search: SearchSettings = field(default_factory=SearchSettings)
    readings: RecordingSettings = field(default_factory=RecordingSettings)
    report: AdviceSettings = field(default_factory=AdviceSettings)
    material: MaterialSettings = field(default_factory=MaterialSettings)
    causes: "tuple[Cause, ...]" = ()
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for one in fields(self):
            if one.default_factory is not MISSING:
                of_kind(one.name, getattr(self, one.name), cast("type[Any]", one.default_factory))

    @property
    def as_likely_within(self) -> float:
        """Nats by which a cause may fall behind another and still be `as_likely`."""
        return -self.evidence.temper * log(self.search.as_likely)

    def to_json(self, catalogue: "Mapping[str, Cause]") -> dict[str, Any]:
        """Return all settings as plain data, those of the causes of a catalogue, by id, included."""
        numbers = {one.id: {f.name: getattr(one, f.name) for f in fields(one)} for one in catalogue.values()}
        groups = {f.name: asdict(getattr(self, f.name)) for f in fields(self) if f.name not in ("causes", "left_out")}
        return {
            **groups,
            "causes": {name: own for name, own in numbers.items() if own},
            "left_out": list(self.left_out),
        }


#: The settings of a diagnosis where none are given.
DEFAULT = DiagnoseSettings()
