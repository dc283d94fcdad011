"""The `rhdlink` command: one module per subcommand, and shared modules."""

from __future__ import annotations

from collections.abc import Sequence

from linkcore.cli.program import program

__all__ = ["main"]

#: Module that declares each command.
_COMMANDS = {
    "serve": "serve",
    "turtle": "turtle",
    "mission": "mission",
    "vars": "vars",
    "get": "get",
    "set": "set",
    "watch": "watch",
    "record": "record",
    "replay": "replay",
    "export": "export",
    "dissect": "dissect",
    "completion": "linkcore.cli.completion",
}

_DESCRIPTION = "Read, drive, host and simulate mobile robots that run the Robot Hardware Daemon (RHD) or use MQTT."

_EPILOG = """\
addresses:
    smr12              a robot, by host name or address; the default port is 24902
    localhost:8001     a robot on another port
    mqtt://robobot     a robot with MQTT; the default port is 1883

a first try, in two terminals:
  rhdlink turtle
  rhdlink watch localhost"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line. Returns the exit status and never raises an exception."""
    return program("rhdlink", _COMMANDS, _DESCRIPTION, _EPILOG, argv)
