from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

import linkcore.clock
import urlink
from linkcore.cli.terminal import quoted
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.statistics import StreamStatistics
from tests import platforms
from tests.harm import HOSTILE, assert_harmless
from urlink.cli import monitor
from urlink.cli.monitor_panel import MonitorPanel
from urlink.cli.monitor_view import MonitorView, Reading, StreamStatus, age_text, line, read, status_of
from urlink.protocol.firmware import RELEASES, Firmware
from urlink.simulator import Controller

from .conftest import Run, write

pytestmark = pytest.mark.simulated_time

_STATS = StreamStatistics(
    received=7,
    decoded=6,
    failed=1,
    missed=7,
    gaps=2,
    longest_gap=0.4,
    slow_inline=0,
    reconnects=2,
    rate=125.0,
    bytes=0,
    skipped=3,
    resyncs=0,
    unknown=0,
    tails=0,
    age=0.1,
    duplicates=4,
)
Spawn = Callable[..., "subprocess.Popen[str]"]


def painted(view: MonitorView, width: int = 100, colour: bool = False) -> str:
    console = Console(
        file=io.StringIO(), width=width, force_terminal=colour, color_system="truecolor" if colour else None
    )
    console.print(MonitorPanel(view))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def until(views: Iterator[MonitorView], wanted: Callable[[MonitorView], bool]) -> MonitorView:
    """Return the first view that meets the condition, within ten seconds."""
    deadline = linkcore.clock.now() + 10
    for view in views:
        if wanted(view):
            return view
        assert linkcore.clock.now() < deadline, f"still {view}"
        time.sleep(0.005)
    raise AssertionError("no more views")


# -- lines ---------------------------------------------------------------------------------------------


def test_plain_lines_show_rate_pose_and_modes(run: Run, address: str) -> None:
    status, out, err = run("monitor", address, "--duration", "1.3")
    assert status == 0
    watched, step = err.splitlines()
    assert re.fullmatch(
        r"urlink: watched for 1\.\d s, \d+\.\d Hz on average; "
        r"received \d+ missed 0 duplicates 0 failed 0 reconnects 0",
        watched,
    )
    assert step == f"urlink: next: urlink record {quoted(address)} run.urlog to record what the robot sends"
    lines = out.splitlines()
    assert len(lines) == 3  # immediately, after a second, and at the end
    for text in lines:
        assert re.match(r"\d\d:\d\d:\d\d (CONNECTED|SLOW) \| UR5e  firmware 5\.11 \| ", text)
        for part in ("age ", "q ", " deg", "tool ", "robot RUNNING", "safety NORMAL", "program STOPPED", "failed 0"):
            assert part in text
    rate = re.search(r"([\d.]+)(?: of 500)? Hz", lines[-1])
    assert rate is not None
    assert 100 < float(rate[1]) < 1000  # wide limits, because the computer might be busy
    assert "- Hz" in lines[0]  # the rate is unknown at first


@pytest.mark.parametrize("interface", ["realtime", "primary"])
def test_monitor_omits_fields_that_old_firmware_does_not_send(run: Run, old_address: str, interface: str) -> None:
    status, out, _ = run("monitor", old_address, "--interface", interface, "--duration", "0.3", "--plain")
    assert status == 0
    assert "robot RUNNING" in out
    assert ("program" in out) is (interface == "primary")


@pytest.mark.parametrize(
    ("address", "program"),
    [("sim://", "PLAYING"), ("sim://ur10?firmware=3.4", "PLAYING"), ("sim://?motion=still", "STOPPED")],
)
def test_simulated_arm_moves_unless_motion_is_still(run: Run, address: str, program: str) -> None:
    status, out, _ = run("monitor", address, "--plain", "--duration", "0.5", "--interface", "primary")
    assert status == 0
    assert f"program {program}" in out.splitlines()[-1]


