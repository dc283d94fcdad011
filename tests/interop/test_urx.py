"""The third-party client urx reads the same values from the simulator as urlink, and moves its arm.

urx 0.11 reads states from the secondary interface and, optionally, from the real-time interface. It always uses the
standard ports. In the states it requires mode data of 46 bytes, which firmware 3.2 to 3.4 sends.

In the first tests the arm moves continuously. Both clients get the same packets, so each value of urx must equal the
value in one of the packets of urlink, to the last bit.

In the later tests, urx moves the arm. It sends single lines, each of which is a program. Then it waits until no program
runs and the distance to the goal is below a threshold. The default threshold of urx is most of the distance, so the
tests pass a small one.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, TypeVar

import pytest

import urlink
from linkcore.errors import BadAddress
from linkcore.streaming.stream import Stream
from tests.waiting import until
from urlink.packets import CartesianInfo, JointData, MasterboardData, RealtimeState, RobotState
from urlink.simulator import Controller, Demonstration

urx = pytest.importorskip("urx", reason="urx is not installed; `nox -s interop` installs it")

pytestmark = pytest.mark.real_time

#: Three inputs of the control box, a configurable one, and one of the tool.
INPUTS = (0, 2, 7, 9, 17)
#: Joint positions with the elbow up and the tool down, in rad.
READY = [0.0, -1.6, 1.6, -1.6, -1.6, 0.0]
#: Distance from the goal, in rad or m, at which urx should consider a movement ended.
NEAR = 1e-3

S = TypeVar("S")


@pytest.fixture(scope="module")
def controller() -> Iterator[Controller]:
    controller = Controller("UR5", "3.2", ports="standard", host="127.0.0.1", motion=Demonstration())
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
    """Robot of urx. It is closed before the simulator, because urx loops forever on an ended connection."""
    logging.getLogger("urx").setLevel(logging.ERROR)
    robot = urx.Robot(controller.host, use_rt=True)
    try:
        yield robot
    finally:
        robot.close()


def agrees(stream: Stream[S], read: Callable[[], Any], agree: Callable[[S, Any], bool], times: int = 5) -> list[Any]:
    """Read the value of the other client `times` times; each time, one state of urlink must agree with it."""
    states: list[S] = []
    values = []
    with stream.subscribe(states.append, policy=urlink.block):
        stream.wait()
        for _ in range(times):
            value = read()
            # The other client may be ahead of urlink, but in the end each of its values must appear here, too.
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


def test_simulator_sends_the_firmware_that_urx_reads(ours: urlink.Robot) -> None:
    assert (str(ours.firmware), ours.model) == ("3.2", "UR5")
    state = ours.secondary.wait()
    assert state.robot_mode_data is not None
    assert len(bytes(state.robot_mode_data)) == 46


def test_joint_positions_of_urx_and_urlink_are_equal(ours: urlink.Robot, theirs: Any) -> None:
    values = agrees(
        ours.secondary, lambda: theirs.getj(wait=True), lambda state, read: read == joints_of(state).q_actual.tolist()
    )
    assert all(len(value) == 6 for value in values)
    assert differ(values), "the arm must move during the test"


def test_tool_poses_of_urx_and_urlink_are_equal(ours: urlink.Robot, theirs: Any) -> None:
    def raw() -> Any:
        # Read the received pose before `Robot.getl` converts it to a rotation matrix and back to a vector.
        return urx.urrobot.URRobot.getl(theirs, wait=True)

    values = agrees(ours.secondary, raw, lambda state, read: list(read) == pose_of(state))
    assert all(len(value) == 6 for value in values)
    assert differ(values)


def test_tool_poses_of_urx_and_urlink_are_equal_with_math3d(ours: urlink.Robot, theirs: Any) -> None:
    agrees(
        ours.secondary,
        lambda: theirs.getl(wait=True),
        lambda state, read: bool(read == pytest.approx(pose_of(state), abs=1e-12, rel=1e-12)),
    )


def is_shown(read: Callable[[], int], bits: int) -> bool:
    return read() == bits


def test_digital_inputs_of_urx_and_urlink_are_equal(controller: Controller, ours: urlink.Robot, theirs: Any) -> None:
    expected = sum(1 << number for number in INPUTS)
    for bits in (expected, 0b1010, expected):
        controller.signals.digital_inputs = bits
        until(partial(is_shown, theirs.get_digital_in_bits, bits))
        until(partial(is_shown, lambda: ours.secondary.of(MasterboardData).wait().digital_input_bits, bits))
        assert [number for number in range(18) if theirs.get_digital_in(number)] == [
            number for number in range(18) if bits >> number & 1
        ]


def test_realtime_states_of_urx_and_urlink_are_equal(ours: urlink.Robot, theirs: Any) -> None:
    monitor = theirs.get_realtime_monitor()

    def read() -> dict[str, Any]:
        # Read between two packets, because otherwise the parts could belong to different packets.
        monitor.wait()
        with monitor._dataAccess:
            return {"q": monitor._qActual, "target": monitor._qTarget, "force": monitor._tcp_force}

    def agree(state: RealtimeState, read: dict[str, Any]) -> bool:
        ours = {"q": state.q_actual, "target": state.q_target, "force": state.tcp_force}
        return all(ours[name].tolist() == value.tolist() for name, value in read.items())

    values = agrees(ours.realtime, read, agree, times=20)
    assert differ([value["q"].tolist() for value in values])


# -- urx moves the arm -----------------------------------------------------------------------------------


def stands(ours: urlink.Robot) -> bool:
    return not ours.realtime.wait(5).qd_target.any()


def goes(ours: urlink.Robot, to: list[float], theirs: Any) -> None:
    """Make urx move the joints quickly, and wait until urx considers the movement ended."""
    read = theirs.movej(to, acc=8.0, vel=2.0, threshold=NEAR)
    assert read == pytest.approx(to, abs=NEAR)
    assert ours.realtime.wait(5).q_target == pytest.approx(to, abs=1e-6)
    assert not theirs.is_program_running()


def test_urx_moves_the_joints(ours: urlink.Robot, theirs: Any) -> None:
    goes(ours, READY, theirs)
    goes(ours, [*READY[:5], 0.4], theirs)
    goes(ours, READY, theirs)


def test_urx_moves_the_joints_relatively(ours: urlink.Robot, theirs: Any) -> None:
    goes(ours, READY, theirs)
    read = theirs.movej([0.1, 0, 0, 0, 0, -0.1], acc=8.0, vel=2.0, relative=True, threshold=NEAR)
    assert read == pytest.approx([0.1, *READY[1:5], -0.1], abs=NEAR)


def test_urx_moves_the_tool_in_a_line(ours: urlink.Robot, theirs: Any) -> None:
    goes(ours, READY, theirs)
    begin = theirs.getl(wait=True)
    goal = [begin[0] + 0.02, begin[1], begin[2] - 0.05, *begin[3:]]
    states: list[RealtimeState] = []
    with ours.realtime.subscribe(states.append, policy=urlink.block):
        theirs.movel(goal, acc=2.0, vel=0.3, threshold=NEAR)
    assert theirs.getl(wait=True) == pytest.approx(goal, abs=NEAR)
    way = math.dist(begin[:3], goal[:3])
    for state in states:
        assert state.tool_vector_target is not None
        here = state.tool_vector_target[:3]
        assert math.dist(begin[:3], here) + math.dist(here, goal[:3]) == pytest.approx(way, abs=1e-4), "not on the line"


def test_urx_moves_along_several_lines(ours: urlink.Robot, theirs: Any) -> None:
    goes(ours, READY, theirs)
    begin = theirs.getl(wait=True)
    goal = [begin[0], begin[1] + 0.05, begin[2] + 0.05, *begin[3:]]
    over = [begin[0], begin[1], begin[2] + 0.05, *begin[3:]]
    theirs.movels([over, goal], acc=2.0, vel=0.3, radius=0.01, threshold=NEAR)
    assert theirs.getl(wait=True) == pytest.approx(goal, abs=NEAR)


def test_urx_stops_a_long_movement(ours: urlink.Robot, theirs: Any) -> None:
    goes(ours, READY, theirs)
    far = [*READY[:5], 3.0]
    theirs.movej(far, acc=2.0, vel=0.5, wait=False)
    until(lambda: theirs.getj(wait=True)[5] > 0.3)
    assert theirs.is_program_running()
    theirs.stopj(acc=4.0)
    until(lambda: stands(ours))
    until(lambda: not theirs.is_program_running())
    state = ours.realtime.wait(5)
    assert 0.3 < state.q_actual[5] < 1.5, "the joint must stop between start and goal"
    assert theirs.getj(wait=True) == pytest.approx(state.q_actual, abs=1e-3)
    goes(ours, READY, theirs)


@pytest.mark.parametrize("output", [0, 5, 8])
def test_urx_switches_outputs(controller: Controller, ours: urlink.Robot, theirs: Any, output: int) -> None:
    """urx sends `digital_out[n]=True` as a separate line. Number 8 is the first output of the tool, which is bit 16."""
    goes(ours, READY, theirs)
    bit = 1 << (output if output < 8 else output + 8)
    for value in (True, False, True):
        theirs.set_digital_out(output, value)
        bits = bit if value else 0
        until(partial(is_shown, theirs.get_digital_out_bits, bits))
        until(partial(is_shown, lambda: ours.secondary.of(MasterboardData).wait().digital_output_bits, bits))
    theirs.set_digital_out(output, False)
    until(partial(is_shown, theirs.get_digital_out_bits, 0))
    assert controller.signals.digital_outputs == 0


def test_output_switched_by_urx_ends_the_running_program(ours: urlink.Robot, theirs: Any) -> None:
    """A movement stops if urx switches an output while it runs.

    According to the documentation of urx, a real controller does so for every line. urlink switches outputs in a `sec`
    program, which does not stop the movement.
    """
    goes(ours, READY, theirs)
    theirs.movej([*READY[:5], 3.0], acc=2.0, vel=0.5, wait=False)
    until(lambda: theirs.getj(wait=True)[5] > 0.3)
    theirs.set_digital_out(1, True)
    until(partial(is_shown, theirs.get_digital_out_bits, 0b10))
    until(lambda: stands(ours))
    assert 0.3 < ours.realtime.wait(5).q_actual[5] < 1.5
    theirs.set_digital_out(1, False)
    until(partial(is_shown, theirs.get_digital_out_bits, 0))
