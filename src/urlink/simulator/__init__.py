"""A controller in software: the arm, its programs and its servers.

`Controller` is what a user holds; see `urlink.simulator.controller`.
"""

from __future__ import annotations

from .controller import Controller, Counters
from .faults import Faults, ScheduledFault, parse_fault
from .ports import PORTS

__all__ = ["PORTS", "Controller", "Counters", "Faults", "ScheduledFault", "parse_fault"]
