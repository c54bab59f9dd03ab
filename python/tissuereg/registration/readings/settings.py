"""Numbers that decide whether input is misread: one class for each question, each field with its unit and its reason.

Costs and odds are natural logarithms. A cost is what the input would have to gain in likelihood for a mistake of that
kind to be as probable as no mistake; shares are of the body's extent, the largest along an axis, unless another
quantity is named.
"""

from dataclasses import dataclass
from math import log


@dataclass(frozen=True)
class MistakeCosts:
    """Prior cost of each mistake in the input: minus the natural logarithm of its odds against no mistake.

    Attributes
    ----------
    unit : float
        All lengths in another unit: common between programs.
    flip : float
        One axis negated, or two (LPS against RAS): the most common mistake, so the cheapest.
    axes : float
        Any other exchange of axes: rare, and there are many to choose among.
    column : float
        Columns or rows shifted by one: a slip in a spreadsheet.
    alone : float
        Additional cost if the mistake is in reference or measured places alone: both come from one program as a rule.
    middle : float
        Additional cost of a mirror plane through the body's middle in place of the origin.
    moved : float
        A rigid motion of the measured places, over whose six parameters the likelihood integrates.
    fitted : float
        A rigid motion fitted to the reference places, whose six parameters cost a factor of eight each.
    swap : float
        Two rows exchanged; the logarithm of the number of pairs is added.
    order : float
        All rows moved by one or sorted; the logarithm of the number of rows is added.
    far : float
        Markers that lie off the body for no reason that is named.
    unrelated : float
        Measured places that belong to other markers or bodies.
    margin : float
        Log-odds by which another reading must beat the input as given: a thousand to one, for a false alarm stops work.
    tie : float
        Readings whose log-odds differ by less fit equally well, and both are named.
    """

    unit: float = 7.0
    flip: float = 6.0
    axes: float = 10.0
    column: float = 11.0
    alone: float = 1.0
    middle: float = 2.0
    moved: float = 13.0
    fitted: float = 18.0
    swap: float = 6.0
    order: float = 8.0
    far: float = 5.0
    unrelated: float = 6.0
    margin: float = log(1000.0)
    tie: float = 2.0


@dataclass(frozen=True)
class PlacesLaw:
    """Probability model of the reference places of markers about the surface of a body.

    Attributes
    ----------
    standoff_mm : float
        Largest plausible height of a marker's centre above the surface, mm: that of a mounted sphere.
    standoff_share : float
        The same as a share of the extent; the smaller height counts.
    wrong_share : float
        Share of markers that may lie anywhere, so that one wrong marker condemns no reading.
    depths : tuple of float
        Scales of the depth of markers that were placed inside the body, shares of the extent: near the surface, or
        anywhere.
    inside_odds : float
        Log-odds that all markers were placed inside; the same again that some were, and the others mounted.
    held_odds : float
        Log-odds of a marker on held surface: hardly anybody measures what cannot move.
    speck, sprawl : float
        Spread of the markers over that of the surface nodes, below and above which their layout becomes unlikely.
    fewest_spread : int
        Fewest markers for which a spread is meaningful.
    """

    standoff_mm: float = 6.0
    standoff_share: float = 0.06
    wrong_share: float = 0.03
    depths: tuple[float, ...] = (0.1, 0.2)
    inside_odds: float = -5.0
    held_odds: float = -1.5
    speck: float = 0.12
    sprawl: float = 1.3
    fewest_spread: int = 3


@dataclass(frozen=True)
class MotionLaw:
    """Probability model of the motion of one soft body: a mixture over sizes, lengths and noises.

    Attributes
    ----------
    sizes : tuple of float
        Sizes of a deformation, shares of the extent: from a tremor to a fold.
    size_weights : tuple of float
        Prior probability of each size: the largest is rare.
    lengths : tuple of float
        Lengths over which a deformation varies, shares of the extent.
    together : tuple of float
        Sizes of a rigid motion that fades towards held nodes, shares of the extent: 0 stands for the size of the
        deformation, the other is a tip that swings.
    together_weights : tuple of float
        Prior probability of each size in `together`.
        Prior probability of each.
    extra_noise_mm : tuple of float
        Additions to the tracker's noise, mm: nothing, small misfits of the model, a wrong marker.
    noise_weights : tuple of float
        Prior probability of each addition.
        Prior probability of each.
    rigid_share : float
        Standard deviation of the translation of a free body, share of the extent.
    rigid_radian : float
        Standard deviation of its rotation, radian.
    fading : tuple of float
        Lengths over which motion fades towards held nodes, shares of the extent: a thin base, and a thick one.
    largest_noise_mm : float
        Upper limit on the noise of a coordinate, mm: a larger stated value is more likely an error of units.
    few_readings : int
        Up to this number, readings (interpretations of the input) are part of a Cholesky factor; for more, a solve is
        faster.
    """

    sizes: tuple[float, ...] = (0.002, 0.008, 0.03, 0.08, 0.2)
    size_weights: tuple[float, ...] = (0.23, 0.23, 0.23, 0.23, 0.08)
    lengths: tuple[float, ...] = (0.1, 0.3, 0.8)
    together: tuple[float, ...] = (0.0, 0.12)
    together_weights: tuple[float, ...] = (0.6, 0.4)
    extra_noise_mm: tuple[float, ...] = (0.05, 0.7, 3.0)
    noise_weights: tuple[float, ...] = (0.6, 0.3, 0.1)
    rigid_share: float = 0.3
    rigid_radian: float = 0.5
    fading: tuple[float, ...] = (0.08, 0.25, 0.7)
    largest_noise_mm: float = 2.0
    few_readings: int = 6


