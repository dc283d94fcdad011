"""Gripper interface, port 63352: the server of the Robotiq URCap, which replies to lines of text.

The replies have the form that public clients and the programs of the URCap expect: a newline follows a value, but not
`ack`.
"""

from __future__ import annotations

from ..robot.mounted_gripper import UrcapGripper
from ..state import ControllerState
from .interface import Interface, InterfaceClient, LineReceiver


class GripperInterface(Interface):
    """Interface that serves the gripper of one controller.

    Args:
        state: State of the controller.
        gripper: Mounted gripper, with fingers or suction cups; None if this URCap is not installed.
    """

    def __init__(self, state: ControllerState, gripper: UrcapGripper | None) -> None:
        self._state = state
        self._gripper = gripper

    def is_offered(self) -> bool:
        # URCaps were introduced with CB3.
        return self._gripper is not None and not self._state.firmware.is_cb2

    def receiver(self, client: InterfaceClient) -> LineReceiver:
        gripper = self._gripper
        assert gripper is not None, "the interface is not offered without a gripper"

        def answer(line: str) -> None:
            reply = gripper.reply(line)
            if reply is not None:
                client.send(reply.encode("ascii") if reply == "ack" else f"{reply}\n".encode("ascii"))

        return LineReceiver(client, self._state.counters, answer)
