"""Tests of robots that are closed before their first use: each call raises `Closed` and opens no connection."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import urlink
from linkcore.net.awaited import AwaitedTcp
from linkcore.net.transport import TcpTransport
from urlink.simulator import Controller

pytestmark = pytest.mark.simulated_time

#: Uses of a robot, the same in both interfaces. `rtde` and `registers` have their own connection.
USES: dict[str, Callable[[Any], Any]] = {
    "popup": lambda robot: robot.popup("x"),
    "set_payload": lambda robot: robot.set_payload(0.5),
    "set_speed_slider": lambda robot: robot.set_speed_slider(1.0),
    "io.set_digital_out": lambda robot: robot.io.set_digital_out(0, True),
    "io.digital_in": lambda robot: robot.io.digital_in(0),
    "realtime.wait": lambda robot: robot.realtime.wait(timeout=1.0),
    "realtime.subscribe": lambda robot: robot.realtime.subscribe(print),
    "primary.wait": lambda robot: robot.primary.wait(timeout=1.0),
    "secondary.wait": lambda robot: robot.secondary.wait(timeout=1.0),
    "record": lambda robot: robot.record("run.urlog"),
    "rtde.outputs": lambda robot: robot.rtde.outputs("timestamp"),
    "rtde.inputs": lambda robot: robot.rtde.inputs("input_int_register_30"),
    "rtde.missing": lambda robot: robot.rtde.missing(),
    "rtde.who_holds": lambda robot: robot.rtde.who_holds(),
    "registers.write_integer": lambda robot: robot.registers.write_integer(24, 1),
    "registers.read_integer": lambda robot: robot.registers.read_integer(24),
    "motion.move_joints": lambda robot: robot.motion.move_joints([0.0] * 6, wait=False),
    "motion.stop": lambda robot: robot.motion.stop(),
    "script.run": lambda robot: robot.script.run("sync()", wait=False),
    "script.send_line": lambda robot: robot.script.send_line("set_flag(1, True)"),
    "safety.enable": lambda robot: robot.safety.enable(),
    "dashboard.robot_mode": lambda robot: robot.dashboard.robot_mode(),
    "freedrive": lambda robot: robot.freedrive().__enter__(),
    "gripper.status": lambda robot: robot.gripper.status(),
    "interpreter": lambda robot: robot.interpreter(),
}
#: Uses that differ in the asyncio interface.
NOT_AWAITED = {"freedrive"}


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


@pytest.fixture
def closed_for_all(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[], None]:
    monkeypatch.chdir(tmp_path)

    def connect(*arguments: object) -> None:
        raise AssertionError("a robot that was closed connects")

    def close() -> None:
        monkeypatch.setattr(TcpTransport, "open", connect)
        monkeypatch.setattr(AwaitedTcp, "connect", connect)

    return close


@pytest.mark.parametrize("name", USES)
def test_closed_robot_raises_closed(controller: Controller, closed_for_all: Callable[[], None], name: str) -> None:
    robot = urlink.connect(controller.address)
    robot.close()
    closed_for_all()
    before = threading.active_count()
    with pytest.raises(urlink.Closed):
        USES[name](robot)
    assert threading.active_count() == before
    assert not Path("run.urlog").exists()


async def awaited(use: Callable[[Any], Any], robot: urlink.AsyncRobot) -> None:
    result = use(robot)
    if hasattr(result, "__await__"):
        await result


@pytest.mark.parametrize("name", sorted(USES.keys() - NOT_AWAITED))
def test_closed_async_robot_raises_closed(
    controller: Controller, closed_for_all: Callable[[], None], name: str
) -> None:
    async def use() -> None:
        robot = await urlink.connect_async(controller.address)
        await robot.close()
        closed_for_all()
        with pytest.raises(urlink.Closed):
            await awaited(USES[name], robot)
        assert asyncio.all_tasks() == {asyncio.current_task()}

    asyncio.run(use())
    assert not Path("run.urlog").exists()
