"""Helpers that every other package may import: checks of arguments and arrays, clocks, warnings, the machine."""
