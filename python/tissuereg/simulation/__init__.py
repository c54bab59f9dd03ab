"""Finite-element simulations of a soft body: single solves, batches, random loads, training data, experiments."""

from tissuereg.simulation.solve import Simulation, Simulations, Simulator, simulate

__all__ = ["Simulation", "Simulations", "Simulator", "simulate"]
