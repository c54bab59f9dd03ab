"""Constants of the simulations (tolerances, limits, ranges) that can change a result, each with unit and reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class DataSetRules:
    """Constants for drawing, solving, discarding and describing the members of a training data set.

    A member is one simulation under a random load; a chunk is the group of members that share a file.

    Attributes
    ----------
    small : float
        Displacement at which the first, nearly linear solves take place, as a share of the body's largest extent.
    depth_share : tuple of float
        Range of the depth by which a plate is pressed in, as a share of the plate's radius.
    size_log_std : float
        Standard deviation of the natural logarithm of the size of a random displacement field.
    again : int
        How often a member is solved again, under a smaller load, if a node moves farther than the recipe allows.
    below : float
        Largest displacement at which such a repetition aims, as a share of the allowed one. It lies a little below 1,
        so that the repetition does not exceed the limit again.
    few : int
        A chunk of at least this many members is refused if more than half of them fail. A smaller chunk is accepted
        even if all of its members fail.
    most_failed : int
        The run ends when the chunks that failed on workers outnumber the finished ones by this number.
    paired : int
        Number of members of a chunk that are compared with each other pair by pair. Members are independent, so these
        represent all others.
    far_mm : float
        Distance between two members, mm; the share of pairs that lie at least this far apart is reported. It is about
        the error that the paper has at the start.
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
    """Constants for bringing a material with memory to rest, and for boundaries that slide or stick.

    Attributes
    ----------
    rest : float
        Length of a time step, in units of the longest relaxation time, for the four steps in which a loaded body comes
        to rest before the first frame. A step assumes linearly growing strain, so each step leaves about 1/30 of the
        remaining creep.
    across : float
        Stiffness of a sliding boundary along its normal, in units of Young's modulus over the body's largest extent
        (kPa/mm). The boundary gives way by about 1e-4 of the strain.
    sticks : float
        Stiffness in its tangent plane of a boundary that sticks by friction, in the same unit.
    """

    rest: float = 30.0
    across: float = 1e4
    sticks: float = 1e3


@dataclass(frozen=True)
class SizeRules:
    """Limits on the memory and time that a body may take: when a warning is given, and when the body is refused.

    A factor is the Cholesky factor of the stiffness matrix of the body.

    Attributes
    ----------
    warned_share : float
        Share of the available memory above which a warning is given.
    long_seconds : float
        Computing time in s above which a message states how long the work takes.
    working : float
        Temporary entries while a factor is computed, as a multiple of those of one thread. It is above 1 because
        several threads work on several fronts (dense submatrices) at the same time.
    large_entries : int
        A body whose factor has at least this many entries is checked against the available memory in any case, whatever
        is done with it.
    per_entry : float
        Cost of one factor entry for one right-hand side, in floating-point operations at the speed of matrix products.
    per_tet : float
        Cost of one tet in one factorisation, in the same operations.
    order : int
        Order of the square matrices whose product measures the speed of the machine.
    repeats : int
        How often that product is timed; the median counts.
    smallest : int
        An error message does not suggest a mesh of fewer nodes than this.
    room : float
        Share of the available memory that a suggested mesh may take.
    rigs_kept : int
        Largest number of simulators or rigs (analysed bodies with pads attached) that a cache keeps.
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
    """Constants for cutting, judging and solving the fine mesh of an experiment, and the third meshes made from it.

    A third mesh is another mesh of the same body with a different discretisation error. A rim is the circle on the
    surface that bounds a pad; it lies on the sphere (ball) by which the pad is given.

    Attributes
    ----------
    most_rounds : int
        Largest number of rounds of bisection. It is more than any refinement to a size above a millionth of the body
        takes.
    along : float
        A load counts as collinear with another one if its distance from the other's line is at most this share of that
        other load's size.
    most_states : int
        Largest number of solved states from which an initial guess is extrapolated; three give a parabola.
    tolerance : float
        Norm of the residual over that of the load at which a frame counts as solved. It gives errors of about 1e-5 mm
        in markers and 1e-2 mN in forces.
    sharp : float
        Two facets form an edge of the body itself if the cosine of the angle between their normals is less than this.
    least_loaded : float
        A frame whose force is at most this share of the largest does not determine a ratio of forces.
    most_changed : float
        Largest relative change of a force by a map from coarse to fine elements, along the force and across it. The
        part of a difference beyond it is not mapped.
    locks_above : float
        Poisson's ratio above which four-node tets lock.
    solutions_kept : int
        Largest number of elastic solutions in the cache: coarse and fine ones of ten cases.
    snap_share : float
        An end of an edge that crosses a rim is moved onto the rim if the crossing lies within this share of the edge's
        length from it.
    kept_quality : float
        Share of its shape quality (mean ratio, 1 where regular) that every tetrahedron must keep when nodes are moved.
    least_quality : float
        Shape quality that suffices for a tetrahedron at a rim, even if it is a smaller share of the earlier quality.
    inside : float
        Nodes of a rim lie inside its sphere by this share of the radius, so that rounding leaves none outside.
    dip_share : float
        An edge between two nodes outside the ball is cut if it enters the ball deeper than this share of its length.
    jitter_share : float
        Largest random motion of a node of a third mesh, as a share of the node's shortest edge.
    rim_factors : tuple of float
        Range of a factor on the edge length at the rims, by which a third mesh differs from the fine mesh; uniform.
    bulge_shares : tuple of float
        Range of the outward motion of the surface of a third mesh, as a share of the mean gap between the flat facets
        and a smooth surface; uniform.
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
