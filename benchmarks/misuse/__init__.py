"""Misread inputs: bodies, events, misuses, what `tissuereg.registration.readings` answers (`benchmarks/misuse.py`)."""
