"""Numbers of meshing, each with its unit and its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class MeshingRules:
    """Constants of meshing: limits of the work, tolerances of the repair, and when a surface encloses a body.

    `deviation_of_size`, `deviation_of_diagonal`: default deviation of the mesh from the surface, as the smaller of
    these shares; `same_place`: distance of vertices that are merged, over the extent; `least_filled`: share of its
    bounding box that a shell must fill; `nought`: relative volume taken as zero; `most_tets`, `most_pairs`,
    `most_strips`, `longest_table`, `points`, `probes`: largest numbers of tets, pairs, strips, corners of a rim, points
    where a distance is measured, test points of a shell; `least_island`, `most_cavity`, `deviation_of_voxel`, `pad`,
    `level_step`, `level_steps`, `level_share`, `apart`: of labels in images; `strip`, `block`: width of strips in mean
    boxes, and pairs tested at a time.
    """

    most_tets: int = 3_000_000  # more than this are refused before they are made
    deviation_of_size: float = 0.05  # the default deviation from the surface is the smaller of this share of the size
    deviation_of_diagonal: float = 1e-3  # and of this share of the body's diagonal
    most_pairs: int = 300_000_000  # candidate pairs of triangles beyond which crossings are not sought
    strip: float = 4.0  # width of a strip of that search, in mean boxes
    most_strips: int = 400  # largest number of strips
    block: int = 2_000_000  # pairs that are tested at a time: what fits the cache and a small machine
    nought: float = 1e-9  # volumes below this share of a pair's cubed size are zero: a corner lies in the other's plane
    longest_table: int = 300  # rims of more corners are closed by a fan: the best filling costs their cube
    # Vertices closer than this share of the extent are merged: the precision of single-precision coordinates.
    same_place: float = 1e-6
    points: int = 20_000  # of a surface whose distance is measured, taken evenly from its list
    # Islands of a label below the first share of its volume are left out, cavities below the second filled.
    least_island: float = 0.05
    most_cavity: float = 0.01
    deviation_of_voxel: float = 0.25  # default deviation from the surface of a label, over the longest voxel edge
    pad: int = 5  # voxels around a label where its distance is smoothed
    # The surface of a label is moved until it encloses the volume of the voxels to this share, by at most that many
    # steps of at most this share of the longest voxel edge.
    level_share: float = 0.005
    level_steps: int = 8
    level_step: float = 0.25
    apart: float = 0.75  # surfaces of two labels that are closer, over the longest voxel edge, are one
    # A shell that fills less than this share of its bounding box is a sheet, which encloses nothing.
    least_filled: float = 1e-6
    # So many of a shell's triangles are tested for lying in another shell; crossing shells do not lie in it.
    probes: int = 8


MESHING = MeshingRules()
