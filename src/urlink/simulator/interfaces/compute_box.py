"""Compute Box of OnRobot: the Modbus TCP server for a simulated RG2 or RG6.

A real Compute Box has its own address, and uses port 502. Its replies follow the standard for Modbus TCP. Assumption: a
Compute Box without a gripper replies with exception 11, like a gateway whose device does not respond.
"""

from __future__ import annotations

import struct

from linkcore.errors import WrongPeer
from urlink.protocol.gripper.modbus_tcp import MOST_READ, READ, REJECTED, WRITE, frame, split_frame
from urlink.protocol.gripper.onrobot import UNIT

from ..robot.rg_gripper import SimulatedRGGripper
from ..state import Counters
from .interface import Interface, InterfaceClient, InterfaceReceiver

#: Function: write one register.
_WRITE_ONE = 6
#: Exception codes: unknown function, unknown register, invalid number of registers, no device.
_NO_FUNCTION, _NO_REGISTER, _NO_VALUE, _NO_DEVICE = 1, 2, 3, 11


class ComputeBoxInterface(Interface):
    """Interface that serves the registers of the mounted gripper.

    Args:
        gripper: Mounted gripper; None if no OnRobot gripper is mounted.
        counters: Counters to which the bytes of other protocols are added.
    """

    def __init__(self, gripper: SimulatedRGGripper | None, counters: Counters) -> None:
        self._gripper = gripper
        self._counters = counters

    def is_offered(self) -> bool:
        return self._gripper is not None

    def receiver(self, client: InterfaceClient) -> InterfaceReceiver:
        assert self._gripper is not None, "the interface is not offered without a gripper"
        return _Receiver(self._gripper, client, self._counters)


class _Receiver(InterfaceReceiver):
    def __init__(self, gripper: SimulatedRGGripper, client: InterfaceClient, counters: Counters) -> None:
        self._gripper = gripper
        self._client = client
        self._counters = counters
        self._waiting = b""

    def feed(self, data: bytes) -> None:
        self._waiting += data
        while self._client.is_open:
            try:
                found = split_frame(self._waiting)
            except WrongPeer:
                self._counters.refused_bytes += len(self._waiting)
                self._waiting = b""
                self._client.drop()
                return
            if found is None:
                return
            transaction, unit, body, self._waiting = found
            self._client.send(frame(transaction, unit, self._answer(unit, body)))

    def _answer(self, unit: int, body: bytes) -> bytes:
        function, first = body[0], int.from_bytes(body[1:3], "big")
        if unit != UNIT or not self._gripper.is_connected:
            return bytes((function | REJECTED, _NO_DEVICE))
        if function == READ and len(body) == 5:
            count = int.from_bytes(body[3:5], "big")
            if not 1 <= count <= MOST_READ:
                return bytes((function | REJECTED, _NO_VALUE))
            if not self._gripper.has(first, count):
                return bytes((function | REJECTED, _NO_REGISTER))
            return bytes((function, 2 * count)) + struct.pack(f">{count}H", *self._gripper.read(first, count))
        if function in (WRITE, _WRITE_ONE) and len(body) >= 5:
            words = body[6:] if function == WRITE else body[3:]
            count = len(words) // 2
            is_consistent = function == _WRITE_ONE or body[3:6] == struct.pack(">HB", count, len(words))
            if not count or len(words) % 2 or not is_consistent:
                return bytes((function | REJECTED, _NO_VALUE))
            if not self._gripper.write(first, struct.unpack(f">{count}H", words)):
                return bytes((function | REJECTED, _NO_REGISTER))
            return body[:5]
        return bytes((function | REJECTED, _NO_FUNCTION))
