"""What a peer may ask for: bounds that are checked before anything is allocated or stored."""

from __future__ import annotations

from dataclasses import dataclass, fields

from linkcore.errors import BadValue

__all__ = ["Limits"]


@dataclass(frozen=True)
class Limits:
    """Bounds on what comes over the wire (section 13 of the protocol reference, last paragraph).

    The original has none: one hostile number ends it. The defaults are far above what any robot is
    known to use, which is some hundred variables of at most 127 words.

    Attributes:
        variables: variables in one table.
        length: 32-bit words of one variable.
        words: words of all variables of one table together.
        batch: bytes of one batch, the handshake among them.

    Raises:
        BadValue: a limit below 1.
    """

    variables: int = 8192
    length: int = 4096
    words: int = 1 << 20
    batch: int = 16 << 20

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) < 1:
                raise BadValue(f"Limits.{field.name} is {getattr(self, field.name)}; expected at least 1")