def test_monitor_ends_with_recording(run: Run, recording: Path) -> None:
    status, out, _ = run("monitor", f"replay://{str(recording).replace(' ', '%20')}", "--plain")
    assert status == 0
    assert " ENDED | " in out.splitlines()[-1]
    assert "OLD DATA" in out.splitlines()[-1]


RUN = Path("/tmp/run one.urlog")


@pytest.mark.parametrize(
    ("status", "counts", "address", "step"),
    [
        (StreamStatus.CONNECTED, {}, "sim://", "urlink record sim:// run.urlog"),
        (StreamStatus.SLOW, {}, "sim://?motion=still", "urlink doctor QUOTEsim://?motion=stillQUOTE"),
        (StreamStatus.LOST, {}, "10.0.0.7", "urlink doctor 10.0.0.7"),
        (StreamStatus.CONNECTED, {"missed": 3}, "10.0.0.7", "urlink doctor 10.0.0.7"),
        (StreamStatus.CONNECTED, {"reconnects": 1}, "10.0.0.7", "urlink doctor 10.0.0.7"),
        (
            StreamStatus.ENDED,
            {},
            "replay:///tmp/run%20one.urlog?rate=2",
            f"urlink replay QUOTE{Path('/tmp/run one.urlog')}QUOTE",
        ),
    ],
)
def test_next_step_depends_on_status_and_counts(
    status: StreamStatus, counts: dict[str, int], address: str, step: str
) -> None:
    stats = replace(_STATS, **({"missed": 0, "reconnects": 0} | counts))
    view = MonitorView("UR5e", address, status, Reading(None), stats)
    step = step.replace("QUOTE", '"' if platforms.IS_WINDOWS else "'")
    assert monitor.next_step(view, address).startswith(f"next: {step} ")


def test_summary_counts_states_and_names_the_longest_gap() -> None:
    view = MonitorView("UR5e", "sim://", StreamStatus.CONNECTED, Reading(None), _STATS)
    counts = "received 7 missed 7 duplicates 4 failed 1 reconnects 2, longest gap 0.400 s"
    assert monitor.summary(view, 2.0) == f"watched for 2.0 s, 3.5 Hz on average; {counts}"
    assert monitor.summary(view, 0.5) == f"watched for 0.5 s; {counts}"


def test_monitor_fails_when_recording_has_no_states(run: Run, silent_address: str) -> None:
    status, out, err = run("monitor", silent_address)
    assert status == 1
    assert "no state yet" in out
    assert err == f"urlink: {silent_address}: no state arrived\n"


def test_monitor_fails_when_no_state_arrives_in_time(run: Run, controller: Controller, address: str) -> None:
    controller.faults.stall(30, "realtime")
    try:
        status, out, err = run("monitor", address, "--duration", "0.2")
    finally:
        controller.faults.heal()
    assert status == 1
    assert " WAITING | " in out
    assert "no state arrived within 0.2 s" in err


def test_lost_connection_marks_data_as_old() -> None:
    with Controller("UR5e", "5.11") as controller:
        where = controller.address
        with urlink.connect(where, silence=0.7, backoff=urlink.Backoff(first=0.2, most=0.2)) as robot:
            views = monitor.watch(robot, "realtime")
            fresh = until(views, lambda view: view.status is StreamStatus.CONNECTED)
            assert fresh.is_fresh
            assert fresh.reading is not None

            controller.faults.stall(60)
            silent = until(views, lambda view: view.status is not StreamStatus.CONNECTED)
            assert silent.status is StreamStatus.SILENT
            assert not silent.is_fresh
            lost = until(views, lambda view: view.status is StreamStatus.LOST and view.trouble is not None)
            assert lost.reading is not None
            assert lost.reading.age > 0.5
            assert " LOST | " in line(lost, "12:00:00")
            assert "OLD DATA" in line(lost, "12:00:00")
            assert re.search(r"│  LOST   OLD DATA, [\d.]+ m?s ", painted(lost))

            controller.faults.heal()
            again = until(views, lambda view: view.status is StreamStatus.CONNECTED)
            assert again.stats.reconnects >= 1
            assert again.trouble is None


