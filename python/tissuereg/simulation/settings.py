"""Numbers of simulations that may change an answer, each with its unit and its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DataSetRules:
    """How members of a data set are drawn, solved, given up and described.

    Attributes
    ----------
    small : float
        Size of the first, nearly linear pass, share of the body's extent.
    depth_share : tuple of float
        Range of a plate's depth, share of its radius.
    size_log_std : float
        Standard deviation of the logarithm of a random change's size.
    again : int
        How often a member that moves too far is solved again,
    below : float
        and how far it is then meant to move, share of the most: a little less, so that it does not miss again.
    few : int
        A chunk of fewer members says nothing about the rest: all of it may fail.
    most_failed : int
        So many more chunks than were made may fail on workers before the rest is given up.
    paired : int
        Members of a chunk of which all pairs are compared: members are independent, so these stand for all.
    far_mm : float
        Distance of two members, mm, whose share among pairs is stated: about the paper's error at the start.
    """

    small: float = 1e-4
    depth_share: tuple[float, float] = (0.05, 0.4)
    size_log_std: float = 0.7
    again: int = 4
    below: float = 0.95
    few: int = 8
    most_failed: int = 10
    paired: int = 32
    far_mm: float = 7.0


@dataclass(frozen=True)
class MemoryRules:
    """How tissue with a memory comes to rest, and boundaries that slide or stick.

    Attributes
    ----------
    rest : float
        Relaxation times per step, in the four steps in which a loaded body comes to rest before the first frame. A
        step assumes linearly growing strain, so each leaves about 1/30 of the remaining creep.
    across : float
        Normal stiffness of a sliding boundary, in modulus over extent: it gives way by about 1e-4 of the strain.
    sticks : float
        Tangential stiffness of a boundary that sticks by friction, in the same unit.
    """

    rest: float = 30.0
    across: float = 1e4
    sticks: float = 1e3


@dataclass(frozen=True)
class SizeRules:
    """Memory and time that a body may take: when a warning is given, and when it is refused.

    Attributes
    ----------
    warned_share : float
        Share of the available memory above which a warning is given.
    long_seconds : float
        Time above which a message says how long it takes, s.
    working : float
        Working entries while a factor is made, over those of one thread: threads work on several fronts.
    large_entries : int
        A factor of so many entries is checked in any case, whatever is done with the body.
    per_entry : float
        Cost of a factor entry and right-hand side, in operations at the speed of matrix products,
    per_tet : float
        and of a tet and factorisation.
    order : int
        Order of the matrix product that measures the speed,
    repeats : int
        and how often it is made.
    smallest : int
        Meshes of fewer nodes are not suggested.
    room : float
        Share of the available memory that a suggested mesh may take.
    rigs_kept : int
        Analysed rigs that are kept.
    """

    warned_share: float = 0.5
    long_seconds: float = 60.0
    working: float = 2.4
    large_entries: int = 10_000_000
    per_entry: float = 42.0
    per_tet: float = 4e5
    order: int = 512
    repeats: int = 5
    smallest: int = 50
    room: float = 0.85
    rigs_kept: int = 12


@dataclass(frozen=True)
class FineRules:
    """How a fine mesh is cut, judged and solved.

    Attributes
    ----------
    most_rounds : int
        Rounds of bisection: more than any refinement to a size above a millionth of the body takes.
    along : float
        Loads whose directions differ by less than this are collinear.
    most_states : int
        Solved states for an extrapolated guess: a parabola.
    tolerance : float
        Relative residual at which a frame counts as solved: errors of about 1e-5 mm in markers and 1e-2 mN in forces.
    sharp : float
        Facets that meet at a sharper angle (cosine between normals) form an edge of the body itself.
    least_loaded : float
        Frames whose force is less than this share of the largest do not determine a ratio.
    most_changed : float
        Largest change of a force by a map, along and across it; larger differences are not mapped.
    locks_above : float
        Poisson's ratio above which four-node tets lock.
    solutions_kept : int
        Elastic solutions that are kept: coarse and fine ones of ten cases.
    snap_share : float
        An end of a crossing edge slides onto the rim if the crossing is nearer to it than this share of the edge.
    kept_quality : float
        After a node is moved, every tetrahedron must keep this share of its quality,
    least_quality : float
        and at a rim have at least this quality.
    inside : float
        Nodes of the rim lie this share of the radius inside it, so that rounding leaves none outside.
    dip_share : float
        Edges between outer nodes are cut if they enter the ball by this share of their length.
    jitter_share : float
        Largest motion of a node of a third mesh, over its shortest edge.
    rim_factors : tuple of float
        Range of the edge length at the rims of a third mesh, over that of the fine mesh; uniform.
    bulge_shares : tuple of float
        Range of the outward motion of its surface, over the mean gap between facets and a smooth surface; uniform.
    """

    most_rounds: int = 1000
    along: float = 1e-6
    most_states: int = 3
    tolerance: float = 1e-4
    sharp: float = 0.7
    least_loaded: float = 0.02
    most_changed: float = 0.6
    locks_above: float = 0.475
    solutions_kept: int = 20
    snap_share: float = 0.35
    kept_quality: float = 0.5
    least_quality: float = 0.1
    inside: float = 1e-11
    dip_share: float = 0.1
    jitter_share: float = 0.25
    rim_factors: tuple[float, float] = (1.0, 1.8)
    bulge_shares: tuple[float, float] = (0.0, 1.5)


DATA_SET, MEMORY, SIZE, FINE = DataSetRules(), MemoryRules(), SizeRules(), FineRules()
