"""urx, a client that other people wrote, reads from the simulator what urlink reads.

urx 0.11 takes its state from the secondary interface and, if asked, from the real-time one, on the standard ports and
no others; in the states it insists on mode data of 46 bytes, which firmware 3.2 to 3.4 sends.

The arm moves all the while. Both clients are sent the same packets, so what urx shows is what stands in one of those
that urlink got, to the last bit, and in no other.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import pytest

import urlink
from linkcore.errors import BadAddress
from linkcore.stream import Stream
from tests.waiting import until
from urlink import CartesianInfo, JointData, MasterboardData, RealtimeState, RobotState
from urlink.simulator import Controller

urx = pytest.importorskip("urx", reason="urx is not installed; `nox -s interop` installs it")

#: Three of the control box, a configurable one, and one of the tool.
INPUTS = (0, 2, 7, 9, 17)

S = TypeVar("S")


@pytest.fixture(scope="module")
def controller() -> Iterator[Controller]:
    controller = Controller(model="UR5", firmware="3.2", ports="standard", host="127.0.0.1")
    for number in INPUTS:
        controller.signals.set_digital_input(number, True)
    try:
        controller.start()
    except BadAddress as error:
        pytest.skip(f"urx knows the standard ports only, and they are taken here: {error}")
    with controller:
        yield controller


@pytest.fixture(scope="module")
def ours(controller: Controller) -> Iterator[urlink.Robot]:
    with urlink.connect(controller.host) as robot:
        yield robot


@pytest.fixture(scope="module")
def theirs(controller: Controller) -> Iterator[Any]:
    """Closed before the simulator is: urx spins on a connection that has ended."""
    logging.getLogger("urx").setLevel(logging.ERROR)
    robot = urx.Robot(controller.host, use_rt=True)
    try:
        yield robot
    finally:
        robot.close()


def agrees(stream: Stream[S], read: Callable[[], Any], agree: Callable[[S, Any], bool], times: int = 5) -> list[Any]:
    """Read `times` times what the other client has; each time one state of ours must agree with it."""
    states: list[S] = []
    values = []
    with stream.subscribe(states.append, policy=urlink.block):
        stream.wait()
        for _ in range(times):
            value = read()
            # The other client may be ahead of us; of what it shows nothing may be missing here in the end.
            until(partial(is_among, states, agree, value))
            values.append(value)
    return values


def is_among(states: list[S], agree: Callable[[S, Any], bool], value: object) -> bool:
    return any(agree(state, value) for state in list(states))


def joints_of(state: RobotState) -> JointData:
    assert state.joint_data is not None
    return state.joint_data


def pose_of(state: RobotState) -> list[float]:
    info = state.cartesian_info
    assert isinstance(info, CartesianInfo)
    return [info.X, info.Y, info.Z, info.Rx, info.Ry, info.Rz]


def differ(values: Sequence[Any]) -> bool:
    return len({tuple(value) for value in values}) > 1


def test_the_simulator_sends_what_urx_reads(ours: urlink.Robot) -> None:
    assert (str(ours.firmware), ours.model) == ("3.2", "UR5")
    state = ours.secondary.wait()
    assert state.robot_mode_data is not None
    assert len(bytes(state.robot_mode_data)) == 46


def test_joint_positions_are_equal(ours: urlink.Robot, theirs: Any) -> None:
    values = agrees(
        ours.secondary, lambda: theirs.getj(wait=True), lambda state, read: read == joints_of(state).q_actual.tolist()
    )
    assert all(len(value) == 6 for value in values)
    assert differ(values), "the arm moves"


def test_tool_poses_are_equal(ours: urlink.Robot, theirs: Any) -> None:
    def raw() -> Any:
        # What was received, before `Robot.getl` makes a rotation matrix and a vector again of it.
        return urx.urrobot.URRobot.getl(theirs, wait=True)

    values = agrees(ours.secondary, raw, lambda state, read: list(read) == pose_of(state))
    assert all(len(value) == 6 for value in values)
    assert differ(values)


def test_tool_poses_are_equal_through_its_mathematics(ours: urlink.Robot, theirs: Any) -> None:
    agrees(
        ours.secondary,
        lambda: theirs.getl(wait=True),
        lambda state, read: bool(read == pytest.approx(pose_of(state), abs=1e-12, rel=1e-12)),
    )


def is_shown(read: Callable[[], int], bits: int) -> bool:
    return read() == bits


def test_digital_inputs_are_equal(controller: Controller, ours: urlink.Robot, theirs: Any) -> None:
    expected = sum(1 << number for number in INPUTS)
    for bits in (expected, 0b1010, expected):
        controller.signals.digital_inputs = bits
        until(partial(is_shown, theirs.get_digital_in_bits, bits))
        until(partial(is_shown, lambda: ours.secondary.of(MasterboardData).wait().digital_input_bits, bits))
        assert [number for number in range(18) if theirs.get_digital_in(number)] == [
            number for number in range(18) if bits >> number & 1
        ]


def test_the_realtime_interface_is_equal(ours: urlink.Robot, theirs: Any) -> None:
    monitor = theirs.get_realtime_monitor()

    def read() -> dict[str, Any]:
        # Between two packets, or the parts would be of several.
        monitor.wait()
        with monitor._dataAccess:
            return {"q": monitor._qActual, "target": monitor._qTarget, "force": monitor._tcp_force}

    def agree(state: RealtimeState, read: dict[str, Any]) -> bool:
        ours = {"q": state.q_actual, "target": state.q_target, "force": state.tcp_force}
        return all(ours[name].tolist() == value.tolist() for name, value in read.items())

    values = agrees(ours.realtime, read, agree, times=20)
    assert differ([value["q"].tolist() for value in values])
