"""A body and what is seen of it, as plain data: mesh, material, load, markers, surfaces."""