def test_monitor_shows_new_firmware_after_reboot() -> None:
    with Controller("UR5e", "5.4") as controller:
        where = controller.address
        with urlink.connect(where, backoff=urlink.Backoff(first=0.05, most=0.1)) as robot:
            views = monitor.watch(robot, "realtime")
            until(views, lambda view: view.status is StreamStatus.CONNECTED)
            controller.faults.reboot("5.12", downtime=0.3)
            view = until(views, lambda view: "firmware 5.12" in view.robot)
            assert view.stats.reconnects >= 1


@pytest.mark.parametrize(
    ("connection", "has_latest", "age", "status"),
    [
        (ConnectionState.CONNECTING, False, None, StreamStatus.CONNECTING),
        (ConnectionState.CONNECTED, False, None, StreamStatus.WAITING),
        (ConnectionState.CONNECTED, True, 0.0, StreamStatus.CONNECTED),
        (ConnectionState.CONNECTED, True, 1.0, StreamStatus.SILENT),
        (ConnectionState.CONNECTED, False, 0.0, StreamStatus.SILENT),
        (ConnectionState.CONNECTING, False, 0.0, StreamStatus.LOST),
        (ConnectionState.LOST, False, 0.0, StreamStatus.LOST),
        (ConnectionState.CLOSED, False, 0.0, StreamStatus.ENDED),
    ],
)
def test_status_follows_connection_and_age(
    connection: ConnectionState, has_latest: bool, age: float | None, status: StreamStatus
) -> None:
    reading = None if age is None else Reading(urlink.packets.Stamp(linkcore.clock.now() - age, 0.0))
    assert status_of(connection, has_latest, reading) is status


@pytest.mark.parametrize(
    ("rate", "usual", "status"),
    [
        (500.0, 500.0, StreamStatus.CONNECTED),
        (476.0, 500.0, StreamStatus.CONNECTED),
        (474.0, 500.0, StreamStatus.SLOW),
        (111.0, 500.0, StreamStatus.SLOW),
        (9.4, 10.0, StreamStatus.SLOW),
        (None, 500.0, StreamStatus.CONNECTED),
        (111.0, None, StreamStatus.CONNECTED),
    ],
)
def test_status_is_slow_below_95_percent_of_usual_rate(
    rate: float | None, usual: float | None, status: StreamStatus
) -> None:
    reading = Reading(urlink.packets.Stamp.now(), q=[0.0] * 6)
    seen = status_of(ConnectionState.CONNECTED, True, reading, rate, usual)
    assert seen is status
    view = MonitorView("UR5e", "here", seen, reading, _STATS, rate, usual)
    assert view.is_fresh
    if status is StreamStatus.SLOW:
        assert f"SLOW   {rate:.1f} of {usual:g} Hz" in painted(view).replace("  SLOW ", "SLOW")
        assert f" SLOW | UR5e | {rate:.1f} of {usual:g} Hz | " in line(view, "12:00:00")


@pytest.mark.slow
def test_status_is_slow_when_states_are_missing(address: str, controller: Controller) -> None:
    with urlink.connect(address) as robot:
        views = monitor.watch(robot, "realtime")
        until(views, lambda view: view.rate is not None)
        finished = threading.Event()

        def stall() -> None:
            while not finished.is_set():
                controller.faults.stall(0.1, "realtime")
                finished.wait(0.15)

        stalling = threading.Thread(target=stall)
        stalling.start()
        try:
            view = until(views, lambda view: view.status is StreamStatus.SLOW)
        finally:
            finished.set()
            stalling.join()
            controller.faults.heal()
        assert view.usual == 500
        assert view.stats.missed


def test_age_text_uses_milliseconds_seconds_or_minutes() -> None:
    assert [age_text(age) for age in (0.0021, 3.44, 90, 1200)] == ["2 ms", "3.4 s", "90.0 s", "20 min"]


