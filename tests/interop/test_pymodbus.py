"""pymodbus drives the gripper at the simulated tool connector over port 54321, and is the peer of OnRobot grippers."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from typing import Any

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


# -- OnRobot over Modbus TCP --------------------------------------------------------------------------------


def test_pymodbus_moves_the_simulated_rg2() -> None:
    with urlink.connect("sim://ur5e?gripper=rg2") as robot:
        gripper = robot.controller.rg_gripper
        with client.ModbusTcpClient(robot.controller.host, port=robot.controller.ports["onrobot"]) as modbus:

            def status() -> list[int]:
                return list(modbus.read_holding_registers(258, count=18, device_id=65).registers)

            assert status()[17] == 1100
            gripper.place(0.02)
            assert not modbus.write_registers(0, [200, 0, 16], device_id=65).isError()
            until(lambda: not status()[10] & 1)
            assert status()[10] == 2
            assert status()[17] == 200
            assert not modbus.write_register(2, 8, device_id=65).isError()
            assert modbus.read_holding_registers(2, count=1, device_id=65).registers == [8]
            assert modbus.read_holding_registers(200, count=1, device_id=65).exception_code == 2
            assert modbus.read_holding_registers(258, count=1, device_id=1).exception_code == 11
            assert modbus.read_input_registers(258, count=1, device_id=65).exception_code == 1


@pytest.fixture
def compute_box() -> Iterator[int]:
    """Serve the registers of an RG2 at rest by pymodbus, and return the port."""
    datastore, server = pytest.importorskip("pymodbus.datastore"), pytest.importorskip("pymodbus.server")
    values = [0] * 300
    values[258 + 17] = 400
    # The first address of a block is one more than that of the protocol.
    device = datastore.ModbusDeviceContext(hr=datastore.ModbusSequentialDataBlock(1, values))
    context = datastore.ModbusServerContext(devices={65: device}, single=False)
    loop = asyncio.new_event_loop()
    served: list[Any] = []

    async def serve() -> None:
        served.append(server.ModbusTcpServer(context, address=("127.0.0.1", 0)))
        await served[0].serve_forever(background=True)

    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        asyncio.run_coroutine_threadsafe(serve(), loop).result(10)
        yield served[0].transport.sockets[0].getsockname()[1]
    finally:
        asyncio.run_coroutine_threadsafe(served[0].shutdown(), loop).result(10)
        loop.call_soon_threadsafe(loop.stop)
        thread.join(10)
        loop.close()


def test_rg_gripper_drives_registers_of_pymodbus(compute_box: int) -> None:
    place = {"host": "127.0.0.1", "port": compute_box}
    with urlink.connect("sim://ur5e") as robot, client.ModbusTcpClient(**place) as modbus:

        def command() -> list[int]:
            return list(modbus.read_holding_registers(0, count=3, device_id=65).registers)

        gripper = robot.gripper("rg2", host="127.0.0.1", port=compute_box)
        assert gripper.status() == (0.04, 0.0, False, False, 0)
        assert gripper.move(0.04, force=12.5).width == 0.04
        assert command() == [125, 400, 16]
        gripper.stop()
        assert command() == [125, 400, 8]
