"""Simulated controller: the arm, its programs and its servers.

Users need the class `Controller`; see `urlink.simulator.controller`.
"""

from __future__ import annotations

from ..protocol.ports import PORTS
from .controller import Controller
from .faults import Faults, ScheduledFault, parse_fault
from .robot.characteristics import ScalingParameters
from .robot.scene import Reaction, Scene
from .robot.setpoint_sources import HOME, Demonstration, Setpoint, SetpointSource, Still
from .robot.surroundings import Plane, Spring, Surroundings
from .state import Counters

__all__ = [
    "HOME",
    "PORTS",
    "Controller",
    "Counters",
    "Demonstration",
    "Faults",
    "Plane",
    "Reaction",
    "ScalingParameters",
    "Scene",
    "ScheduledFault",
    "Setpoint",
    "SetpointSource",
    "Spring",
    "Still",
    "Surroundings",
    "parse_fault",
]