# -- readings ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_monitor_reads_and_draws_every_firmware(release: Any) -> None:
    firmware: Firmware = release.since
    controller = Controller(None, firmware)
    controller.step(10)
    (realtime,) = urlink.decode(controller.realtime_packet(), "realtime")
    (primary,) = urlink.decode(controller.state_package(first=True), "primary")
    for state in (realtime, primary):
        reading = read(state)
        assert reading.q is not None
        assert reading.pose is not None
        assert len(reading.q) == len(reading.pose) == 6
        for width in (100, 80, 40):
            text = painted(MonitorView("UR", "made", StreamStatus.CONNECTED, reading, _STATS), width)
            assert max(map(len, text.splitlines())) <= width
            assert "wrist 3" in text or width == 40
        assert line(MonitorView("UR", "made", StreamStatus.CONNECTED, reading, _STATS), "12:00:00")
    assert read(realtime).q == pytest.approx(list(realtime.q_actual))
    assert read(primary).analog[-1].unit == "mA"
    assert read(primary).analog[-1].value == pytest.approx(4.0)


def test_monitor_draws_a_state_without_sub_packages() -> None:
    view = MonitorView("UR", "made", StreamStatus.CONNECTED, read(urlink.packets.RobotState()), _STATS)
    assert "joint" not in painted(view)
    assert "robot –" in painted(view)
    assert "no state" not in line(view, "12:00:00")


# -- the panel -----------------------------------------------------------------------------------------


def test_panel_shows_every_value() -> None:
    state = urlink.packets.RealtimeState(
        "5.11",
        q_actual=[3.14159265, -1.5, 0, float("nan"), float("inf"), 99],
        I_actual=[1.25] * 6,
        motor_temperatures=[41.5] * 6,
        joint_modes=[252, 253, 253, 253, 253, 99],
        tool_vector_actual=[0.1, 0.2, 0.3, 1.0, 2.0, 3.0],
        tcp_force=[1, 2, 3, 0.5, 0.25, 0.125],
        robot_mode=7,
        safety_mode=3,
        safety_status=3,
        digital_input_bits=1 << 0 | 1 << 9 | 1 << 40,
        digital_output_bits=1 << 17,
        program_state=4,
        speed_scaling=0.5,
    )
    view = MonitorView("UR5e  firmware 5.11", "made realtime", StreamStatus.CONNECTED, read(state), _STATS, 125.0)
    text = painted(view)
    for part in (
        "CONNECTED", "125.0 Hz", "180.00", "3.1416", "nan", "inf", "1.25", "41.5", "FAULT", "UNKNOWN_99", "0.2000",
        "0.12", "robot RUNNING", "safety PROTECTIVE_STOP", "program PAUSED", "speed 50%",
        "0-7 ●○○○○○○○   8-15 ○●○○○○○○",
        "and 0x10000000000", "16-17 ○●", "received 7", "missed 7", "duplicates 4", "failed 1", "reconnects 2",
        "skipped 3",
    ):  # fmt: skip
        assert part in text, part
    assert len(text.splitlines()) <= 24
    bold_white_on_red = "\x1b[1;37;41m"
    assert f"{bold_white_on_red}PROTECTIVE_STOP" in painted(view, colour=True)


def test_old_values_are_dim_and_never_green() -> None:
    state = urlink.packets.RealtimeState("5.11", robot_mode=7, safety_mode=1, safety_status=1, joint_modes=[253] * 6)
    fresh = MonitorView("UR", "made", StreamStatus.CONNECTED, read(state), _STATS)
    lost = MonitorView("UR", "made", StreamStatus.LOST, read(state), _STATS, trouble="cable")
    green = "\x1b[32m"
    assert green in painted(fresh, colour=True)
    assert green not in painted(lost, colour=True)
    assert "cable" in painted(lost)


def test_panel_escapes_hostile_text() -> None:
    view = MonitorView(HOSTILE, HOSTILE, StreamStatus.LOST, None, _STATS, trouble=HOSTILE, message=HOSTILE)
    assert_harmless(painted(view), line(view, "12:00:00"))
    assert "\\x1b[2J" in painted(view)


