"""Draws rigs and solves them by NGSolve and scikit-fem. Imports nothing from the package that is tested."""
