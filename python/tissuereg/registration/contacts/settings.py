"""Prior of contacts, how the posterior is sampled, and how the search for it goes on.

`ContactSettings` is what a call may set. Below it stand the numbers that no call sets: how a body is made discrete, how
observations are matched and projected, and what is kept in memory.
"""

from dataclasses import dataclass, fields
from typing import Any

from tissuereg._base.arguments import each, of_kind, real, whole
from tissuereg.errors import ArgumentError


class _Numbers:
    """Base class of settings, which checks that each field has the type of its default value and is not negative.

    A default is a count, a number, a pair of numbers, a list of numbers, or another record of settings. Raises
    `ArgumentError` for another type or a negative number.
    """

    def __post_init__(self) -> None:
        for one in fields(self):  # type: ignore[arg-type]
            value, usual = getattr(self, one.name), one.default
            if isinstance(usual, _Numbers):
                of_kind(one.name, value, type(usual))
            elif isinstance(usual, int):
                whole(one.name, value)
            elif isinstance(usual, float):
                real(one.name, value, least=0.0)
            else:
                _numbers(one.name, value, n_numbers=2 if "tuple[float, float]" in str(one.type) else None)


def _numbers(name: str, value: Any, n_numbers: int | None) -> None:
    numbers = each(name, value, (int, float))
    if not numbers or len(numbers) != (n_numbers or len(numbers)):
        message = f"`{name}` must be a list of {n_numbers or 'one or more'} numbers, got {len(numbers)}"
        raise ArgumentError(message, where=name)
    for number in numbers:
        real(name, number, least=0.0)


@dataclass(frozen=True)
class PassSettings(_Numbers):
    """When a step of the search is accepted, and when the search ends.

    A pass is one round of linearising, sampling and solving; its step leads from the present load to the posterior
    mean.

    Parameters
    ----------
    shortest : float
        Shortest part of a step that is tried, as a share of the whole; a step that fails is halved.
    most_iterations : int
        A load that takes more iterations of the solver is abandoned: a shorter step costs less.
    decrease : float
        A part s of a step, 0 to 1, is accepted if it reduces the residual by at least s times this share.
    good_enough : float
        A step is also accepted if the residual after it is below this many times `fit_limit`.
    decrease_unmatched : float
        Value in place of `decrease` where points without labels are matched anew: the first steps gain least.
    shortest_unmatched : float
        In that case a step is halved down to this share only, once it has an equilibrium, and is then accepted if it
        reduces the residual at all.
    as_predicted : float
        A step ended as predicted, so that no linearisation at its end is needed, if its root mean square residual
        exceeds the predicted one by no more than this, in standard deviations.
    as_predicted_on : float
        The same for a moment that goes on from the one before: the tangent is then renewed beside the next moments.
    renew_at, renewed_needs : int
        A tangent is renewed once moments have lost so many iterations of the solver by it, about as long as a new one
        takes; those with a new one take the second number each.
    renewed_after, renewed_unknowns : int
        Number of moments after which a tangent that is being renewed is used, for a body of so many unknowns at most;
        twice as many for up to twice the unknowns, and so on: a factorisation then takes more moments.
    settled : float
        Matches of points have settled if a pass reduces the residual by less than this share.
    least_rough : int
        Smallest number of passes with few points, while the residual of the points is above `fit_limit`.
    marker_passes : int
        Largest number of passes with markers alone, if there are markers as well as points: labels bring the body
        close.
    coarse_passes, fine_passes : int
        Largest number of passes with few points, and then with all of them.
    widths : tuple of float
        Distances, as shares of the extent, within which errors of first matches are taken for correlated. The search is
        repeated with the next one while too many points are outliers.
    most_outliers : float
        Share of the points, as outliers, above which the search is repeated with the next of `widths`.
    unmet : float
        The fit is repeated without the believed load if its root mean square residual, in standard deviations, is not
        below this.
    much_less : float
        The believed load is then left out if the residual without it is less than this share of that with it.
    much_more : float
        A search that continues from an earlier moment is given up if it leaves more than this many times the residual
        of that moment.
    """

    shortest: float = 0.02
    most_iterations: int = 150
    decrease: float = 0.3
    good_enough: float = 1.5
    decrease_unmatched: float = 0.01
    shortest_unmatched: float = 0.2
    as_predicted: float = 0.2
    as_predicted_on: float = 1.0
    renew_at: int = 80
    renewed_needs: int = 4
    renewed_after: int = 2
    renewed_unknowns: int = 20_000
    settled: float = 0.05
    least_rough: int = 4
    marker_passes: int = 2
    coarse_passes: int = 8
    fine_passes: int = 5
    widths: tuple[float, ...] = (0.12, 0.2)
    most_outliers: float = 0.13
    unmet: float = 3.0
    much_less: float = 0.5
    much_more: float = 1.5


