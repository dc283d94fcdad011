from __future__ import annotations

from pathlib import Path

import pytest

from tests.harm import HOSTILE, assert_harmless, strict
from urlink.protocol.firmware import RELEASES, release_of
from urlink.simulator import Controller

from .conftest import Run, write

pytestmark = pytest.mark.simulated_time


def test_info_prints_firmware_model_and_packet_sizes(run: Run, controller: Controller, address: str) -> None:
    status, out, err = run("info", address)
    assert (status, err) == (0, "")
    for part in (
        "firmware    5.11 (reported by the controller)",
        "model       UR5e",
        "real-time   1220 bytes, 500 Hz",
        "state       1386 bytes, the first of a connection; then 716 bytes, 10 Hz",
        "JointData 251",
        "table row   firmware 5.10 and later",
        f"evidence    {release_of(controller.firmware).evidence}",
        f"realtime {controller.ports['realtime']}",
    ):
        assert part in out


def test_info_prints_json(run: Run, address: str, controller: Controller) -> None:
    status, out, _ = run("info", address, "--json")
    assert status == 0
    facts = strict(out)
    assert facts["firmware"] == "5.11"
    assert facts["firmware_is_said"] is True
    assert facts["model"] == "UR5e"
    assert facts["sizes"]["realtime"] == 1220
    assert facts["sizes"]["sub_packages"]["ConfigurationData"] == 445
    assert facts["ports"].items() >= controller.ports.items()


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_info_recognises_every_firmware_release(run: Run, tmp_path: Path, release: object) -> None:
    firmware = str(release.since)  # type: ignore[attr-defined]
    path = write(tmp_path / "x.urlog", {"realtime": []}, info={"firmware": firmware})
    facts = strict(run("info", f"replay://{path}", "--json")[1])
    assert (facts["firmware"], facts["release"], facts["ports"]) == (firmware, firmware, {})
    assert facts["sizes"]["first_state"] == 5 + sum(facts["sizes"]["sub_packages"].values())


def test_info_states_whether_controller_reported_version(run: Run) -> None:
    with Controller("UR5", "1.6") as controller:
        ports = "&".join(f"{name}={port}" for name, port in controller.ports.items())
        facts = strict(run("info", f"ur://{controller.host}?{ports}", "--json")[1])
    # The firmware is right whether the simulated 1.6 reports it or not; the flag shows which case it is.
    assert facts["firmware"] == "1.6"
    assert facts["firmware_is_said"] in (True, False)


def test_info_starts_simulator_for_sim_address(run: Run) -> None:
    status, out, _ = run("info", "sim://ur10?firmware=3.4")
    assert status == 0
    assert "model       UR10\n" in out
    assert "firmware    3.4 " in out
    assert "ports       primary " in out
    assert max(map(len, out.splitlines())) <= 100


def test_info_escapes_hostile_text_of_recording(run: Run, tmp_path: Path) -> None:
    path = write(tmp_path / "x.urlog", {"realtime": []}, info={"model": HOSTILE})
    for options in ((), ("--json",)):
        status, out, _ = run("info", f"replay://{path}", *options)
        assert status == 0
        assert_harmless(out)
