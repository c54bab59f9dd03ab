"""From a surface to a body: the surface is read, repaired and filled with tetrahedra, and the mesh is measured.

    file or arrays --io/surfaces--> triangles, mm --repair--> closed, outward --fill--> tets --quality--> FilledMesh

`FilledMesh.repaired` lists the repairs of the surface; `FilledMesh.quality` gives the distance of the tets from it.
"""

from tissuereg.meshing.body import FilledMesh, tetrahedralize

__all__ = ["FilledMesh", "tetrahedralize"]
