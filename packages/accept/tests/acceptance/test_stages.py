"""Runs with sound simulated controllers, in simulated time: no requirement is falsely not held."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from linkcore.errors import BadValue
from linkcore.net.transport import TcpTransport
from urlink.simulator import Controller
from urlink.simulator.server import Server
from urlink_accept.acceptance.evidence import Evidence
from urlink_accept.acceptance.logbook import Logbook
from urlink_accept.acceptance.person import Nobody
from urlink_accept.acceptance.report import as_html, as_text, is_accepted, judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import run
from urlink_accept.acceptance.standing import try_each

#: Requirements that cannot be tried while nothing moves.
_MOVED = {"velocities", "tcp-speed"}


def consent(number: int, does: str) -> str:
    return ""


def tried(evidence: Evidence) -> dict[str, str]:
    return {each.requirement.name: each.state for each in judge(evidence, requirements())}


@pytest.mark.slow
@pytest.mark.simulated_time
@pytest.mark.matrix(2)
@pytest.mark.parametrize(
    ("firmware", "without"),
    [
        ("5.11", set()),
        ("3.15", {"payload-echo", "local"}),
    ],
)
def test_correct_controller_meets_all_requirements(tmp_path: Path, firmware: str, without: set[str]) -> None:
    path = tmp_path / "run.urlog"
    shown: list[tuple[float, str]] = []
    run(
        f"sim://?firmware={firmware}",
        path,
        (0, 1),
        consent,
        seconds=2.0,
        progress=lambda part, doing: shown.append((part, doing)),
    )
    parts, steps = zip(*shown, strict=True)
    assert list(parts) == sorted(parts)
    assert 0.0 <= parts[0] < 0.1 < parts[-1] <= 1.0
    assert {"stage 0", "stage 0: listening", "stage 1", "stage 1: sleep"} <= set(steps)
    evidence = Evidence(path)
    judged: list[float] = []
    verdicts = judge(evidence, requirements(), judged.append)
    assert judged == [number / len(verdicts) for number in range(len(verdicts))]
    assert {each.requirement.name: each.seen for each in verdicts if each.state == "not held"} == {}
    stood = [each for each in verdicts if each.requirement.stage < 2]
    assert {each.requirement.name for each in stood if each.state == "not tried"} == _MOVED | without
    assert is_accepted(verdicts)
    text, page = as_text(evidence, verdicts, {"owner": "<A. Nother>"}), as_html(evidence, verdicts, {"owner": "<A>"})
    assert f"firmware {firmware}" in text
    assert "\nACCEPTED: " in text
    assert "<A. Nother>" in text
    assert "&lt;A&gt;" in page
    assert as_text(Evidence(path), verdicts, {"owner": "<A. Nother>"}) == text


@pytest.mark.simulated_time
def test_stage_without_consent_is_not_tried(tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    asked: list[int] = []

    def only_reading(number: int, does: str) -> str:
        asked.append(number)
        return "no consent" if number else ""

    run("sim://?firmware=1.6", path, (0, 1), only_reading, person=Nobody(), seconds=1.0)
    verdicts = judge(Evidence(path), requirements())
    assert asked == [0, 1]
    assert {each.state for each in verdicts if each.requirement.stage == 1} == {"not tried"}
    assert {each.requirement.name for each in verdicts if each.state == "not held"} == set()
    stopped = next(each for each in verdicts if each.requirement.name == "sleep")
    assert stopped.seen == "stage 1 was not run: no consent"


def test_run_rejects_recording(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match="is a recording"):
        run("replay:///run.urlog", tmp_path / "run.urlog", (0,), consent)


@pytest.mark.simulated_time
def test_connection_stays_open_when_logbook_ends(tmp_path: Path) -> None:
    with Controller("UR5", "3.15") as controller:
        transport = TcpTransport("127.0.0.1", controller.ports["realtime"], silence=5.0)
        with Logbook(tmp_path / "run.urlog", controller.ports):
            transport.open(5.0)
        assert transport.receive(5.0)[0]
        transport.abort()


@pytest.mark.slow
@pytest.mark.simulated_time
@pytest.mark.parametrize(("address", "is_sent_later"), [("ur5e?firmware=5.11", True), ("ur5?firmware=3.15", False)])
def test_stage_detects_controller_that_waits_for_silent_client(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str, is_sent_later: bool
) -> None:
    """Nobody gets a packet while one client has not read the previous ones."""
    waiting: list[tuple[str, Any]] = []
    broadcast = Server._broadcast

    def wait_for_all(self: Server, kind: str, packet: Any) -> None:
        if any(client.pending for clients in self._clients.values() for client in clients):
            if is_sent_later:
                waiting.append((kind, packet))
            return
        for each in waiting:
            broadcast(self, *each)
        waiting.clear()
        broadcast(self, kind, packet)

    def some(book: Logbook, steps: Mapping[str, Callable[[], Any]]) -> None:
        try_each(book, {name: steps[name] for name in ("sleep", "silent-client")})

    monkeypatch.setattr(Server, "_broadcast", wait_for_all)
    monkeypatch.setattr("urlink_accept.acceptance.standing.try_each", some)
    path = tmp_path / "run.urlog"
    run(f"sim://{address}", path, (1,), consent, person=Nobody())
    (verdict,) = judge(Evidence(path), {"silent-client": requirements()["silent-client"]})
    assert (verdict.state, "while another client did not read" in verdict.seen) == ("not held", True), verdict
