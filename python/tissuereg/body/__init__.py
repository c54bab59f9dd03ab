"""A body and its measurements as plain data: tetrahedral mesh, material, load, tracked markers and surface points."""
