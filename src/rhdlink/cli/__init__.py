"""The `rhdlink` command: a module for each group of subcommands, and what they share."""

from __future__ import annotations

from collections.abc import Sequence

from linkcore.cli.program import program

__all__ = ["main"]

#: command -> the module of this folder that declares it
_COMMANDS = {
    "serve": "hosting",
    "turtle": "hosting",
    "mission": "mission",
    "vars": "values",
    "get": "values",
    "set": "values",
    "watch": "values",
    "record": "recordings",
    "replay": "recordings",
    "export": "recordings",
    "dissect": "dissect",
    "completion": "linkcore.cli.program",
}

_DESCRIPTION = "Read, drive, host and simulate mobile robots that run the Robot Hardware Daemon (RHD)."

_EPILOG = """\
addresses:
  smr12              a robot, by name or number; the port is 24902 where none is named
  localhost:8001     one on another port

a first try, in two terminals:
  rhdlink turtle
  rhdlink watch localhost

exit status:
  0 done, 1 an error of the robot, the file or the address (one line on stderr), 2 wrong usage,
  130 ended by Ctrl-C, 143 by SIGTERM

`rhdlink COMMAND --help` explains each command, with examples."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status and never raises."""
    return program("rhdlink", _COMMANDS, _DESCRIPTION, _EPILOG, argv)
