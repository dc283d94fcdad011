"""Robots over MQTT, with a real broker (mosquitto) between server and clients."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import math
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import urlink
from packages.mqtt.tests.panel import Panel
from tests.mosquitto import MOSQUITTO, needs_broker
from tests.waiting import until
from urlink.simulator import Controller
from urlink_mqtt import Broker, Server, cli
from urlink_mqtt.commands import Asked, ServerClock, read

#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = pytest.mark.urlink(
    model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
)

HOME = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
FAR = [1.5, -1.5, 1.5, -1.5, -1.5, 0.0]
EXAMPLE = Path(__file__).parents[1] / "examples" / "panel.py"

Panels = Callable[..., Panel]


@needs_broker
def test_status_and_info_are_retained(server: Server, panels: Panels, urlink_robot: urlink.Robot) -> None:
    panel = panels()
    until(lambda: "q_actual" in panel.status)
    late = panels("late")
    until(lambda: "urlink/arm/info" in late.heard and "urlink/arm/status" in late.heard)
    info, status = late.of("info")[0], late.of("status")[0]
    assert (info["model"], info["firmware"]) == ("UR5e", "5.11")
    assert {"stop", "cancel", "move_joints"} <= set(info["commands"])
    assert (status["served"], status["connection"], status["safety_mode"]) == (True, "connected", "NORMAL")
    assert status["q_actual"] == pytest.approx(urlink_robot.realtime.wait().q_actual.tolist(), abs=1e-3)
    assert status["refusal"] is None


@needs_broker
def test_client_moves_robot_and_receives_motion_events(
    server: Server, panels: Panels, urlink_robot: urlink.Robot
) -> None:
    panel = panels()
    answer = panel.ask("move_joints", {"q": HOME}, id="first")
    assert (answer["id"], answer["command"], answer["error"]) == ("first", "move_joints", None)
    assert answer["phase"] in ("sent", "running")  # it may have started before the answer was made
    until(lambda: panel.of("motion") and panel.of("motion")[-1]["phase"] == "done", 60.0)
    assert [said["id"] for said in panel.of("motion")] == ["first", "first"]
    assert urlink_robot.realtime.wait().q_actual.tolist() == pytest.approx(HOME, abs=1e-3)
    assert panel.ask("set_digital_out", {"number": 3, "on": True, "confirm": 20.0})["error"] is None
    until(lambda: urlink_robot.realtime.wait().digital_output_bits == 1 << 3)


@needs_broker
@pytest.mark.parametrize("name", ["stop", "cancel"])
def test_motion_does_not_start_after_later_stop(
    server: Server, panels: Panels, urlink_robot: urlink.Robot, urlink_controller: Controller, name: str
) -> None:
    panel = panels()
    assert panel.ask("move_joints", {"q": HOME, "speed": 2.0})["error"] is None
    until(lambda: panel.of("motion") and panel.of("motion")[-1]["phase"] == "done")
    urlink_controller.faults.stall(1.0, "dashboard")
    panel.send("load", {"path": "nothing.urp"})  # delays the motion
    panel.send("move_joints", {"q": FAR})
    answers = [panel.ask(name), panel.answer(), panel.answer()]
    assert [(answer["command"], answer["error"]) for answer in answers] == [
        (name, None),
        ("load", "DashboardRefused"),
        ("move_joints", "Cancelled"),
    ]
    assert urlink_robot.realtime.wait().q_target.tolist() == pytest.approx(HOME, abs=1e-3)


@needs_broker
def test_repeated_message_is_executed_once(server: Server, panels: Panels, urlink_robot: urlink.Robot) -> None:
    panel = panels()
    status = panel.status
    asked = {"client": panel.name, "id": "1", "server": status["server"], "time": status["time"], "age": 30.0}
    payload = json.dumps({**asked, "arguments": {"q": FAR}})
    panel.publish("move_joints", payload)
    assert panel.answer()["error"] is None
    assert panel.ask("cancel")["error"] is None
    panel.publish("move_joints", payload)
    answer = panel.answer()
    assert (answer["error"], answer["message"]) == (
        "LocalError",
        "this move_joints was received before; each command needs its own id",
    )
    assert urlink_robot.motion.current is None


@needs_broker
def test_command_with_retain_flag_is_not_executed(server: Server, panels: Panels) -> None:
    panel = panels()
    status = panel.status
    asked = {"client": panel.name, "id": "1", "server": status["server"], "time": status["time"], "age": 30.0}
    panel.publish("move_joints", json.dumps({**asked, "arguments": {"q": FAR}}), retain=True)
    assert panel.ask("enable")["command"] == "enable"  # sent later, but answered first
    assert panel.of("motion") == []
    panel.mqtt.publish("urlink/arm/command/move_joints", b"", qos=1, retain=True).wait_for_publish(10.0)


@needs_broker
@pytest.mark.parametrize(
    ("name", "changed", "error", "said"),
    [
        ("move_joints", {"arguments": {"q": [0.0]}}, "BadValue", "q"),
        ("move_joints", {"arguments": {"q": HOME, "wait": True}}, "BadValue", "wait"),
        ("move_joints", {"arguments": {"q": HOME, "goal": 1}}, "BadValue", "goal"),
        ("dance", {}, "BadValue", "unknown command 'dance'"),
        ("enable", {"age": 0}, "BadValue", "age"),
        ("enable", {"age": 3600.0}, "BadValue", "at most 60"),
        ("enable", {"time": None}, "BadValue", "time"),
        ("enable", {"server": "another"}, "LocalError", "an earlier server"),
        ("enable", {"time": 1.0, "age": 1.0}, "LinkTimeout", "was not executed"),
    ],
)
def test_invalid_commands_are_answered_with_errors(
    server: Server, panels: Panels, name: str, changed: dict[str, Any], error: str, said: str
) -> None:
    panel = panels()
    if changed.get("time", 0.0) is None:
        panel.send(name, {}, **changed)  # the answer to an unreadable command contains no client
        until(lambda: panel.of("answer"))
        answer = panel.of("answer")[0]
    else:
        answer = panel.ask(name, **changed)
    assert answer["error"] == error
    assert said in answer["message"]


@needs_broker
def test_lost_client_ends_only_its_own_motion(server: Server, panels: Panels, urlink_robot: urlink.Robot) -> None:
    panel, other = panels(), panels("other")
    panel.ask("move_joints", {"q": HOME})
    until(lambda: other.of("motion") and other.of("motion")[-1]["phase"] == "done", 60.0)
    panel.ask("move_joints", {"q": FAR, "speed": 0.1})
    until(lambda: urlink_robot.realtime.wait().q_actual[0] > 0.02)
    refused = other.ask("move_joints", {"q": HOME})
    assert "client panel is moving the arm" in refused["message"]
    other.mqtt.publish("urlink/arm/client/nobody", b"", qos=1, retain=True).wait_for_publish(10.0)
    assert other.of("motion")[-1]["phase"] in ("sent", "running")
    panel.lose()
    until(lambda: other.of("motion")[-1]["phase"] == "cancelled")
    until(lambda: not urlink_robot.realtime.wait().qd_target.any())
    assert urlink_robot.realtime.wait().q_actual[0] < 1.4


@needs_broker
def test_motion_of_absent_client_is_refused(server: Server, panels: Panels) -> None:
    panel = panels(is_there=False)
    assert "is not present" in panel.ask("move_joints", {"q": HOME})["message"]


@needs_broker
@pytest.mark.parametrize("name", ["stop", "cancel"])
def test_invalid_stop_command_of_any_client_stops_the_arm(
    server: Server, panels: Panels, urlink_robot: urlink.Robot, name: str
) -> None:
    panel = panels()
    panel.ask("move_joints", {"q": FAR, "speed": 0.1})
    until(lambda: urlink_robot.realtime.wait().qd_target.any())
    panels("other", is_there=False).mqtt.publish(f"urlink/arm/command/{name}", b"{nonsense", qos=1)
    until(lambda: panel.of("motion")[-1]["phase"] in ("cancelled", "failed"))
    until(lambda: not urlink_robot.realtime.wait().qd_target.any())


@needs_broker
def test_commands_are_refused_unless_allowed(broker: int, panels: Panels, urlink_robot: urlink.Robot) -> None:
    with Server(urlink_robot, "arm", Broker("127.0.0.1", broker)):
        panel = panels()
        before = urlink_robot.realtime.wait().q_target.tolist()
        for name in ("move_joints", "set_digital_out", "stop"):
            assert "--allow-commands" in panel.ask(name, {"q": HOME})["message"]
        until(lambda: panel.of("info"))
        assert panel.of("info")[-1]["commands"] == []
        assert urlink_robot.realtime.wait().q_target.tolist() == before


@needs_broker
def test_read_only_robot_publishes_status_and_refuses_commands(
    broker: int, panels: Panels, urlink_controller: Controller
) -> None:
    with (
        urlink.connect(urlink_controller.address, read_only=True) as robot,
        Server(robot, "arm", Broker("127.0.0.1", broker), allow_commands=True),
    ):
        panel = panels()
        assert "--read-only" in panel.ask("move_joints", {"q": HOME})["message"]
        until(lambda: "q_actual" in panel.status)


@needs_broker
def test_retained_command_is_not_executed_by_later_server(
    broker: int, panels: Panels, urlink_robot: urlink.Robot
) -> None:
    where = Broker("127.0.0.1", broker)
    with Server(urlink_robot, "arm", where, allow_commands=True, status_rate=20.0):
        panel = panels()
        until(lambda: panel.status.get("server"))
    panel.mqtt.publish("urlink/arm/command/stop", b"{}", qos=1, retain=True).wait_for_publish(10.0)
    with Server(urlink_robot, "arm", where, allow_commands=True):
        assert panel.ask("cancel")["command"] == "cancel"
    assert [said["command"] for said in panel.of("answer")] == ["cancel"]


@needs_broker
def test_status_reports_when_server_ends(broker: int, panels: Panels, urlink_controller: Controller) -> None:
    """A terminated `urlink serve` reports its end itself, a killed one by its last will."""
    panel = panels()
    command = [sys.executable, "-m", "urlink.cli", "serve", "mqtt", f"arm={urlink_controller.address}"]
    for number in (signal.SIGTERM, signal.SIGKILL):
        process = subprocess.Popen([*command, "--broker", "127.0.0.1", "--port", str(broker)])
        try:
            until(lambda: panel.of("status") and panel.of("status")[-1].get("q_actual"), 60.0)
            os.kill(process.pid, number)
            until(lambda: panel.of("status")[-1] == {"served": False}, 60.0)
        finally:
            process.kill()
            process.wait()


@needs_broker
def test_broker_loss_stops_arm_and_server_reconnects(
    tmp_path: Path, urlink_robot: urlink.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
    config = tmp_path / "mosquitto.conf"
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")

    @contextlib.contextmanager
    def mosquitto() -> Any:
        assert MOSQUITTO is not None
        with subprocess.Popen([MOSQUITTO, "-c", str(config)], stderr=subprocess.DEVNULL) as process:
            try:
                until(lambda: _answers(port))
                yield
            finally:
                process.kill()

    with contextlib.ExitStack() as stack:
        with mosquitto():
            server = stack.enter_context(
                Server(urlink_robot, "arm", Broker("127.0.0.1", port), status_rate=20.0, allow_commands=True)
            )
            panel = Panel(port)
            panel.ask("move_joints", {"q": FAR, "speed": 0.1})
            until(lambda: urlink_robot.realtime.wait().qd_target.any())
        until(lambda: not urlink_robot.realtime.wait().qd_target.any())
        panel.close()
        steps = steps_of(server, monkeypatch)
        with mosquitto():
            again = Panel(port)
            until(lambda: again.status.get("served"), 60.0)
            assert again.ask("cancel")["error"] is None
            # A command that is sent after the first status must not be lost.
            assert steps.index("subscribed") < steps.index("status")
            again.close()
            server.close()


def steps_of(server: Server, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a list to which the topics that the server publishes are added, and its subscriptions."""
    steps: list[str] = []
    put, subscribed = server._put, server._client.on_subscribe
    assert subscribed is not None

    def on_subscribe(*arguments: Any) -> None:
        steps.append("subscribed")
        subscribed(*arguments)

    def recorded(topic: str, *arguments: Any, **options: Any) -> Any:
        steps.append(topic)
        return put(topic, *arguments, **options)

    monkeypatch.setattr(server, "_put", recorded)
    monkeypatch.setattr(server._client, "on_subscribe", on_subscribe)
    return steps


