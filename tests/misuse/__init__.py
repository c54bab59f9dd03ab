"""Misread inputs: bodies, good events, misuses, and the answers of `tissuereg.readings` (`benchmarks/misuse.py`)."""
