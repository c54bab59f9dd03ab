"""Timings by stage, which the command ``tissuereg bench`` measures."""
