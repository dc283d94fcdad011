from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import socket
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path

import pytest

import urlink.cli
from linkcore.cli.options import Subcommand, command
from linkcore.cli.program import Plugin
from tests.listed import assert_listed
from tests.spawning import ENDINGS, Ending
from urlink.cli import info

from .conftest import Run, write

COMMANDS = (
    *(
        "monitor",
        "echo",
        "rtde",
        "hz",
        "info",
        "doctor",
        "accept",
        "run",
        "jog",
        "teach",
        "points",
        "dashboard",
        "record",
        "replay",
    ),
    *("plot", "explain", "export", "exercise", "identify", "compare", "foxglove", "view", "dissect", "serve", "sim"),
    "completion",
)
Spawn = Callable[..., "subprocess.Popen[str]"]


def test_help_lists_commands_and_exit_status(run: Run) -> None:
    status, out, err = run("--help")
    assert (status, err) == (0, "")
    listed = out.partition("commands:\n")[2].partition("\n\n")[0].splitlines()[1:]
    names = tuple(line.split()[0] for line in listed if line[4] != " ")
    assert_listed(names, COMMANDS, "COMMANDS in tests/urlink/cli/test_main.py")
    assert names == COMMANDS
    assert "130" in out
    assert "replay://" in out


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_each_command_ends_in_examples(run: Run, command: str) -> None:
    status, out, _ = run(command, "--help")
    assert status == 0
    examples = out.partition("examples:\n")[2].splitlines()
    assert len(examples) >= 3
    # The script of `run` can be piped in, so an example can start with echo.
    assert all(example.startswith((f"  urlink {command}", "  echo ")) for example in examples)
    assert all(f" urlink {command}" in example for example in examples)
    assert max(map(len, out.splitlines())) <= 115


@pytest.mark.parametrize("options", [("-q",), ("--quiet", "-vv"), ("-qv",)])
def test_common_options_are_accepted_before_the_command(
    run: Run, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...]
) -> None:
    for argv in ((*options, "info", "sim://", "--json"), ("info", *options, "sim://", "--json")):
        seen: list[argparse.Namespace] = []
        (row,) = (each for each in vars(info).values() if isinstance(each, Subcommand))

        def note(args: argparse.Namespace, seen: list[argparse.Namespace] = seen) -> int:
            seen.append(args)
            return 0

        monkeypatch.setattr(info, "run", row._replace(run=note))
        assert run(*argv)[0] == 0
        assert (seen[0].quiet, seen[0].verbose) == (True, sum(each.count("v") for each in options))


@pytest.mark.parametrize(
    ("argv", "hint"),
    [
        (("--json", "info", "sim://"), "options come after the command: urlink info --json"),
        (("--duration", "3", "monitor", "sim://"), "options come after the command: urlink monitor --duration"),
        (("info", "sim://", "--jsn"), "unrecognized arguments: --jsn; did you mean '--json'?"),
    ],
)
def test_option_before_the_command_gives_a_usage_hint(run: Run, argv: tuple[str, ...], hint: str) -> None:
    status, _, err = run(*argv)
    assert status == 2
    assert err.splitlines()[-1].endswith(hint)


