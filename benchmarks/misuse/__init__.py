"""Misread inputs: bodies, events, misuses, what `tissuereg.registration.readings` answers (`python -m misuse`)."""