def _answers(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0):
        return True
    return False


@needs_broker
def test_example_panel_moves_arm(server: Server, broker: int, urlink_robot: urlink.Robot) -> None:
    before = urlink_robot.realtime.wait().q_actual[0]
    said = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLE), "arm", "--port", str(broker), "--broker", "127.0.0.1"],
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    ).stdout
    assert said.splitlines()[-1] == "move_joints done"
    assert urlink_robot.realtime.wait().q_actual[0] - before == pytest.approx(math.radians(1.0), abs=1e-3)


# -- without a broker ------------------------------------------------------------------------------


def test_server_raises_connect_failed_without_broker(urlink_robot: urlink.Robot) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
    with pytest.raises(urlink.ConnectFailed, match=f"the broker at 127.0.0.1:{port}"):
        Server(urlink_robot, "arm", Broker("127.0.0.1", port))


@pytest.mark.parametrize(("name", "options"), [("a/b", {}), ("arm", {"prefix": "a/+"}), ("arm", {"status_rate": 0.0})])
def test_server_rejects_invalid_topic_and_rate(urlink_robot: urlink.Robot, name: str, options: dict[str, Any]) -> None:
    with pytest.raises(urlink.BadValue, match="expected"):
        Server(urlink_robot, name, Broker(), **options)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"{", "not valid JSON"),
        (b"[]", "expected an object"),
        (b'{"q": 1}', "expected an object with some of client"),
        (b'{"time": "now"}', "time is 'now'; expected a number"),
        (b'{"age": true}', "age is 'True'; expected a number"),
        (b'{"client": 5}', "client is '5'; expected text"),
        (b'{"arguments": []}', "arguments are not an object"),
        (b"[" * 100_000, "not valid JSON"),
    ],
)
def test_read_rejects_invalid_commands(payload: bytes, said: str) -> None:
    with pytest.raises(urlink.BadValue, match=said):
        read(payload)


def test_command_expires_by_server_clock() -> None:
    now = [100.0]
    clock, other = ServerClock(lambda: now[0]), ServerClock(lambda: now[0])
    asked = Asked(age=5.0, **clock.described())
    now[0] = 105.0
    clock.check(asked)
    with pytest.raises(urlink.LocalError, match="earlier server"):
        other.check(asked)
    now[0] = 105.1
    with pytest.raises(urlink.LinkTimeout, match=r"5\.1 s after the status"):
        clock.check(asked)
    for time in (106.0, math.nan):  # a time in the future, and NaN
        with pytest.raises((urlink.LinkTimeout, urlink.BadValue)):
            clock.check(dataclasses.replace(asked, time=time))


def test_command_line_options_have_defaults() -> None:
    parser = argparse.ArgumentParser()
    cli.add_arguments(parser)
    assert not parser.parse_args([]).allow_commands
    assert json.loads(json.dumps(vars(parser.parse_args(["--ca", "x"]))))["ca"] == "x"
