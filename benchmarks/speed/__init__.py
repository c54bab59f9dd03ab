"""Times of solver, smoother, whole registrations, large bodies, many machines."""
