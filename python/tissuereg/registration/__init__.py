"""Register a body to markers: the public calls, their inputs, results and trust; the methods are its rooms."""
