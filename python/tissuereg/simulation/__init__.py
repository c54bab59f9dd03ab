"""Simulations: one solve, many solves, random events, data sets, whole experiments."""

from tissuereg.simulation.solve import Simulation, Simulations, Simulator, simulate

__all__ = ["Simulation", "Simulations", "Simulator", "simulate"]
