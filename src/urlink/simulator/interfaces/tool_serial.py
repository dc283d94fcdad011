"""Serial line of the tool connector, which the vendor's URCap forwards to port 54321.

The following is assumed. Bytes are lost while the line is not enabled. An answer is sent only to the client that has
sent the request. The transmission of bytes over the line takes no time. If the baud rates of the controller and the
device differ, this has no effect.
"""

from __future__ import annotations

from collections.abc import Callable

from ..state import ControllerState
from .interface import Interface, InterfaceClient, InterfaceReceiver

#: Mounted device: a function that receives bytes and returns the bytes of its answer.
Device = Callable[[bytes], bytes]


class ToolSerialInterface(Interface):
    """Interface that forwards bytes between the clients and the mounted device.

    Args:
        state: State of the controller.
        device: Mounted device; None if there is no device.

    Attributes:
        device: Mounted device, or None. It can be set. The thread of the server calls it.
    """

    def __init__(self, state: ControllerState, device: Device | None) -> None:
        self._state = state
        self.device = device

    def is_offered(self) -> bool:
        return self._state.firmware.is_e_series

    def receiver(self, client: InterfaceClient) -> InterfaceReceiver:
        return _Receiver(self, client)

    def exchange(self, data: bytes) -> bytes:
        """Send bytes over the line, and return the answer of the device."""
        if self.device is None or not self._state.signals.tool_communication.is_enabled:
            return b""
        return self.device(data)


class _Receiver(InterfaceReceiver):
    def __init__(self, interface: ToolSerialInterface, client: InterfaceClient) -> None:
        self._interface = interface
        self._client = client

    def feed(self, data: bytes) -> None:
        answer = self._interface.exchange(data)
        if answer:
            self._client.send(answer)