@dataclass(frozen=True)
class EvidenceSettings(_Numbers):
    """How the evidence of supports and of the noise is maximised.

    Parameters
    ----------
    sizes_mm : tuple of float
        Smallest and largest candidate size of contacts, mm: from below any tracker's noise to beyond any motion.
    sizes_a_decade : int
        Number of candidate sizes per factor of ten.
    rounds : int
        Largest number of rounds in which the sizes of all causes are varied in turn.
    least_gain : float
        The rounds end when one of them raises the log evidence by less than this.
    every : int
        Where moments follow each other, noise and supports are tested at every one of so many; others keep the verdict.
    many : int
        From this number of observations on, markers speak against the stated noise if larger noise is more probable at
        all: where it is as stated, that many are far from saying so.
    """

    sizes_mm: tuple[float, float] = (0.01, 100.0)
    sizes_a_decade: int = 4
    rounds: int = 3
    least_gain: float = 1e-3
    every: int = 10
    many: int = 24


@dataclass(frozen=True)
class ReportSettings(_Numbers):
    """Which parts of a fit are reported, and which observations are a reason not to trust it.

    Parameters
    ----------
    least_constrained : float
        A target is flagged if the markers remove less than this share, 0 to 1, of its variance under unseen contacts.
    wrong : float
        A marker that is wrong with at least this probability is dropped.
    least_probability : float
        Contacts less probable than this are not listed.
    most_contacts : int
        Largest number of contacts that are listed.
    most_off : float
        The surface points are said not to lie on the surface if their median distance exceeds this many times that
        expected from their noise.
    most_outliers : float
        Share of surface points, as outliers, above which they are said to belong to something else.
    most_unexplained : float
        Size of a displacement that no load explains, over the motion of what was measured, above which it is a reason
        not to trust the result.
    most_slope : float
        The same for the change of the logarithm of the stiffness from the middle of the body to its end.
    """

    least_constrained: float = 0.8
    wrong: float = 0.5
    least_probability: float = 0.2
    most_contacts: int = 4
    most_off: float = 2.0
    most_outliers: float = 0.3
    most_unexplained: float = 0.2
    most_slope: float = 1.0


