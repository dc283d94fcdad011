from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

import urlink.cli
from linkcore.clock import Stamp
from linkcore.recording.file import Kind, RecordingWriter
from tests.harm import HOSTILE
from tests.spawning import spawning
from urlink.packets import JointData, RealtimeState, RobotModeData, RobotState, TextMessage, VersionMessage
from urlink.protocol.primary.robot_state import MasterboardData, ToolData
from urlink.simulator import Controller

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the command line in this process; return its exit status, stdout and stderr."""
    # On a busy computer, a short command can take so long that it would print its progress.
    monkeypatch.setattr("linkcore.cli.progress._FIRST", 600.0)

    def run(*argv: str) -> tuple[int, str, str]:
        status = urlink.cli.main(argv)
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def controller() -> Iterator[Controller]:
    """A simulated e-Series controller on free ports."""
    with Controller("UR5e", "5.11") as controller:
        yield controller


@pytest.fixture
def address(controller: Controller) -> str:
    return controller.address


@pytest.fixture
def old_address() -> Iterator[str]:
    """A simulated CB2 controller, whose real-time states have no safety mode, program state or outputs."""
    with Controller("UR5", "1.8") as controller:
        yield controller.address


@pytest.fixture
def silent_address(tmp_path: Path) -> str:
    """A recording whose robot never sent anything."""
    return f"replay://{write(tmp_path / 'silent.urlog', {'realtime': [], 'primary': []})}"


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Half a second of both interfaces, with one gap, a NaN, an infinite value, and hostile text."""
    realtime = [
        bytes(RealtimeState("5.11", time=number / 500, q_actual=[number, -1.5, 0.0, float("nan"), 0.0, 3.0]))
        for number in range(20)
    ]
    primary = [
        bytes(VersionMessage("5.11", project_name="URControl", major=5, minor=11, build_date="01-01-2024, 00:00:00")),
        bytes(TextMessage(text=HOSTILE)),
        bytes(
            RobotState(
                RobotModeData("5.11", robot_mode=7, is_program_running=True),
                JointData("5.11", q_actual=[0.0, -1.5, 0.0, 0.0, 0.0, float("inf")], joint_modes=[253] * 6),
                MasterboardData("5.11", digital_input_bits=5, analog_output_0=0.004, safety_mode=1),
                ToolData("5.11", analog_input_range_2=1, analog_input_2=2.5),
            )
        ),
    ]
    return write(tmp_path / "run one.urlog", {"realtime": realtime, "primary": primary}, gap_after=10)


def write(
    path: Path,
    channels: Mapping[str, Sequence[bytes]],
    *,
    gap_after: int | None = None,
    info: dict[str, Any] | None = None,
) -> Path:
    """Write a recording of these chunks, 10 ms apart."""
    writer = RecordingWriter(path)
    said = {"address": "made", "firmware": "5.11", "model": "UR5e"} | (info or {})
    for name, chunks in channels.items():
        channel = writer.add_channel({"name": name, **said})
        at = 1000.0
        for number, chunk in enumerate(chunks):
            if number == gap_after:
                at += 0.3
            writer.write(Kind.BYTES, channel, Stamp(at, 1.7e9 + at), chunk)
            at += 0.01
    writer.close()
    return path


@pytest.fixture
def spawn() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start the command in a new process; it is ended with the test if it is still running."""
    yield from spawning("urlink.cli")
