"""The motion of a simulated controller: what movej and its kin make of the targets of the joints, cycle by cycle."""

from __future__ import annotations

from .drive import Drive
from .limits import LimitViolation, Unreachable
from .move import Move

__all__ = ["Drive", "LimitViolation", "Move", "Unreachable"]
