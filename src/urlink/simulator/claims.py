"""Which client may write which RTDE input (docs/protocols/rtde.md, Rules).

One client holds an input, in as many of its recipes as it likes, until its connection ends. A fieldbus that is enabled
in the installation holds inputs too.
"""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["FIELDBUSES", "InputClaims"]

# That EtherNet/IP reserves the lower half of both kinds was reported to the vendor's Python client; that PROFINET does
# so too is a guess. What happens to the boolean registers is not known; here they stay free.
_LOWER = frozenset(f"input_{kind}_register_{number}" for kind in ("int", "double") for number in range(24))

#: Fieldbus -> the inputs that it reserves.
FIELDBUSES = {"EtherNet/IP": _LOWER, "PROFINET": _LOWER}


class InputClaims:
    """The inputs of one controller and the clients that hold them."""

    def __init__(self) -> None:
        self._owners: dict[str, object] = {}
        # Connections that are over, and the cycle up to which their inputs stay held.
        self._stale: dict[object, int] = {}

    def holder(self, name: str, now: int) -> object | None:
        """The client that holds an input in this cycle; None if it is free."""
        owner = self._owners.get(name)
        if owner is not None and self._stale.get(owner, now) < now:
            self.release(owner)
            return None
        return owner

    def claim(self, names: Iterable[str], owner: object) -> None:
        """Claim these inputs, which are free."""
        self._owners.update(dict.fromkeys(names, owner))

    def release(self, owner: object) -> None:
        """Release all inputs of a client."""
        self._stale.pop(owner, None)
        self._owners = {name: held_by for name, held_by in self._owners.items() if held_by is not owner}

    def go_stale(self, owner: object, until: int) -> None:
        """Keep the inputs of a client whose connection is over held up to that cycle."""
        self._stale[owner] = until
