"""Robots for Prometheus: answers of the HTTP endpoint, read by prometheus_client's own parsers."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Mapping

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families

import urlink
from tests.waiting import until
from urlink.simulator import Controller
from urlink_prometheus import RobotCollector, serve_metrics

#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = pytest.mark.urlink(
    model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
)

Sample = tuple[str, frozenset[tuple[str, str]]]


def scrape(port: int, accept: str = "text/plain") -> dict[Sample, float]:
    """Return every sample, by name and labels."""
    request = urllib.request.Request(f"http://127.0.0.1:{port}/metrics", headers={"Accept": accept})
    with urllib.request.urlopen(request, timeout=10.0) as answer:
        text = answer.read().decode()
    parse = parse_openmetrics if "openmetrics" in accept else text_string_to_metric_families
    return {
        (each.name, frozenset(each.labels.items())): each.value for family in parse(text) for each in family.samples
    }


def of(found: Mapping[Sample, float], name: str, **labels: str) -> float:
    return found[name, frozenset({"robot": "arm", **labels}.items())]


@pytest.mark.parametrize("accept", ["text/plain", "application/openmetrics-text; version=1.0.0"])
def test_scrape_contains_streams_modes_temperatures_and_program(
    port: int, urlink_robot: urlink.Robot, accept: str
) -> None:
    until(lambda: of(scrape(port, accept), "urlink_stream_received_total", stream="primary") > 3)
    before = urlink_robot.realtime.stats.received
    found = scrape(port, accept)
    after = urlink_robot.realtime.stats.received
    assert before <= of(found, "urlink_stream_received_total", stream="realtime") <= after
    assert of(found, "urlink_stream_failed_total", stream="realtime") == 0.0
    assert of(found, "urlink_connected") == 1.0
    assert of(found, "urlink_robot_info", model="UR5e", firmware="5.11") == 1.0
    assert of(found, "urlink_safety_mode", urlink_safety_mode="normal") == 1.0
    assert of(found, "urlink_safety_mode", urlink_safety_mode="protective_stop") == 0.0
    assert of(found, "urlink_program_state", urlink_program_state="stopped") == 1.0
    state = urlink_robot.realtime.wait()
    for number, joint in enumerate(("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")):
        shown = of(found, "urlink_motor_temperature_celsius", joint=joint)
        assert shown == pytest.approx(float(state.motor_temperatures[number]), abs=1.0)
    assert of(found, "urlink_joint_position_radians", joint="wrist_1") == pytest.approx(state.q_actual[3], abs=1e-3)


def test_counters_grow_and_modes_change(port: int, urlink_robot: urlink.Robot, urlink_controller: Controller) -> None:
    first = scrape(port)
    urlink_controller.faults.protective_stop()
    until(lambda: of(scrape(port), "urlink_safety_mode", urlink_safety_mode="protective_stop") == 1.0)
    urlink_controller.faults.clear()
    urlink_controller.faults.cut("realtime")
    until(lambda: of(scrape(port), "urlink_stream_reconnects_total", stream="realtime") == 1.0)
    last = scrape(port)
    counters = [name for name in first if name[0].endswith("_total")]
    assert len(counters) >= 12
    assert all(last[name] >= first[name] for name in counters)


def test_values_of_lost_robot_are_absent(port: int, urlink_controller: Controller) -> None:
    assert any(name == "urlink_joint_position_radians" for name, _ in scrape(port))
    urlink_controller.close()
    until(lambda: of(scrape(port), "urlink_connected") == 0.0)
    found = scrape(port)
    assert not [name for name, _ in found if name in ("urlink_joint_position_radians", "urlink_safety_mode")]
    assert of(found, "urlink_stream_received_total", stream="realtime") > 0.0


@pytest.mark.urlink(model="UR5", firmware="1.7")
def test_values_that_an_old_controller_does_not_send_are_absent(port: int) -> None:
    found = scrape(port)
    assert of(found, "urlink_motor_temperature_celsius", joint="base") > 0.0
    assert not [name for name, _ in found if name in ("urlink_safety_mode", "urlink_main_voltage_volts")]


def test_command_line_listens_on_this_computer_only(urlink_controller: Controller) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
    command = [sys.executable, "-m", "urlink.cli", "serve", "prometheus", f"arm={urlink_controller.address}"]
    process = subprocess.Popen([*command, "--port", str(port)])
    try:

        def answers() -> bool:
            try:
                return of(scrape(port), "urlink_connected") == 1.0
            except (urllib.error.URLError, ConnectionError):
                return False

        until(answers, 60.0)
        with socket.socket() as elsewhere, pytest.raises(ConnectionError):
            elsewhere.connect(("127.0.0.2", port))
        process.send_signal(signal.SIGTERM)
        assert process.wait(60.0) != 0
    finally:
        process.kill()
        process.wait()


def test_error_names_port_in_use(urlink_robot: urlink.Robot) -> None:
    collector = RobotCollector({"arm": urlink_robot})
    with serve_metrics(collector, port=0) as port:
        taken = re.escape(f"cannot listen at 127.0.0.1:{port}")
        with pytest.raises(urlink.LocalError, match=taken), serve_metrics(collector, port=port):
            pass
        with pytest.raises(urlink.BadValue, match="expected 0 to 65535"), serve_metrics(collector, port=70000):
            pass
    collector.close()
    with pytest.raises(ConnectionError), socket.create_connection(("127.0.0.1", port), timeout=5.0):
        pass
