"""The commands turtle, watch, vars, record, replay and mission with a robot that uses MQTT."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import pytest

pytest.importorskip("paho.mqtt.client")

from tests.mosquitto import needs_broker

from .conftest import Run, Spawn

pytestmark = [needs_broker, pytest.mark.real_time, pytest.mark.slow]


@pytest.mark.parametrize("dialect", ["2025", "2026"])
def test_commands_work_with_a_simulated_robot(
    broker: int, dialect: str, run: Run, spawn: Spawn, tmp_path: Path
) -> None:
    address = f"mqtt://127.0.0.1:{broker}"
    turtle = spawn("turtle", "--drive", "mqtt", "--broker", address, "--dialect", dialect)
    assert turtle.stdout is not None
    assert turtle.stdout.readline().strip() == address

    status, out, err = run("watch", address, "velleft", "livn", "hbtvoltage", "--json", "--count", "3")
    assert status == 0, err
    names = {name for line in out.splitlines() for name in json.loads(line)["variables"]}
    assert "velleft" in names

    status, out, err = run("vars", address)
    assert status == 0, err
    assert "15.7 V" in out

    path = tmp_path / "drive.urlog"
    assert run("record", address, str(path), "--count", "20")[0] == 0
    status, out, err = run("replay", str(path), "velleft", "--rate", "max")
    assert status == 0, err
    assert "m/s" in out

    script = tmp_path / "forward.smr"
    script.write_text("fwd 0.2\neval $odox; $velleft\n")
    status, out, err = run("mission", str(script), "--robot", address)
    assert status == 0, err
    assert float(out.split()[0]) == pytest.approx(0.2, abs=0.05)

    turtle.send_signal(signal.SIGTERM)
    _, err = turtle.communicate(timeout=30.0)
    assert f"commands of {dialect}" in err
    found = re.search(r"ended at x (\S+) m", err)
    assert found is not None
    assert float(found.group(1)) == pytest.approx(5.7, abs=0.05)
