"""State, registers and programs of a robot over OPC UA, with asyncua's client."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import (
    SecurityPolicyAes128Sha256RsaOaep,
    SecurityPolicyAes256Sha256RsaPss,
    SecurityPolicyBasic256Sha256,
)

import urlink
from packages.opcua.tests.clients import PASSWORD, Keys, call, connected, read, run, until, write
from packages.opcua.tests.conftest import serving
from urlink_opcua import Access, Server

pytestmark = pytest.mark.real_time

GOOD = int(ua.StatusCodes.Good)
Int32, Double, Boolean = ua.VariantType.Int32, ua.VariantType.Double, ua.VariantType.Boolean


def test_anonymous_client_reads_state(server: Server, robot: urlink.Robot) -> None:
    async def main() -> dict[str, Any]:
        async with connected(server.url) as client:
            await until(lambda: read(client, "Connected"))
            names = ("Model", "Firmware", "JointPositions", "SafetyModeName", "SafetyMode", "RobotModeName", "ToolPose")
            return {name: await read(client, name) for name in names}

    found = run(main())
    state = robot.realtime.wait()
    assert (found["Model"], found["Firmware"]) == ("UR5e", "5.11")
    assert found["JointPositions"] == pytest.approx(state.q_actual.tolist(), abs=1e-3)
    assert found["ToolPose"] == pytest.approx(state.tool_vector_actual.tolist(), abs=1e-3)
    assert (found["SafetyModeName"], found["SafetyMode"]) == ("NORMAL", 1)
    assert found["RobotModeName"] == "RUNNING"


def test_value_carries_time_of_its_packet(server: Server, robot: urlink.Robot) -> None:
    async def main() -> float:
        async with connected(server.url) as client:
            value = await client.get_node("ns=2;s=arm.JointTemperatures").read_data_value()
            return value.SourceTimestamp.replace(tzinfo=None).timestamp() if value.SourceTimestamp else 0.0

    before = robot.realtime.wait().received
    assert before is not None
    assert run(main()) > 0.0


def test_client_receives_changes_by_subscription(server: Server, keys: dict[str, Keys]) -> None:
    seen: asyncio.Queue[str]

    class Handler:
        def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
            seen.put_nowait(value)

    async def main() -> None:
        nonlocal seen
        seen = asyncio.Queue()
        async with connected(server.url, keys["client"]) as client:
            subscription = await client.create_subscription(20, Handler())
            await subscription.subscribe_data_change(client.get_node("ns=2;s=arm.ProgramStateName"))
            assert await seen.get() == "STOPPED"
            assert await call(client, "LoadProgram", "pick.urp") == GOOD
            assert await call(client, "PlayProgram") == GOOD
            assert await seen.get() == "PLAYING"

    run(main())


@pytest.mark.parametrize(
    "policy", [SecurityPolicyBasic256Sha256, SecurityPolicyAes128Sha256RsaOaep, SecurityPolicyAes256Sha256RsaPss]
)
def test_client_runs_pauses_and_stops_program(server: Server, keys: dict[str, Keys], policy: Any) -> None:
    async def main() -> None:
        async with connected(server.url, keys["client"], policy=policy) as client:

            async def is_in(state: str) -> bool:
                return bool(await read(client, "ProgramStateName") == state)

            for name, arguments, state in (
                ("LoadProgram", ("pick.urp",), "STOPPED"),
                ("PlayProgram", (), "PLAYING"),
                ("PauseProgram", (), "PAUSED"),
                ("PlayProgram", (), "PLAYING"),
                ("StopProgram", (), "STOPPED"),
            ):
                assert await call(client, name, *arguments) == GOOD
                await until(lambda state=state: is_in(state))  # type: ignore[misc]
            await until(lambda: _equals(client, "LastCommand.Name", "StopProgram"))
            assert "CN=client" in await read(client, "LastCommand.Client")

    run(main())


async def _equals(client: Client, name: str, value: object) -> bool:
    return bool(await read(client, name) == value)


def test_registers_are_exchanged_with_program(server: Server, keys: dict[str, Keys], robot: urlink.Robot) -> None:
    async def main() -> None:
        async with connected(server.url, keys["client"]) as client:
            assert await write(client, "InputInteger24", 41, Int32) == GOOD
            assert await write(client, "InputFloat25", 1.5, Double) == GOOD
            assert await write(client, "InputBit70", True, Boolean) == GOOD
            assert await read(client, "InputInteger24") == 41
            assert await call(client, "LoadProgram", "turn.urp") == GOOD
            assert await call(client, "PlayProgram") == GOOD
            await until(lambda: _equals(client, "OutputInteger24", 42))

    run(main())


@pytest.mark.parametrize(
    ("name", "value", "variant", "status"),
    [
        ("InputInteger24", 1.5, Double, ua.StatusCodes.BadTypeMismatch),
        ("InputInteger24", [1, 2], Int32, ua.StatusCodes.BadTypeMismatch),
        ("InputFloat24", float("nan"), Double, ua.StatusCodes.BadInvalidArgument),
        ("OutputInteger24", 1, Int32, ua.StatusCodes.BadUserAccessDenied),
        ("SpeedScaling", 0.5, Double, ua.StatusCodes.BadUserAccessDenied),
        ("Model", "UR3", ua.VariantType.String, ua.StatusCodes.BadUserAccessDenied),
    ],
)
def test_wrong_write_is_refused(
    server: Server, keys: dict[str, Keys], name: str, value: Any, variant: ua.VariantType, status: int
) -> None:
    async def main() -> int:
        async with connected(server.url, keys["client"]) as client:
            return await write(client, name, value, variant)

    assert run(main()) == status


@pytest.mark.parametrize(
    ("name", "arguments", "status", "message"),
    [
        ("LoadProgram", (), ua.StatusCodes.BadArgumentsMissing, ""),
        ("LoadProgram", ("a", "b"), ua.StatusCodes.BadTooManyArguments, ""),
        ("LoadProgram", (5,), ua.StatusCodes.BadInvalidArgument, ""),
        ("LoadProgram", ("",), ua.StatusCodes.BadInvalidArgument, ""),
        ("LoadProgram", ("a\nplay",), ua.StatusCodes.BadInvalidArgument, "load"),
        ("LoadProgram", ("nothing.urp",), ua.StatusCodes.BadInvalidState, "File not found: nothing.urp"),
        ("PlayProgram", (1,), ua.StatusCodes.BadTooManyArguments, ""),
        ("PauseProgram", (), ua.StatusCodes.BadInvalidState, "pause"),
        ("Model", (), ua.StatusCodes.BadMethodInvalid, ""),
    ],
)
def test_wrong_call_is_refused_with_reason(
    server: Server, keys: dict[str, Keys], name: str, arguments: tuple[Any, ...], status: int, message: str
) -> None:
    async def main() -> str:
        async with connected(server.url, keys["client"]) as client:
            count = await read(client, "LastCommand.Count")
            assert await call(client, name, *arguments) == status
            if not message:
                return ""
            await until(lambda: _equals(client, "LastCommand.Count", count + 1))
            assert await read(client, "LastCommand.Status") == status
            return str(await read(client, "LastCommand.Error"))

    assert message in run(main())


def test_method_of_other_object_is_refused(server: Server, keys: dict[str, Keys]) -> None:
    async def main() -> int:
        async with connected(server.url, keys["client"]) as client:
            request = ua.CallMethodRequest(
                ObjectId=ua.NodeId(ua.ObjectIds.Server), MethodId=ua.NodeId("arm.PlayProgram", 2), InputArguments=[]
            )
            return int((await client.uaclient.call([request]))[0].StatusCode.value)

    assert run(main()) == ua.StatusCodes.BadMethodInvalid


def test_stop_does_not_wait_for_other_command(server: Server, keys: dict[str, Keys], robot: urlink.Robot) -> None:
    """A stop on the same connection ends a call that the dashboard delays, and the program does not start."""

    async def main() -> None:
        async with connected(server.url, keys["client"]) as client:
            assert await call(client, "LoadProgram", "turn.urp") == GOOD
            before = await read(client, "LastCommand.Count")
            robot.controller.faults.stall(3.0, "dashboard")
            assert await call(client, "PlayProgram") == ua.StatusCodes.GoodCompletesAsynchronously
            assert await call(client, "StopProgram") in (GOOD, ua.StatusCodes.GoodCompletesAsynchronously)
            await until(lambda: _exceeds(client, "LastCommand.Count", before + 1))
            await until(lambda: _equals(client, "ProgramStateName", "STOPPED"))

    run(main())
    assert robot.realtime.wait().q_target[0] < 0.5


async def _exceeds(client: Client, name: str, value: int) -> bool:
    return bool(await read(client, name) > value)


def test_lost_client_abandons_its_pending_command(server: Server, keys: dict[str, Keys], robot: urlink.Robot) -> None:
    async def main() -> None:
        async with connected(server.url, keys["client"]) as watching:
            async with connected(server.url, keys["client"]) as client:
                assert await call(client, "LoadProgram", "pick.urp") == GOOD
                before = await read(watching, "LastCommand.Count")
                robot.controller.faults.stall(2.0, "dashboard")
                assert await call(client, "PlayProgram") == ua.StatusCodes.GoodCompletesAsynchronously
            await until(lambda: _exceeds(watching, "LastCommand.Count", before))
            assert await read(watching, "LastCommand.Status") == ua.StatusCodes.BadOperationAbandoned
            # `play` is undone at the next contact with the dashboard.
            await call(watching, "LoadProgram", "pick.urp")
            await until(lambda: _equals(watching, "ProgramStateName", "STOPPED"))

    run(main())


def test_two_clients_share_one_robot(server: Server, keys: dict[str, Keys]) -> None:
    async def main() -> None:
        async with (
            connected(server.url, keys["client"]) as first,
            connected(server.url, keys["stranger"], user="operator", password=PASSWORD) as second,
        ):
            assert await call(first, "LoadProgram", "pick.urp") == GOOD
            assert await call(first, "PlayProgram") == GOOD
            await until(lambda: _equals(second, "ProgramStateName", "PLAYING"))
            assert await call(second, "StopProgram") == GOOD
            await until(lambda: _equals(first, "ProgramStateName", "STOPPED"))
            await until(lambda: _equals(first, "LastCommand.Name", "StopProgram"))
            assert (await read(first, "LastCommand.Client")).startswith("operator (")

    run(main())


def test_program_does_not_start_against_interlock(server: Server, keys: dict[str, Keys], robot: urlink.Robot) -> None:
    async def main() -> None:
        async with connected(server.url, keys["client"]) as client:
            assert await call(client, "LoadProgram", "pick.urp") == GOOD
            robot.safety.policy = "always"
            try:
                await until(lambda: read(client, "PlayRefusal"))
                assert await call(client, "PlayProgram") == ua.StatusCodes.BadInvalidState
                assert "enable" in await read(client, "PlayRefusal")
                assert await read(client, "ProgramStateName") == "STOPPED"
            finally:
                robot.safety.policy = "never"

    run(main())


@pytest.mark.slow
def test_command_after_close_is_refused_and_program_is_reported(
    robot: urlink.Robot, keys: dict[str, Keys], access: Access, caplog: pytest.LogCaptureFixture
) -> None:
    async def main(server: Server) -> int:
        async with connected(server.url, keys["client"]) as client:
            assert await call(client, "LoadProgram", "pick.urp") == GOOD
            assert await call(client, "PlayProgram") == GOOD
            await until(lambda: _equals(client, "ProgramStateName", "PLAYING"))
            for commands in server._commands:  # as `close` does first
                commands.close()
            return await call(client, "PauseProgram")

    with serving(robot, keys, access, allow=True) as server, caplog.at_level(logging.WARNING, "urlink.opcua"):
        assert run(main(server)) == ua.StatusCodes.BadServerHalted
    assert "the program that CN=client" in caplog.text
    assert "is still running" in caplog.text
    assert robot.dashboard.running()
    robot.dashboard.stop()


@pytest.mark.slow
def test_commands_are_refused_without_allow(robot: urlink.Robot, keys: dict[str, Keys], access: Access) -> None:
    async def main(server: Server) -> None:
        async with connected(server.url, keys["client"]) as client:
            for name, arguments in (("LoadProgram", ("pick.urp",)), ("PlayProgram", ()), ("StopProgram", ())):
                assert await call(client, name, *arguments) == ua.StatusCodes.BadNotExecutable
            status = await write(client, "InputInteger24", 1, Int32)
            assert status == ua.StatusCodes.BadUserAccessDenied
            assert await read(client, "Connected") is True

    with serving(robot, keys, access, allow=False) as server:
        run(main(server))


@pytest.mark.slow
def test_lost_robot_is_shown_until_it_is_back(keys: dict[str, Keys], access: Access) -> None:
    async def main(server: Server, robot: urlink.Robot) -> None:
        async with connected(server.url, keys["client"]) as client:
            node = client.get_node("ns=2;s=arm.JointPositions")

            async def status() -> int:
                return int((await node.read_data_value(raise_on_bad_status=False)).StatusCode.value)

            async def has(expected: int) -> bool:
                return await status() == expected

            await until(lambda: has(GOOD))
            robot.controller.faults.reboot(downtime=3.0)
            await until(lambda: has(ua.StatusCodes.BadNoCommunication))
            assert await read(client, "Connected") is False
            assert await call(client, "PlayProgram") != GOOD
            await until(lambda: has(GOOD))
            assert await read(client, "Connected") is True
            assert await call(client, "LoadProgram", "pick.urp") == GOOD

    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.controller.pendant.files["pick.urp"] = "def pick():\n  sleep(600)\nend"
        with serving(robot, keys, access, allow=True) as server:
            run(main(server, robot))


@pytest.mark.slow
def test_controller_without_rtde_is_served_without_registers(keys: dict[str, Keys], access: Access) -> None:
    async def main(server: Server) -> list[str]:
        async with connected(server.url) as client:
            children = await client.get_node("ns=2;s=arm.Registers").get_children()
            assert (await read(client, "Firmware")).startswith("1.8")
            return [str(each) for each in children]

    with (
        urlink.connect("sim://ur5?firmware=1.8", read_only=True) as robot,
        serving(robot, keys, access, allow=False) as server,
    ):
        assert run(main(server)) == []
