"""Robots for Prometheus, scraped by Prometheus itself: its metrics, and the alarms of the documentation."""

from __future__ import annotations

import json
import re
import shutil
import socket
import subprocess
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import urlink
from tests.waiting import until
from urlink.simulator import Controller

PROMETHEUS, PROMTOOL = shutil.which("prometheus"), shutil.which("promtool")
#: Marks of the simulated arm of these tests. The limits are long because a busy machine causes silence and delays.
pytestmark = [
    pytest.mark.urlink(
        model="UR5e", firmware="5.11", connect={"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
    ),
    pytest.mark.skipif(PROMETHEUS is None, reason="prometheus is not installed (apt install prometheus)"),
]
#: Prometheus scrapes at its shortest interval, so that the tests do not have to wait long.
CONFIG = """\
global: {{ scrape_interval: 1s, scrape_timeout: 1s }}
scrape_configs:
  - job_name: arms
    static_configs: [ {{ targets: ["127.0.0.1:{port}"] }} ]
"""
OPENMETRICS = "application/openmetrics-text; version=1.0.0"
PAGE = Path(__file__).resolve().parents[3] / "docs" / "packages" / "prometheus.md"


class Scraper:
    """Prometheus server that scrapes a port, and that tests query with its HTTP API."""

    def __init__(self, port: int) -> None:
        self.url = f"http://127.0.0.1:{port}/api/v1"

    def asked(self, path: str, **arguments: str) -> Any:
        query = urllib.parse.urlencode(arguments)
        with urllib.request.urlopen(f"{self.url}/{path}?{query}", timeout=30.0) as answer:
            return json.load(answer)["data"]

    def found(self, expression: str) -> list[tuple[dict[str, str], float]]:
        """Return labels and current value of each series."""
        return [(each["metric"], float(each["value"][1])) for each in self.asked("query", query=expression)["result"]]

    def is_ready(self) -> bool:
        try:
            return bool(self.found("up == 1"))
        except OSError:
            return False


@pytest.fixture
def prometheus(port: int, tmp_path: Path) -> Iterator[Scraper]:
    assert PROMETHEUS is not None
    config = tmp_path / "prometheus.yml"
    config.write_text(CONFIG.format(port=port))
    with socket.create_server(("127.0.0.1", 0)) as probe:
        own: int = probe.getsockname()[1]
    command = [PROMETHEUS, f"--config.file={config}", f"--storage.tsdb.path={tmp_path / 'data'}"]
    process = subprocess.Popen(
        [*command, f"--web.listen-address=127.0.0.1:{own}"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        scraper = Scraper(own)

        def is_ready() -> bool:
            assert process.poll() is None, "prometheus ended early"
            return scraper.is_ready()

        until(is_ready)
        yield scraper
    finally:
        process.kill()
        process.wait()


def test_prometheus_stores_every_metric_with_type_and_value(
    prometheus: Scraper, port: int, urlink_robot: urlink.Robot
) -> None:
    # Prometheus requests this format.
    request = urllib.request.Request(f"http://127.0.0.1:{port}/metrics", headers={"Accept": OPENMETRICS})
    with urllib.request.urlopen(request, timeout=10.0) as answer:
        types = dict(re.findall(r"^# TYPE (urlink_\w+) (\w+)$", answer.read().decode(), re.MULTILINE))
    assert len(types) > 15
    until(lambda: set(prometheus.asked("metadata")) >= set(types))
    metadata = prometheus.asked("metadata")
    assert {name: metadata[name][0]["type"] for name in types} == types
    labels = {"instance": f"127.0.0.1:{port}", "job": "arms", "robot": "arm"}
    assert prometheus.found("urlink_connected") == [({"__name__": "urlink_connected", **labels}, 1.0)]
    joints = {each["joint"]: value for each, value in prometheus.found("urlink_joint_position_radians")}
    assert joints["wrist_1"] == pytest.approx(urlink_robot.realtime.wait().q_actual[3], abs=1e-3)
    assert len(joints) == 6
    (rate,) = prometheus.found('urlink_stream_rate_hertz{stream="realtime"}')
    assert rate[1] > 0.0


def test_documented_alarms_fire(prometheus: Scraper, urlink_controller: Controller) -> None:
    stands, loses = re.findall(r"`([^`]+ (?:== 0|> 1))`", re.sub(r"\s+", " ", PAGE.read_text(encoding="utf-8")))
    assert not prometheus.found(stands)
    urlink_controller.faults.protective_stop()
    until(lambda: prometheus.found(stands))
    assert [each["robot"] for each, _ in prometheus.found(stands)] == ["arm"]
    urlink_controller.faults.clear()
    until(lambda: not prometheus.found(stands))
    # At least 500 cycles, which is more than 1 per second over five minutes.
    urlink_controller.faults.stall(2.5)
    until(lambda: prometheus.found(loses), 120.0)


def test_old_values_of_a_lost_robot_are_absent(prometheus: Scraper, urlink_controller: Controller) -> None:
    assert prometheus.found("urlink_joint_position_radians")
    urlink_controller.close()
    until(lambda: prometheus.found("urlink_connected == 0"))
    assert prometheus.found("urlink_joint_position_radians") == []
    assert prometheus.found("urlink_safety_mode") == []
    assert prometheus.found('urlink_stream_received_total{stream="realtime"}')


@pytest.mark.skipif(PROMTOOL is None, reason="promtool is not installed (apt install prometheus)")
def test_promtool_reports_no_problems(port: int) -> None:
    assert PROMTOOL is not None
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=10.0) as answer:
        text = answer.read()
    checked = subprocess.run([PROMTOOL, "check", "metrics"], input=text, capture_output=True, timeout=60)
    ours = [line for line in (checked.stdout + checked.stderr).decode().splitlines() if "urlink_" in line]
    assert ours == []
