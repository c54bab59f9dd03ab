"""Misread inputs: bodies, good events, misuses, and what `tissuereg.readings` says of them (`benchmarks/misuse.py`)."""