def test_doctor_reports_an_unknown_host_once(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr("socket.getaddrinfo", unknown)
    status, out, _ = run("doctor", "ur5-in-the-lab")
    assert status == 1
    computer, host = out.splitlines()
    assert computer[6:].startswith("computer")
    assert host.startswith("BAD   host           ur5-in-the-lab is unknown (Name or service not known); check ")


def test_help_works_without_docstrings(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """`python -OO` drops the docstrings, which are the help of the commands."""
    (row,) = (each for each in vars(info).values() if isinstance(each, Subcommand))
    monkeypatch.setattr(row.run, "__doc__", None)
    status, out, _ = run("info", "--help")
    assert status == 0
    assert "\nNo more help is available: this Python runs without docstrings (-OO).\n" in out
    assert "--json" in out


def test_only_module_of_called_command_is_imported(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Importing all of the modules takes longer than most commands."""
    imported = []

    def import_module(name: str) -> object:
        imported.append(name)
        return importlib.import_module(name)

    monkeypatch.setattr("linkcore.cli.program.import_module", import_module)
    assert run("dissect", "-v", "sim", "--help")[0] == 0
    assert imported == ["urlink.cli.dissect"]
    assert run("--version")[0] == 0
    imported.clear()
    assert run("-q", "nothing")[0] == 2
    assert imported[:3] == ["urlink.cli.monitor", "urlink.cli.echo", "urlink.cli.rtde"]


@pytest.mark.parametrize(
    ("argv", "install"),
    [
        (("view", "sim://", "--plot", "qd_actual"), "urlink: `urlink view` needs the package urlink-view"),
        (("accept", "sim://", "--stage", "0"), "pip install urlink-accept\n"),
        (("foxglove", "--help"), "pip install 'urlink-view[foxglove]'\n"),
    ],
)
def test_command_of_missing_package_names_pip_command(
    run: Run, monkeypatch: pytest.MonkeyPatch, argv: tuple[str, ...], install: str
) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: ())
    status, out, err = run(*argv)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert install in err


_PLUGINS = [name for name, where in urlink.cli._COMMANDS.items() if isinstance(where, Plugin)]


@pytest.mark.parametrize("name", _PLUGINS)
def test_summary_of_plugin_command_equals_its_package(name: str) -> None:
    """The help shows this summary while the package is not installed."""
    listed = urlink.cli._COMMANDS[name]
    assert isinstance(listed, Plugin)
    (entry,) = importlib.metadata.entry_points(group="urlink.commands", name=name)
    assert entry.dist is not None
    assert entry.dist.name == listed.distribution.partition("[")[0]
    (row,) = (each for each in vars(entry.load()).values() if isinstance(each, Subcommand) and each.name == name)
    assert row.summary == listed.summary


def test_help_names_missing_package_of_command(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: ())
    status, out, _ = run("--help")
    assert status == 0
    assert "show an arm in 3D in a browser (pip install urlink-view)" in " ".join(out.split())


def test_command_of_another_distribution_is_found(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = importlib.metadata.EntryPoint("wave", "wave_module", "urlink.commands")
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: (entry,) if "commands" in group else ())
    wave = types.ModuleType("wave_module")
    vars(wave)["row"] = command("wave", "wave the arm")(lambda args: 7)
    monkeypatch.setitem(sys.modules, "wave_module", wave)
    assert run("wave")[0] == 7
    assert "wave the arm" in run("--help")[1]
    assert "did you mean 'wave'?" in run("wvae")[2]


def test_version_is_printed(run: Run) -> None:
    status, out, _ = run("--version")
    assert status == 0
    assert out.startswith("urlink ")


@pytest.mark.parametrize(
    "argv",
    [
        (),
        ("nonsense",),
        ("monitor",),
        ("monitor", "sim://", "--duration", "0"),
        ("monitor", "sim://", "--duration", "soon"),
        ("monitor", "sim://", "--interface", "secondary"),
        ("monitor", "sim://", "surplus"),
        ("echo", "sim://", "--count", "0"),
        ("echo", "sim://", "--no-such-option"),
        ("hz", "sim://", "--window", "1.5"),
        ("dissect", "x", "--firmware", "2.0"),
        ("replay", "x", "--rate", "-1"),
    ],
)
def test_wrong_usage_exits_with_2(run: Run, argv: tuple[str, ...]) -> None:
    status, out, err = run(*argv)
    assert (status, out) == (2, "")
    assert err.startswith("usage: urlink")


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (("info", "a b"), "is not an address"),
        (("info", "ftp://x"), "unknown scheme"),
        (("monitor", "ur://127.0.0.1?primary=1&secondary=1"), "connection refused"),
        (("echo", "replay:///no/such/file"), f"cannot read {Path('/no/such/file')}"),
        (("replay", "/no/such/file"), f"cannot read {Path('/no/such/file')}"),
        (("replay", __file__), "is not a recording"),
        (("dissect", "/no/such/file"), "cannot read /no/such/file"),
        (("sim", "--model", "UR7"), "no arm is called 'UR7'"),
        (("sim", "--fault", "earthquake@1"), "no fault is called 'earthquake'"),
        (("record", "ur://127.0.0.1?primary=1&secondary=1", "/tmp/x.urlog"), "connection refused"),
    ],
)
@pytest.mark.real_time
def test_failure_prints_one_line_and_exits_with_1(run: Run, argv: tuple[str, ...], said: str) -> None:
    status, out, err = run(*argv)
    assert (status, out) == (1, "")
    assert err.startswith("urlink: ")
    assert said in err
    assert err.count("\n") == 1
    assert "Traceback" not in err


def test_error_message_escapes_hostile_path(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "x\x1b[2J\u202ey"
    status, _, err = run("replay", str(path))
    assert status == 1
    assert "x\\x1b[2J\\u202ey" in err


@pytest.mark.real_time
def test_verbose_logs_to_stderr(run: Run, address: str) -> None:
    status, out, err = run("echo", address, "time", "--count", "1", "-vv")
    assert status == 0
    assert out.count("\n") == 1
    status, _, quiet = run("echo", address, "time", "--count", "1")
    assert (status, quiet) == (0, "")
    assert err == "" or " linkcore." in err


@pytest.mark.real_time
def test_warnings_are_shown_without_verbose(run: Run, tmp_path: Path) -> None:
    bad = bytes.fromhex("000001f4") + bytes(496)
    path = write(tmp_path / "bad.urlog", {"realtime": [bad, bad]})
    status, out, err = run("replay", str(path), "--rate", "max")
    assert (status, out) == (0, "")
    assert "WARNING linkcore.streaming.receiver" in err
    assert "bad packet" in err
    assert "urlink: 2 packets could not be decoded\n" in err


@pytest.mark.slow
@pytest.mark.real_time
def test_closed_pipe_is_not_an_error(spawn: Spawn, address: str) -> None:
    process = spawn("echo", "--quiet", address, "q_actual")
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline().startswith("q_actual=[")
    process.stdout.close()
    assert process.wait(20) == 0
    assert process.stderr.read() == ""


@pytest.mark.slow
@pytest.mark.parametrize(("end", "status"), ENDINGS)
@pytest.mark.parametrize("command", ["echo", "hz", "monitor"])
@pytest.mark.real_time
def test_signals_end_command_quietly(spawn: Spawn, address: str, command: str, end: Ending, status: int) -> None:
    process = spawn(command, "--quiet", address)
    assert process.stdout is not None
    assert process.stdout.readline()
    end(process)
    _, err = process.communicate(timeout=20)
    assert process.returncode == status
    summary = ["urlink: watched", "urlink: next:"] if command == "monitor" else []
    assert [" ".join(line.split()[:2]) for line in err.splitlines()] == summary
