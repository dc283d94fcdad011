"""The tool's serial line, 54321: the line of the tool connector, as the vendor's URCap forwards it.

Assumed: bytes are lost while the line is not enabled, an answer goes to the client that asked, and bytes take no time
on the line. A baud rate other than the device's is not noticed.
"""

from __future__ import annotations

from collections.abc import Callable

from ..state import ControllerState
from .interface import Interface, InterfaceClient, InterfaceReceiver

#: What is mounted: called with the bytes that come, it returns those that it answers with.
Device = Callable[[bytes], bytes]


class ToolSerialInterface(Interface):
    """Copies bytes between its clients and what is mounted.

    Args:
        state: of the controller.
        device: what is mounted; None for nothing.

    Attributes:
        device: the same; can be set, and is called in the thread of the server.
    """

    def __init__(self, state: ControllerState, device: Device | None) -> None:
        self._state = state
        self.device = device

    def is_offered(self) -> bool:
        return self._state.firmware.is_e_series

    def receiver(self, client: InterfaceClient) -> InterfaceReceiver:
        return _Receiver(self, client)

    def exchange(self, data: bytes) -> bytes:
        """What comes back for bytes that are sent to the line."""
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
