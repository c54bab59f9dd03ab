"""Numbers that decide whether input is misread: one record a question, each field with its unit and its reason.

Costs and odds are natural logarithms. A cost is what the input would have to gain in likelihood for a mistake of that
kind to be as probable as no mistake; shares are of the body's extent unless another whole is named.
"""

from dataclasses import dataclass
from math import log


@dataclass(frozen=True)
class MistakeCosts:
    """Logarithm of how rare each mistake is.

    Attributes
    ----------
    unit : float
        Another unit of length: common between programs.
    flip : float
        One axis negated, or two (LPS against RAS): the most common mistake, so the cheapest.
    axes : float
        Any other exchange of axes: rare, and there are many to choose among.
    column : float
        Columns or rows shifted by one: a slip in a spreadsheet.
    alone : float
        More for one of the two triples alone: both come from one program as a rule.
    middle : float
        More for a mirror through the body's middle in place of the origin.
    moved : float
        A rigid motion of the measured triple, whose six parameters the likelihood integrates.
    fitted : float
        A rigid motion fitted to the places, whose six parameters cost a factor of eight each.
    swap : float
        Two rows exchanged, beside the number of pairs.
    order : float
        All rows moved by one or sorted, beside the number of such orders.
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
    """How the places of markers lie about a surface.

    Attributes
    ----------
    standoff_mm : float
        Largest plausible height of a marker's centre above the skin, mm: that of a mounted sphere,
    standoff_share : float
        or this share of the extent, if that is less.
    wrong_share : float
        Share of markers that may lie anywhere, so that one wrong marker condemns no reading.
    depth : float
        Depth of markers that were placed inside the body, share of the extent.
    inside_odds : float
        Log-odds that all markers were placed inside.
    held_odds : float
        Log-odds of a marker on held surface: hardly anybody measures what cannot move.
    speck, sprawl : float
        Spread of a layout over that of the skin, below and above which it becomes unlikely.
    fewest_spread : int
        Fewest markers for which a spread is meaningful.
    """

    standoff_mm: float = 6.0
    standoff_share: float = 0.06
    wrong_share: float = 0.03
    depth: float = 0.1
    inside_odds: float = -5.0
    held_odds: float = -1.5
    speck: float = 0.12
    sprawl: float = 1.3
    fewest_spread: int = 3


@dataclass(frozen=True)
class MotionLaw:
    """How one soft body moves: a mixture over sizes, lengths and noises.

    Attributes
    ----------
    sizes : tuple of float
        Sizes of a deformation, shares of the extent: from a tremor to a fold.
    size_weights : tuple of float
        Prior probability of each size: the largest is rare.
    lengths : tuple of float
        Lengths over which a deformation varies, shares of the extent.
    together : tuple of float
        Sizes of a rigid motion that fades towards held nodes, shares of the extent: 0 is that of the deformation, the
        other a tip that swings.
    together_weights : tuple of float
        Prior probability of each.
    extra_noise_mm : tuple of float
        Additions to the tracker's noise, mm: nothing, small misfits of the model, a wrong marker.
    noise_weights : tuple of float
        Prior probability of each.
    rigid_share : float
        Standard deviation of the translation of a free body, share of the extent.
    rigid_radian : float
        The same of its rotation, radian.
    fading : tuple of float
        Lengths over which motion fades towards held nodes, shares of the extent: a thin base, and a thick one.
    largest_noise_mm : float
        Upper limit on the noise of a coordinate, mm: a larger stated value is more likely an error of units.
    few_readings : int
        Up to so many readings are part of a Cholesky factor; of more, a solve is faster.
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
    """How many other readings are tried, which bounds the time.

    Attributes
    ----------
    spread_markers : int
        Markers used that are spread over the body, if there are many,
    odd_markers : int
        and those beside them that differ most from their neighbours.
    places : int
        Readings with other places whose motion is evaluated: the most likely without it.
    turned : int
        The same of readings with measured places in other frames.
    all_pairs : int
        Up to this number of markers all pairs are exchanged; of more, those that differ most from their neighbours.
    orders : int
        Orders of rows that are evaluated: those with the least motion after a common motion is removed.
    neighbours : int
        Neighbours with which a marker's motion is compared: enough for a median.
    fewest_places : int
        Fewest markers whose places alone determine six parameters,
    fewest_moved : int
        and fewest whose motion does.
    smallest_mm : float
        A rigid motion smaller than this at the held nodes is a slipped support, not a misreading: mm,
    smallest_share : float
        or this share of the extent, if that is more.
    align, slide : int
        Iterations of a robust rigid fit to places, and of one onto the surface: they settle in fewer.
    closest : int
        Closest surface samples whose triangles are tested exactly.
    sets_kept : int
        Sets of points whose closest places are kept.
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
    """When single markers are suspicious though no other reading explains them.

    Attributes
    ----------
    near_share : float
        Places nearer to the surface than this share of the extent (root mean square) need no rigid motion onto it.
    deepest_share : float
        A marker deeper inside the body than this share of its extent was not placed there on purpose.
    held_mm : float
        A marker on held surface that moves by more is suspicious, beside its noise: mm,
    held_share : float
        or this share of the extent, if that is more.
    mounted : float
        Largest plausible error of a mounting, share of the largest height above the skin.
    inside_mm : float
        The same of a marker placed inside the body, which cannot stick out: mm,
    inside_share : float
        plus this share of the extent.
    level : float
        Chance below which a mounting is out of the question.
    fewest : int
        Fewest markers whose scatter tells.
    finest_mm : float
        Finest step of numbers that came through text or single precision, mm.
    """

    near_share: float = 0.01
    deepest_share: float = 0.2
    held_mm: float = 3.0
    held_share: float = 0.02
    mounted: float = 0.4
    inside_mm: float = 0.3
    inside_share: float = 0.003
    level: float = 1e-3
    fewest: int = 5
    finest_mm: float = 1e-6


@dataclass(frozen=True)
class CloudChecks:
    """When unlabelled points of a surface are suspicious.

    `odd`, `lost`: median distances from the undeformed surface, shares of the extent, above which points are
    suspicious, or refused; `times`: another reading must bring the points closer by this factor; `near`: and within
    this share of the extent; `larger`, `smaller`: size of a cloud over that of a free body, above or below which it is
    in other units; `points`: points whose distances are computed.
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
