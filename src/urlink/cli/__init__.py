"""The `urlink` command: one module per subcommand, and what they share."""

from __future__ import annotations

from collections.abc import Sequence

from linkcore.cli.program import program

__all__ = ["main"]

#: command -> the module of this folder that declares it, in the order of the help
_COMMANDS = {
    "monitor": "monitor",
    "echo": "echo",
    "rtde": "rtde",
    "hz": "hz",
    "info": "info",
    "doctor": "doctor",
    "accept": "accept",
    "run": "run",
    "jog": "jog",
    "teach": "teach",
    "dashboard": "dashboard",
    "record": "record",
    "replay": "replay",
    "plot": "plot",
    "export": "export",
    "exercise": "identify",
    "identify": "identify",
    "compare": "identify",
    "foxglove": "view",
    "view": "view",
    "dissect": "dissect",
    "serve": "serve",
    "sim": "sim",
    "completion": "linkcore.cli.completion",
}

_DESCRIPTION = """\
Read and command Universal Robots arms of every generation: real, simulated, or from a recording."""

_EPILOG = """\
addresses:
  192.168.56.101                   a controller, by name or number
  ur://host?primary=40001          one on other ports
  sim://                           a simulated UR5e; sim://ur10?firmware=3.4 another
  replay:///tmp/run.urlog?rate=2   a recording"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status and never raises."""
    return program("urlink", _COMMANDS, _DESCRIPTION, _EPILOG, argv)
