"""Numbers of meshing, each with its unit and its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MeshingRules:
    """When a surface is one body, what is repaired, and how much work that may be.

    Attributes
    ----------
    most_tets : int
        More tetrahedra than this are refused before they are made.
    deviation_of_size : float
        The default deviation from the surface is the smaller of this share of the size of tetrahedra,
    deviation_of_diagonal : float
        and this share of the body's diagonal.
    most_pairs : int
        Candidate pairs of triangles beyond which crossings are not sought.
    strip : float
        Width of a strip of that search, in mean boxes,
    most_strips : int
        and largest number of strips.
    block : int
        Pairs that are tested at a time: what fits the cache and a small machine.
    nought : float
        Volumes below this share of a pair's cubed size count as zero: a corner lies in the other's plane.
    longest_table : int
        Rims of more corners than this are closed by a fan: the best filling costs their cube.
    same_place : float
        Vertices closer than this share of the extent are merged: the precision of single-precision coordinates.
    points : int
        Points of a surface whose distance is measured, taken evenly from its list.
    least_filled : float
        A shell with less than this share of its bounding box's volume is a sheet, which encloses nothing.
    probes : int
        About this number of a shell's triangles is tested for lying in another shell; crossing shells do not lie in
        it.
    """

    most_tets: int = 3_000_000
    deviation_of_size: float = 0.05
    deviation_of_diagonal: float = 1e-3
    most_pairs: int = 300_000_000
    strip: float = 4.0
    most_strips: int = 400
    block: int = 2_000_000
    nought: float = 1e-9
    longest_table: int = 300
    same_place: float = 1e-6
    points: int = 20_000
    least_filled: float = 1e-6
    probes: int = 8


MESHING = MeshingRules()