@dataclass(frozen=True)
class Proposals:
    """Numbers of other readings (interpretations of the input) that are tried, which bound the time.

    Attributes
    ----------
    spread_markers : int
        Number of markers used that are spread over the body, if there are many.
    odd_markers : int
        Number of further markers used, whose motion differs most from that of their neighbours.
    places : int
        Number of readings with other reference places whose motion is evaluated: those that are most likely by their
        places.
    turned : int
        Number of readings with measured places in other frames whose motion is evaluated.
    all_pairs : int
        Up to this number of markers all pairs are exchanged; of more markers, those that differ most from their
        neighbours.
    orders : int
        Number of orders of rows that are evaluated: those with the least motion after a common motion is removed.
    neighbours : int
        Number of neighbours with which a marker's motion is compared: enough for a median.
    fewest_places : int
        Fewest markers whose places alone determine the six parameters of a rigid motion.
    fewest_moved : int
        Fewest markers whose motion determines these parameters.
    smallest_mm : float
        A rigid motion smaller than this at the held nodes is a slipped support, not a misreading, mm.
    smallest_share : float
        The same as a share of the extent; the larger one counts.
    align, slide : int
        Iterations of a robust rigid fit to places, and of a rigid fit onto the surface: both settle in fewer.
    closest : int
        Number of closest surface samples whose triangles are tested exactly.
    sets_kept : int
        Number of sets of points whose closest places on the surface are kept in memory.
    """

    spread_markers: int = 32
    odd_markers: int = 16
    places: int = 12
    turned: int = 4
    all_pairs: int = 20
    orders: int = 32
    neighbours: int = 5
    fewest_places: int = 7
    fewest_moved: int = 4
    smallest_mm: float = 3.0
    smallest_share: float = 0.03
    align: int = 8
    slide: int = 8
    closest: int = 4
    sets_kept: int = 512


@dataclass(frozen=True)
class MarkerChecks:
    """Limits beyond which single markers are suspicious though no other reading of the input explains them.

    Attributes
    ----------
    near_share : float
        Places nearer to the surface than this share of the extent (root mean square) need no rigid motion onto it.
    held_mm : float
        A marker on held surface that moves by more than this and its noise is suspicious, mm.
    held_share : float
        The same as a share of the extent; the larger one counts.
    mounted : float
        Standard deviation of the height of a mounted marker, share of the largest height above the surface.
    inside_mm : float
        Standard deviation of how far a marker that was placed inside the body sticks out of it, mm,
    inside_share : float
        to which this share of the extent is added.
    level : float
        Chance below which it is excluded that the markers were mounted, or placed inside.
    fewest : int
        Fewest markers whose distances from the surface are tested.
    finest_mm : float
        Finest step of numbers that came through text or single precision, mm.
    at_rest : float
        Standard deviations of the noise within which a marker is where it was.
    farthest : float
        Extents that no body brings a marker away from the middle of all.
    fewest_moving : int
        Fewest markers of which the middle is meaningful.
    fewest_together : int
        Markers at one measured place that are lost; two are a marker that is listed twice.
    """

    near_share: float = 0.01
    held_mm: float = 3.0
    held_share: float = 0.02
    mounted: float = 0.4
    inside_mm: float = 0.3
    inside_share: float = 0.003
    level: float = 1e-3
    fewest: int = 5
    finest_mm: float = 1e-6
    at_rest: float = 4.0
    farthest: float = 10.0
    fewest_moving: int = 3
    fewest_together: int = 3


@dataclass(frozen=True)
class CloudChecks:
    """Limits beyond which unlabelled points measured on a surface are suspicious.

    `odd`, `lost`: median distances from the undeformed surface, shares of the extent, above which points are
    suspicious, or refused; `times`: another reading must bring the points closer by this factor; `near`: share of the
    extent within which it must bring them; `larger`, `smaller`: size of a cloud over that of a free body, above or
    below which it is in other units; `points`: number of points whose distances are computed.
    """

    odd: float = 0.12
    lost: float = 0.5
    times: float = 4.0
    near: float = 0.06
    larger: float = 2.0
    smaller: float = 0.02
    points: int = 100


#: The settings in use. They were chosen together, on misread and on plain input of many bodies: no call changes one.
COSTS, PLACES, MOTION = MistakeCosts(), PlacesLaw(), MotionLaw()
PROPOSALS, CHECKS, CLOUDS = Proposals(), MarkerChecks(), CloudChecks()
