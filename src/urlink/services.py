"""The services of a controller that a person switches on: why a connection may be refused that used to be taken.

From 5.17 on, and on PolyScope X, the ports of the client interfaces are closed until they are enabled at the pendant
(docs/protocols/urscript.md, Services that are off).
"""

from __future__ import annotations

from .firmware import Firmware

__all__ = ["refusal_hint"]

_WHERE = "the service may be switched off (Settings > Security > Services at the pendant)"
_SINCE = Firmware(5, 17)


def refusal_hint(firmware: Firmware | None) -> str:
    """The hint for a connection that a controller refuses; "" for a controller without a setting for it.

    Args:
        firmware: of the controller; None where nobody knows it.

    >>> refusal_hint(Firmware(5, 25))
    'on firmware 5.25 the service may be switched off (Settings > Security > Services at the pendant)'
    >>> refusal_hint(Firmware(5, 11))
    ''
    """
    if firmware is None:
        return f"from firmware {_SINCE} on, and on PolyScope X, {_WHERE}"
    return f"on firmware {firmware} {_WHERE}" if firmware >= _SINCE else ""
