"""The `urlink` command: one module per subcommand, and modules that several subcommands use."""

from __future__ import annotations

from collections.abc import Sequence

from linkcore.cli.program import Plugin, program

__all__ = ["main"]

#: Commands in the order of the help. A value is the module of this folder that declares the command, or the package
#: that provides it.
_COMMANDS: dict[str, str | Plugin] = {
    "monitor": "monitor",
    "echo": "echo",
    "rtde": "rtde",
    "hz": "hz",
    "info": "info",
    "doctor": "doctor",
    "accept": Plugin("urlink-accept", "test a controller and store the evidence"),
    "run": "run",
    "jog": "jog",
    "teach": "teach",
    "points": "points",
    "dashboard": "dashboard",
    "record": "record",
    "replay": "replay",
    "plot": "plot",
    "explain": "explain",
    "export": "export",
    "exercise": Plugin("urlink-accept", "move each joint slowly, for a recording"),
    "identify": Plugin("urlink-accept", "estimate the parameters of an arm from a recording"),
    "compare": Plugin("urlink-accept", "compare a recording with the simulator"),
    "foxglove": Plugin("urlink-view[foxglove]", "serve a robot to Foxglove"),
    "view": Plugin("urlink-view", "show an arm in 3D in a browser"),
    "dissect": "dissect",
    "serve": "serve",
    "sim": "sim",
    "completion": "linkcore.cli.completion",
}

_DESCRIPTION = """\
Read and command Universal Robots arms of every generation: real, simulated, or from a recording."""

_EPILOG = """\
addresses:
  192.168.56.101                   a controller, by host name or IP address
  ur://host?primary=40001          a controller on other ports
  sim://                           a simulated UR5e; sim://ur10?firmware=3.4 for another one
  replay:///tmp/run.urlog?rate=2   a recording"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status; never raises."""
    return program("urlink", _COMMANDS, _DESCRIPTION, _EPILOG, argv)
