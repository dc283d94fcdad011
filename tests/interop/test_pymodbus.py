"""pymodbus drives the gripper at the simulated tool connector over port 54321."""

from __future__ import annotations

import pytest

import urlink
from tests.waiting import until

pymodbus = pytest.importorskip("pymodbus")
client = pytest.importorskip("pymodbus.client")

pytestmark = [pytest.mark.real_time, pytest.mark.timeout(120)]


def test_pymodbus_activates_and_closes_the_gripper() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.io.set_tool_communication()
        place = {"port": robot.controller.ports["tool_serial"], "framer": pymodbus.FramerType.RTU}
        with client.ModbusTcpClient(robot.controller.host, **place) as modbus:

            def status() -> int:
                return int(modbus.read_holding_registers(0x07D0, count=3, device_id=9).registers[0] >> 8)

            modbus.write_registers(0x03E8, [0, 0, 0], device_id=9)
            modbus.write_registers(0x03E8, [0x0100, 0, 0], device_id=9)
            until(lambda: status() >> 4 & 3 == 3)
            modbus.write_registers(0x03E8, [0x0900, 0x00FF, 0xFFFF], device_id=9)
            until(lambda: robot.controller.gripper.position == 255)
            assert status() >> 6 == 3
            assert modbus.read_holding_registers(0x0000, count=1, device_id=9).isError()
