"""From a surface to a body: read, repaired, filled with tetrahedra, measured.

    file or arrays --io/surfaces--> triangles, mm --repair--> closed, outward --fill--> tets --quality--> FilledMesh

What is done to the surface is said in `FilledMesh.repaired`; how far the tets are from it in `FilledMesh.quality`.
"""

from tissuereg.meshing.body import FilledMesh, tetrahedralize

__all__ = ["FilledMesh", "tetrahedralize"]
