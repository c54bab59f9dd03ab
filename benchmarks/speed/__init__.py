"""How fast is it? Solver, smoother, whole registrations, large bodies, many machines."""
