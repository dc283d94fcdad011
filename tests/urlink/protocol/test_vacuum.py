"""Vacuum grippers of Robotiq: the values of their variables, the simulated gripper, and the gripper of a user."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

import urlink
from linkcore.errors import BadValue, ConnectFailed, LinkTimeout, LocalError
from tests.fakes.clock import Clock
from urlink.packets import SuctionStatus
from urlink.protocol.gripper.protocol import READABLE, set_line, value_of
from urlink.protocol.gripper.vacuum import VACUUM_WRITABLE, grip_values, vacuum_of
from urlink.simulator import Controller
from urlink.simulator.robot.suction import SimulatedVacuumGripper

pytestmark = pytest.mark.simulated_time

# -- values ----------------------------------------------------------------------------------------------


@pytest.mark.property
@given(st.floats(1.0, 100.0), st.floats(1.0, 100.0), st.floats(0.1, 25.5))
def test_grip_values_are_valid_variables(one: float, other: float, seconds: float) -> None:
    minimum, vacuum = sorted((one, other))
    values = grip_values(vacuum, minimum, seconds)
    assert set_line(values, VACUUM_WRITABLE).startswith("SET MOD 1 POS")
    assert vacuum_of(values["POS"]) == pytest.approx(vacuum, abs=0.51)
    assert vacuum_of(values["FOR"]) == pytest.approx(minimum, abs=0.51)
    assert values["SPE"] / 10.0 == pytest.approx(seconds, abs=0.051)


@pytest.mark.parametrize(
    ("vacuum", "minimum", "seconds", "error"),
    [
        (101.0, 40.0, 3.0, "vacuum is 101"),
        (60.0, 0.0, 3.0, "minimum is 0"),
        (60.0, 61.0, 3.0, "minimum=61 kPa exceeds vacuum=60 kPa"),
        (60.0, 40.0, 26.0, "object_timeout is 26"),
    ],
)
def test_grip_with_invalid_value_is_rejected(vacuum: float, minimum: float, seconds: float, error: str) -> None:
    with pytest.raises(BadValue, match=error):
        grip_values(vacuum, minimum, seconds)


# -- the simulated gripper -------------------------------------------------------------------------------


class VacuumMachine(RuleBasedStateMachine):
    """Random operations: variables stay in their ranges, and only an object gives a vacuum."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = Clock()
        self.gripper = SimulatedVacuumGripper(self.clock)
        self.is_sealed = False

    @rule(seconds=st.floats(0.0, 5.0))
    def wait(self, seconds: float) -> None:
        before = self.gripper.vacuum
        self.clock.sleep(seconds)
        assert abs(self.gripper.vacuum - before) <= 100.0 * seconds + 1e-9

    @rule(name=st.sampled_from(sorted(VACUUM_WRITABLE)), value=st.integers(0, 255))
    def set(self, name: str, value: int) -> None:
        assert self.gripper.reply(f"SET {name} {value}") == ("ack" if value <= VACUUM_WRITABLE[name] else "?")

    @rule(line=st.text("GSETPOACTM 019", max_size=12))
    def send_line(self, line: str) -> None:
        self.gripper.reply(line)

    @rule(is_placed=st.booleans())
    def place(self, is_placed: bool) -> None:
        self.gripper.place() if is_placed else self.gripper.take_away()
        self.is_sealed = is_placed

    @invariant()
    def values_stay_in_range(self) -> None:
        names = (*READABLE, "MOD")
        values = {name: value_of(name, self.gripper.reply(f"GET {name}") or "") for name in names}
        assert values["OBJ"] in (0, 1, 2, 3)
        assert 0 <= (values["POS"] or 0) <= 100
        if not self.is_sealed:
            assert self.gripper.vacuum == 0.0


VacuumMachine.TestCase.settings = settings(stateful_step_count=20)
test_vacuum_machine = pytest.mark.property(VacuumMachine.TestCase)


# -- the gripper of a user -------------------------------------------------------------------------------


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11", gripper="vacuum") as controller:
        yield controller


def test_vacuum_gripper_grips_and_releases(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot:
        gripper = robot.gripper("vacuum")
        assert gripper is robot.gripper("vacuum")
        with pytest.raises(urlink.GripperFault, match=r"not activated.*call activate\(\) first"):
            gripper.grip()
        assert gripper.activate().is_active
        controller.vacuum_gripper.place()
        held = gripper.grip(70.0, minimum=50.0)
        assert held.object_detected
        assert held.object == SuctionStatus.OBJECT_AT_MINIMUM
        assert 50.0 <= held.vacuum <= 70.0
        assert held.requested == 70.0
        while gripper.status().object != SuctionStatus.OBJECT_AT_REQUEST:
            pass
        assert gripper.vacuum() == 70.0
        assert controller.vacuum_gripper.holds_object
        released = gripper.release()
        assert not released.object_detected
        assert released.vacuum <= 5.0
        assert not gripper.object_detected()


def test_grip_without_object_returns_no_object(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot:
        gripper = robot.gripper("vacuum")
        gripper.activate()
        status = gripper.grip(object_timeout=0.5)
        assert (status.object, status.fault) == (SuctionStatus.NO_OBJECT, 6)
        controller.vacuum_gripper.place()
        assert gripper.grip().object_detected
        # Activating again must not repeat the last grip.
        assert not gripper.activate(again=True).object_detected
        gripper.release()
        controller.vacuum_gripper.take_away()
        gripper.grip(wait=False)
        with pytest.raises(LinkTimeout, match=r"no result of the grip within 0\.05 s"):
            gripper.wait(0.05)
        gripper.stop()
        assert gripper.get("GTO") == 0
        gripper.set(MOD=0)
        assert gripper.get("MOD") == 0
        gripper.deactivate()
        assert not gripper.status().is_active


def test_vacuum_gripper_reports_faults(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot:
        gripper = robot.gripper("vacuum")
        gripper.activate()
        controller.vacuum_gripper.fault = 8
        with pytest.raises(urlink.GripperFault, match="fault 8: the gripper is too hot"):
            gripper.grip()
        assert gripper.activate().fault == 0
        controller.vacuum_gripper.is_connected = False
        with pytest.raises(urlink.GripperFault, match="no gripper is connected to the controller"):
            gripper.status()
        with pytest.raises(BadValue, match="'PRE' cannot be set"):
            gripper.set(PRE=1)
        with pytest.raises(LocalError, match="no 2F-85 is mounted: the controller was made with gripper='vacuum'"):
            _ = controller.gripper


def test_missing_urcap_of_vacuum_gripper_raises() -> None:
    with Controller("UR5e", "5.11", gripper="rg2") as controller, urlink.connect(controller.address) as robot:
        with pytest.raises(ConnectFailed, match="needs its URCap"):
            robot.gripper("vacuum").vacuum()
        with pytest.raises(LocalError, match="no vacuum gripper is mounted"):
            _ = controller.vacuum_gripper


def test_vacuum_gripper_is_awaitable() -> None:
    async def main() -> None:
        async with urlink.connect_async("sim://ur5e?gripper=vacuum") as robot:
            gripper = robot.gripper("vacuum")
            await gripper.activate()
            robot.controller.vacuum_gripper.place()
            assert (await gripper.grip()).object_detected
            assert not (await gripper.release()).object_detected

    asyncio.run(main())
