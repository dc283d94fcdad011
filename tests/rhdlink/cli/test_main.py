from __future__ import annotations

from pathlib import Path

import pytest

from rhdlink import Host
from tests.spawning import ENDINGS, Ending

from .conftest import Run, Spawn

COMMANDS = (
    "serve",
    "turtle",
    "mission",
    "vars",
    "get",
    "set",
    "watch",
    "record",
    "replay",
    "export",
    "dissect",
    "completion",
)


def test_help_names_every_command_and_the_exit_status(run: Run) -> None:
    status, out, err = run("--help")
    assert (status, err) == (0, "")
    listed = out.partition("commands:\n")[2].partition("\n\n")[0].splitlines()[1:]
    assert tuple(line.split()[0] for line in listed if line[4] != " ") == COMMANDS
    assert "130" in out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command_ends_in_examples(run: Run, command: str) -> None:
    status, out, _ = run(command, "--help")
    assert status == 0
    examples = out.partition("examples:\n")[2].splitlines()
    assert len(examples) >= 3
    assert all(example.startswith(f"  rhdlink {command}") for example in examples)
    assert max(map(len, out.splitlines())) <= 115


def test_version_is_printed(run: Run) -> None:
    status, out, _ = run("--version")
    assert status == 0
    assert out.startswith("rhdlink ")


@pytest.mark.parametrize(
    "argv",
    [
        (),
        ("nonsense",),
        ("vars",),
        ("get", "localhost"),
        ("set", "localhost", "speedl"),
        ("set", "localhost", "speedl", "0.5"),
        ("set", "localhost", "speedl", "2147483648"),
        ("set", "localhost", "speedl", "1_0"),
        ("watch", "localhost", "--duration", "0"),
        ("watch", "localhost", "--no-such-option"),
        ("turtle", "--drive", "car"),
        ("turtle", "--port", "65536"),
        ("serve",),
        ("export", "dissect", "x", "--width", "3"),
    ],
)
def test_wrong_usage_exits_with_2(run: Run, argv: tuple[str, ...]) -> None:
    status, out, err = run(*argv)
    assert (status, out) == (2, "")
    assert err.startswith("usage: rhdlink")


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("vars", "a b"), "invalid address"),
        (("vars", "ftp://x"), "unknown scheme"),
        (("get", "127.0.0.1:1", "tick"), "connection refused"),
        (("set", "127.0.0.1:1", "tick", "1"), "connection refused"),
        (("watch", "127.0.0.1:1"), "connection refused"),
        (("dissect", "/no/such/file"), "cannot read /no/such/file"),
        (("serve", "/no/such/file"), "cannot read /no/such/file"),
        (("turtle", "--picture", "way.bmp"), "expected .svg or .png"),
    ],
)
@pytest.mark.real_time
def test_failure_prints_one_line_on_stderr_and_exits_with_1(run: Run, argv: tuple[str, ...], said: str) -> None:
    status, out, err = run(*argv)
    assert (status, out) == (1, "")
    assert err.startswith("rhdlink: ")
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.real_time
def test_port_in_use_is_reported(run: Run, host: Host) -> None:
    status, out, err = run("turtle", "--port", str(host.port))
    assert (status, out) == (1, "")
    assert f"cannot listen on 127.0.0.1:{host.port}" in err
    assert err.count("\n") == 1


def test_control_characters_in_errors_are_escaped(run: Run, tmp_path: Path) -> None:
    status, _, err = run("dissect", str(tmp_path / "x\x1b[2J\u202ey"))
    assert status == 1
    assert "x\\x1b[2J\\u202ey" in err


@pytest.mark.real_time
def test_verbose_logs_to_stderr(run: Run) -> None:
    status, _, err = run("turtle", "--port", "0", "--duration", "0.05", "-vv")
    assert status == 0
    assert err.startswith("rhdlink: turtle")


@pytest.mark.slow
@pytest.mark.parametrize(("end", "status"), ENDINGS)
@pytest.mark.parametrize("options", [("--plain",), ("--json",)])
@pytest.mark.real_time
def test_signals_end_a_watch_quietly(
    spawn: Spawn, address: str, options: tuple[str, ...], end: Ending, status: int
) -> None:
    process = spawn("watch", "--quiet", address, *options)
    assert process.stdout is not None
    assert process.stdout.readline()
    end(process)
    _, err = process.communicate(timeout=20)
    assert process.returncode == status
    summary = ["rhdlink: watched", "rhdlink: next:"] if options == ("--plain",) else []
    assert [" ".join(line.split()[:2]) for line in err.splitlines()] == summary


@pytest.mark.slow
@pytest.mark.real_time
def test_closed_output_pipe_is_not_an_error(spawn: Spawn, address: str) -> None:
    process = spawn("watch", "--quiet", address, "--json")
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline()
    process.stdout.close()
    assert process.wait(20) == 0
    assert process.stderr.read() == ""
