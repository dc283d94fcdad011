"""Simulated time for a program and all its peers; see `simulated_time`."""

from .network import Computer, Network, Route
from .scheduler import Deadlock, TimeLimit
from .takeover import Simulation, simulated_time

__all__ = ["Computer", "Deadlock", "Network", "Route", "Simulation", "TimeLimit", "simulated_time"]
