"""Faults of a simulated controller. They affect the arm, the connections, or the bytes that are sent over them."""

from __future__ import annotations

from .faults import FAULTS, Faults
from .link import LinkFaults
from .schedule import FaultSchedule, ScheduledFault, parse_fault

__all__ = ["FAULTS", "FaultSchedule", "Faults", "LinkFaults", "ScheduledFault", "parse_fault"]