@dataclass(frozen=True)
class ContactSettings(_Numbers):
    """Prior of contacts, noise of the model, and Markov chains.

    Lengths are given over the extent of the body. A pair of numbers is a log-normal prior of a standard deviation: its
    median, and the standard deviation of its logarithm.

    Parameters
    ----------
    n_slots : int
        Largest number of contacts.
    odds : float
        Prior odds that each of these contacts is there.
    sizes : tuple of float
        Candidate sizes of a contact: motion of its patch under this contact alone, over the body's extent.
    largest_share : float
        Sizes above this share of the patch's radius become unlikely.
    background : tuple of float
        Size of weak tractions on all patches together (the background), as the motion they cause over the body's
        extent: median, and standard deviation of its logarithm.
    weight : tuple of float
        Size of a body force, as the motion it causes over the body's extent: median, and standard deviation of its
        logarithm.
    believed : tuple of float
        Error of a believed load, over the load: median, and standard deviation of its logarithm.
    supports : tuple of float
        Size of tractions on doubtful supports, as the motion they cause over the body's extent: median, and standard
        deviation of its logarithm.
    support_stiffness : float
        Default stiffness of doubtful supports, in Young's modulus over the extent of the body.
    stiffness_tried : tuple of float
        Candidates for that stiffness, in the same unit, among which the evidence of the markers decides.
    support_log_std : float
        Standard deviation of the logarithm of their stiffness from place to place.
    frame : tuple of float
        Size of a rigid motion of a body that nothing surely holds, over its extent: median, and standard deviation of
        its logarithm.
    drift : tuple of float
        Size of a drift of the tracker relative to a body that is held, over the body's extent: median, and standard
        deviation of its logarithm; none with ``tracker="fixed"``.
    unexplained : tuple of float
        Size of a displacement that no load explains, over the root mean square motion of the markers: median, and
        standard deviation of its logarithm.
    wrong_odds : float
        Prior odds that a marker is wrong.
    wrong_share : float
        Additional standard deviation of a wrong marker, over the extent of the body.
    model_error : float
        Standard deviation of the model's error at a marker, over the marker's motion.
    local_error : float
        Standard deviation of a further error of the model, over the variation of the motion across the element under
        the marker; used in tests of residuals only.
    poisson_std : float
        Standard deviation of Poisson's ratio.
    stiffness, graded : tuple of float
        Change of the logarithm of the stiffness from the middle of the body to its end along each principal axis, where
        the stiffness is believed and where it is graded (``stiffness="graded"``): median of its size, and standard
        deviation of the size's logarithm.
    unseen_chance, unseen_share : float
        Probability of one more contact that no marker detects, and its size over its radius.
    n_chains : int
        Number of independent Markov chains.
    n_chains_first : int
        Number of chains in the first pass (round of linearising, sampling and solving), which need only come close.
    powers : tuple of float
        Power of the likelihood in each sweep of the first pass.
    powers_again : tuple of float
        Power of the likelihood in each sweep of later passes, which start from the previous samples.
    n_chains_on, powers_on : int, tuple of float
        The same where chains go on from the moment of measurement before, shortly ago.
    n_kept : int
        Number of final sweeps of each chain whose samples are kept.
    sharpness, n_local, n_level : float, int, int
        Power of the likelihood in the table from which jumps of a contact are drawn; steps to similar patches per
        contact and sweep; steps of the size of a group of causes per sweep (see ``tissuereg_contacts::ChainSettings``).
    max_passes : int
        Largest number of passes, each with one linearisation.
    fit_limit : float
        Passes end when the markers' root mean square residual, in standard deviations, is below this and near its
        prediction.
    promise_margin : float
        The residual is near its prediction if it exceeds that of the linear model by less than this, in standard
        deviations.
    n_draws : int
        Number of draws for the spread of nodes.
    most_exact : int
        Largest number of targets whose covariances are computed one by one; those of more are those of the nodes.
    background_share : float
        Standard deviation of the background on one patch, over that of all patches: neighbours overlap.
    steps : PassSettings
        When a step is accepted, and when the passes end.
    evidence : EvidenceSettings
        The search for the stiffness of supports.
    report : ReportSettings
        Which contacts are listed, which targets flagged and which markers dropped.
    """

    n_slots: int = 3
    odds: float = 0.8
    sizes: tuple[float, ...] = (0.0008, 0.0025, 0.008, 0.025, 0.08, 0.25)
    largest_share: float = 0.5
    background: tuple[float, float] = (0.00025, 1.0)
    weight: tuple[float, float] = (0.0008, 2.0)
    believed: tuple[float, float] = (0.5, 0.7)
    supports: tuple[float, float] = (0.0008, 1.5)
    support_stiffness: float = 100.0
    stiffness_tried: tuple[float, ...] = (0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0)
    support_log_std: float = 1.0
    frame: tuple[float, float] = (0.008, 1.5)
    drift: tuple[float, float] = (0.0007, 1.0)
    unexplained: tuple[float, float] = (0.03, 1.5)
    wrong_odds: float = 0.02
    wrong_share: float = 0.05
    model_error: float = 0.02
    local_error: float = 0.2
    poisson_std: float = 0.02
    stiffness: tuple[float, float] = (0.1, 0.5)
    graded: tuple[float, float] = (0.5, 0.5)
    unseen_chance: float = 0.03
    unseen_share: float = 0.25
    n_chains: int = 16
    n_chains_first: int = 8
    powers: tuple[float, ...] = (0.03, 0.1, 0.3, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    powers_again: tuple[float, ...] = (0.5, 1.0, 1.0, 1.0, 1.0, 1.0)
    n_chains_on: int = 8
    powers_on: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    n_kept: int = 4
    sharpness: float = 0.5
    n_local: int = 4
    n_level: int = 2
    max_passes: int = 8
    fit_limit: float = 1.3
    promise_margin: float = 0.4
    n_draws: int = 128
    most_exact: int = 400
    background_share: float = 0.55
    steps: PassSettings = PassSettings()
    evidence: EvidenceSettings = EvidenceSettings()
    report: ReportSettings = ReportSettings()


@dataclass(frozen=True)
class Discretisation:
    """How a body and the causes of its motion are made discrete.

    Attributes
    ----------
    radii_shares : tuple of float
        Radii of patches, as shares of the extent: 1.6 times each other, from a fingertip to a hand.
    least_edges : float
        Smallest radius over the mean edge of the surface: a patch must hold a few nodes.
    thinning : float
        Smallest distance of two centres of equal radius, as a share of the radius.
    least_cosine : float
        Nodes whose normal has a smaller cosine with the centre's are on the other side of a sheet: they do not belong
        to the patch, and do not exclude other centres.
    levels : tuple of float
        Candidate sizes of a family of causes, as logarithms relative to the median, in standard deviations.
    support_fields : int
        Largest number of smooth fields along which the stiffness of doubtful supports is uncertain.
    cells : int
        Number of cells of doubtful supports, by which springs of any stiffness are treated without a new factorisation.
    bed : float
        Stiffness of the bed around a free body, in Young's modulus over extent: too soft to hold it.
    unexplained_length : float
        Correlation length of a displacement that no load explains, over the extent of the body.
    held_places, rest_places : int
        Largest number of held nodes at which it is zero (smooth as it is, it is then nearly zero at all), and of nodes
        between the markers by which draws of it are made.
    jitter : float
        Variance added to the diagonal of its covariance before it is factored, over its own.
    tolerance : float
        Relative residual of an equilibrium that is linearised.
    tolerance_on : float
        The same of one that follows another moment's with its factor, over the relative change of the causes; at most
        this, where places are off by less than a hundredth of a usual tracker's noise.
    same_load : float
        Relative difference of two loads below which they are taken for the same.
    """

    radii_shares: tuple[float, ...] = (0.05, 0.083, 0.133, 0.208, 0.333)
    least_edges: float = 1.2
    thinning: float = 0.7
    least_cosine: float = 0.1
    levels: tuple[float, ...] = tuple(0.5 * half for half in range(-6, 7))
    support_fields: int = 12
    cells: int = 60
    bed: float = 0.1
    unexplained_length: float = 0.3
    held_places: int = 150
    rest_places: int = 200
    jitter: float = 1e-6
    tolerance: float = 3e-7
    tolerance_on: float = 1e-3
    same_load: float = 1e-9


@dataclass(frozen=True)
class Matching:
    """How observations are weighed, points matched to a surface, and many observations projected onto few.

    Attributes
    ----------
    tail : float
        Degrees of freedom of the heavy-tailed noise of observations that have no indicator of being wrong.
    most_plain : int
        Above this number of observations the sampler, whose cost is quadratic, receives a projection of them.
    least_signal : float
        Combinations of observations are dropped if the causes contribute less than this to their variance, over the
        noise.
    most_kept, most_kept_coarse : int
        Largest number of combinations that are kept, and in first passes, whose answer is rough.
    coarse_points : int
        Number of points in first passes (rounds of linearising, sampling and solving).
    alike_share : float
        Distance within which model errors are correlated, over the extent: points so close are not independent.
    least_cosine : float
        Edges whose two triangles have normals of a smaller cosine are edges of the body, not of the mesh.
    far : float
        A point is far from the surface beyond this many standard deviations of its noise.
    outlier : float
        A point is an outlier beyond this many standard deviations.
    closest : int
        Number of closest sample points of the surface whose triangles are tested exactly.
    rigid_points : int
        Number of points by which a free body is first moved onto its measured surface.
    rigid_first, rigid_last : int
        Iterations from each start of that motion, and from the best of them.
    rigid_share : float
        Share of the points, the closest ones, that count: a deformed part must not rotate the body.
    rigid_along : float
        Weight of distances along the surface: with zero weight a round body could rotate indefinitely.
    rigid_clearly : float
        Another start is preferred if its residual is less than this share of that from the frame as given.
    """

    tail: float = 5.0
    most_plain: int = 200
    least_signal: float = 0.3
    most_kept: int = 80
    most_kept_coarse: int = 36
    coarse_points: int = 150
    alike_share: float = 0.08
    least_cosine: float = 0.8
    far: float = 3.0
    outlier: float = 4.0
    closest: int = 8
    rigid_points: int = 150
    rigid_first: int = 12
    rigid_last: int = 40
    rigid_share: float = 0.8
    rigid_along: float = 0.05
    rigid_clearly: float = 0.7


@dataclass(frozen=True)
class Effort:
    """How many intermediate results are kept or made at a time, and the work to expect; no answer depends on it.

    Attributes
    ----------
    bodies_kept : int
        Number of prepared bodies that are kept for later calls.
    remembered : int
        Number of observations whose sensitivities are kept: more belong to points, which no later call repeats.
    kept_entries : int
        A tangent at rest whose factor has more entries (1 GB) is not kept: later passes need the memory.
    many_unknowns : int
        Number of unknowns from which on right-hand sides are solved in parts.
    block : int
        Number of right-hand sides per thread in each of these parts, the block of the solver.
    fields_at_once : int
        Number of displacement fields made at the same time: a multiple of the block, whatever the number of threads.
    passes, passes_of_points : int
        Expected number of passes (rounds of linearising, sampling and solving) with markers, and with points that are
        matched anew.
    factors, factors_of_points : int
        Number of factors held at the same time: of the best pass and the next one; with points also of the stage
        before.
    fields : int
        Number of displacement fields held beside the responses: errors of the model, and draws with their ingredients.
    tet_fields : int
        Number of values held per tet: fields of uncertain stiffness with a copy of each, and those that the solver
        keeps.
    later_bytes : int
        Memory, in bytes, of modules imported and pictures drawn later.
    tet_flops : float
        Work of reading, attaching, regions, files and pictures, in floating-point operations per tet.
    """

    bodies_kept: int = 4
    remembered: int = 400
    kept_entries: int = 250_000_000
    many_unknowns: int = 100_000
    block: int = 16
    fields_at_once: int = 32
    passes: int = 2
    passes_of_points: int = 6
    factors: int = 2
    factors_of_points: int = 3
    fields: int = 260
    tet_fields: int = 160
    later_bytes: int = 200_000_000
    tet_flops: float = 7e6


DISCRETISATION, MATCHING, EFFORT = Discretisation(), Matching(), Effort()
