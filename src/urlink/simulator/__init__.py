"""A controller in software: the arm, its programs and its servers.

`Controller` is what a user holds; see `urlink.simulator.controller`.
"""

from __future__ import annotations

from ..ports import PORTS
from .controller import Controller
from .counters import Counters
from .faults import Faults, ScheduledFault, parse_fault

__all__ = ["PORTS", "Controller", "Counters", "Faults", "ScheduledFault", "parse_fault"]