def test_panel_shows_messages_of_controller(recording: Path) -> None:
    with urlink.connect(f"replay://{str(recording).replace(' ', '%20')}?rate=max") as robot:
        views = monitor.watch(robot, "primary")
        view = until(views, lambda view: view.message is not None and "TextMessage" in view.message)
    assert_harmless(painted(view))
    assert "message   TextMessage text='safe\\x1b[2J" in painted(view)


def test_monitor_escapes_hostile_text_of_recording(run: Run, tmp_path: Path) -> None:
    path = write(
        tmp_path / "x.urlog", {"realtime": [bytes(urlink.packets.RealtimeState("5.11"))]}, info={"model": HOSTILE}
    )
    status, out, err = run("monitor", f"replay://{path}", "--plain")
    assert status == 0
    assert_harmless(out, err)


# -- a terminal ----------------------------------------------------------------------------------------


def on_terminal(*argv: str, interrupt_after: bytes | None = None, code: str = "") -> tuple[int, str]:
    """Run the monitor on a terminal; return its exit status and its whole output."""
    pty = pytest.importorskip("pty", reason=platforms.TERMINALS)
    master, slave = pty.openpty()
    program = f"import sys; {code or 'pass'}; from urlink.cli import main; sys.exit(main(sys.argv[1:]))"
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"}
    process = subprocess.Popen(
        [sys.executable, "-c", program, *argv], stdin=slave, stdout=slave, stderr=slave, env=environment
    )
    os.close(slave)
    written = b""
    while True:
        try:
            data = os.read(master, 65536)
        except OSError:  # on Linux, this means that no process has the terminal open any more
            break
        if not data:
            break
        written += data
        if interrupt_after is not None and interrupt_after in written:
            interrupt_after = None
            process.send_signal(signal.SIGINT)
    os.close(master)
    return process.wait(20), written.decode()


_HIDE, _SHOW = "\x1b[?25l", "\x1b[?25h"


@pytest.mark.slow
@pytest.mark.real_time
def test_terminal_is_left_clean_at_the_end(address: str) -> None:
    for seconds in ("0.5", "5", "50"):  # on a busy computer, connecting can take more than half a second
        status, written = on_terminal("monitor", address, "--duration", seconds)
        assert status == 0
        if "wrist 3" in written:
            break
    assert "CONNECTED" in written
    assert "wrist 3" in written
    assert written.rfind(_SHOW) > written.rfind(_HIDE) >= 0
    assert written.rpartition(_SHOW)[0].endswith("╯\x1b[0m\r\n")
    assert written.rpartition(_SHOW)[2].startswith("urlink: watched for ")


@pytest.mark.real_time
def test_ctrl_c_leaves_the_terminal_clean(address: str) -> None:
    status, written = on_terminal("monitor", address, interrupt_after=b"wrist 3")
    assert status == 130
    assert "Traceback" not in written
    assert written.rpartition(_SHOW)[0].endswith("╯\x1b[0m\r\n")
    assert written.rpartition(_SHOW)[2].startswith("urlink: watched for ")


@pytest.mark.slow
@pytest.mark.real_time
def test_plain_option_works_on_terminal(address: str) -> None:
    status, written = on_terminal("monitor", "-q", address, "--plain", "--duration", "0.2")
    assert status == 0
    assert "\x1b" not in written


@pytest.mark.slow
@pytest.mark.real_time
def test_monitor_without_rich_prints_lines_and_hint(address: str) -> None:
    status, written = on_terminal("monitor", "-q", address, "--duration", "0.2", code="sys.modules['rich'] = None")
    assert status == 0
    assert "pip install 'urlink-robot[cli]'" in written
    assert "CONNECTED | " in written
    assert "\x1b" not in written


@pytest.mark.real_time
def test_rich_is_not_imported_by_the_cli() -> None:
    code = "import sys; import urlink.cli; assert 'rich' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
