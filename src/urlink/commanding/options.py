"""What a user chooses about commanding, when connecting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..urscript.wrapping import StartPlace
from .interlock import Policy

__all__ = ["CommandsVia", "Options"]

#: How settings may be sent: RTDE inputs where they are free, else URScript; or URScript alone.
CommandsVia = Literal["auto", "script"]


@dataclass(frozen=True)
class Options:
    """The arguments of `urlink.connect` about commanding, by their names."""

    require_enable: Policy
    stale_after: float
    start_timeout: float
    start_place: StartPlace
    reverse_host: str | None
    reverse_port: int
    reverse_peer: str | None
    commands_via: CommandsVia
