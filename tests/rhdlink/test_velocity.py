"""The bridge: velocities are delivered, poses are reported, and no tick waits for either."""

from __future__ import annotations

import math
import threading
from typing import Any

import pytest

from linkcore.errors import BadValue
from rhdlink.host.host import Host
from rhdlink.host.plugins.velocity import Twist, VelocityBridge
from tests.rhdlink.raw_client import RawClient
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


def lockstep(bridge: VelocityBridge) -> Host:
    return Host([bridge], port=0, pacing="lockstep")


def test_velocity_is_delivered_when_it_changes() -> None:
    twists: list[Twist] = []
    bridge = VelocityBridge(twists.append, own_thread=False)
    with lockstep(bridge) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        for linear, angular in ((30000, 0), (30000, 0), (30000, -20000), (0, -20000), (0, -20000)):
            master.sync({"cmdtransvel": linear, "cmdrotvel": angular})
        master.sync({})
        # The forward speed does not depend on the turn rate: the original multiplied it by the cosine of the turn rate.
        assert twists == [(0.3, 0.0), (0.3, -0.5), (0.0, -0.5)]


@pytest.mark.parametrize(
    ("commanded", "linear"),
    [(499, 0.0), (-499, 0.0), (500, 0.005), (-500, -0.005), (1, 0.0)],
)
def test_dead_band_applies_only_to_the_forward_velocity(commanded: int, linear: float) -> None:
    twists: list[Twist] = []
    with lockstep(VelocityBridge(twists.append, own_thread=False)) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({"cmdtransvel": commanded, "cmdrotvel": 1})
        master.sync({})
        assert twists == [(linear, 1 / 40000)]


def test_velocity_bridge_applies_the_scale_settings() -> None:
    twists: list[Twist] = []
    bridge = VelocityBridge(
        twists.append,
        command_linear_scale=100.0,
        command_angular_scale=-10.0,
        linear_scale=1000.0,
        angular_scale=2.0,
        dead_band=0.0,
        own_thread=False,
    )
    with lockstep(bridge) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({"cmdtransvel": 50, "cmdrotvel": 5})
        bridge.update_pose(1.0, 1.0, math.pi / 2)
        bridge.update_pose(1.0, 3.0, math.pi / 2)
        master.sync({})
        master.sync({})
        assert twists == [(0.5, -0.5)]
        assert (master.value("transpos"), master.value("rotpos")) == (2000, 3)


def test_new_poses_are_reported_at_the_next_tick() -> None:
    bridge = VelocityBridge(lambda twist: None, own_thread=False)
    with lockstep(bridge) as host, RawClient(host.port) as reader:
        reader.greeting()
        reader.sync()
        bridge.update_pose(5.0, 5.0, 0.0)
        bridge.update_pose(5.5, 5.0, 0.1)
        reader.sync()
        reader.sync()
        assert reader.value("transpos") == round(0.5 * math.cos(0.1) * 1e5)
        assert reader.value("rotpos") == 4000
        assert reader.sync().data[1].ids.tolist() == [0]


@pytest.mark.parametrize("pose", [(math.nan, 0, 0), (0, math.inf, 0), (0, 0, -2e6)])
def test_update_pose_rejects_an_invalid_pose(pose: tuple[float, float, float]) -> None:
    with pytest.raises(BadValue):
        VelocityBridge(lambda twist: None).update_pose(*pose)


@pytest.mark.parametrize("wrong", [{"command_linear_scale": 0.0}, {"angular_scale": math.nan}, {"dead_band": -1.0}])
def test_bridge_rejects_invalid_settings(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue):
        VelocityBridge(lambda twist: None, **wrong)


def test_bridge_rejects_an_argument_that_is_not_a_function() -> None:
    with pytest.raises(BadValue, match="on_twist=3; expected a function"):
        VelocityBridge(3)  # type: ignore[arg-type]


def test_slow_function_gets_newest_velocity_and_delays_no_tick() -> None:
    twists: list[Twist] = []
    entered, go_on = threading.Event(), threading.Event()

    def slow(twist: Twist) -> None:
        twists.append(twist)
        entered.set()
        assert go_on.wait(10.0)

    bridge = VelocityBridge(slow)
    with lockstep(bridge) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({"cmdtransvel": 10000})
        master.sync({})
        assert entered.wait(10.0)
        # Thirty ticks pass before the function returns.
        for number in range(30):
            master.sync({"cmdtransvel": 20000 + 1000 * number})
        master.sync({})
        go_on.set()
        until(lambda: len(twists) == 2)
        assert twists == [(0.1, 0.0), (0.49, 0.0)]
        assert bridge.stats is not None
        assert bridge.stats.dropped == 29
    # At the end, the function receives a stop.
    assert twists[-1] == (0.0, 0.0)


def test_function_that_raises_is_called_again(caplog: pytest.LogCaptureFixture) -> None:
    twists: list[Twist] = []

    def failing(twist: Twist) -> None:
        twists.append(twist)
        raise RuntimeError("no wheels")

    bridge = VelocityBridge(failing)
    with lockstep(bridge) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        for number in range(1, 4):
            master.sync({"cmdtransvel": 10000 * number})
            master.sync({})
            until(lambda number=number: len(twists) == number)  # type: ignore[misc]
    assert bridge.stats is not None
    assert bridge.stats.raised == 4
    assert "no wheels" in caplog.text


def test_velocity_bridge_stops_without_a_master_and_restarts() -> None:
    twists: list[Twist] = []
    with lockstep(VelocityBridge(twists.append, own_thread=False)) as host, RawClient(host.port) as reader:
        reader.greeting()
        for _ in range(2):
            with RawClient(host.port, b"aw") as master:
                master.greeting()
                master.sync({"cmdtransvel": 30000})
                master.sync({})
            while host.writers:
                reader.sync()
            reader.sync()
            reader.sync()
        assert twists == [(0.3, 0.0), (0.0, 0.0)] * 2
