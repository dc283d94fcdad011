"""Serial line of the tool connector, port 54321, as the vendor's URCap forwards it.

Assumptions: bytes are lost while the line is not enabled, an answer goes to the client that sent the request, and bytes
take no time on the line. A baud rate that differs from the device's has no effect.
"""

from __future__ import annotations

from collections.abc import Callable

from ..state import ControllerState
from .interface import Interface, InterfaceClient, InterfaceReceiver

#: Mounted device: a function that receives bytes and returns the bytes of its answer.
Device = Callable[[bytes], bytes]


class ToolSerialInterface(Interface):
    """Copies bytes between its clients and the mounted device.

    Args:
        state: State of the controller.
        device: Mounted device; None for none.

    Attributes:
        device: Mounted device. It can be set, and is called in the thread of the server.
    """

    def __init__(self, state: ControllerState, device: Device | None) -> None:
        self._state = state
        self.device = device

    def is_offered(self) -> bool:
        return self._state.firmware.is_e_series

    def receiver(self, client: InterfaceClient) -> InterfaceReceiver:
        return _Receiver(self, client)

    def exchange(self, data: bytes) -> bytes:
        """Send bytes to the line, and return the answer of the device."""
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
