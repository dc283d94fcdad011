"""ur_rtde in a process of its own, which does what it is told line by line.

Its constructors wait for the controller with the interpreter's lock held, so that a simulator in the same process would
never answer. A line is `[name of an interface or of its class, method, arguments]` as JSON; `["control", "", [...]]`
makes the interface. The reply is `{"value": ...}` or `{"error": ...}`.
"""

from __future__ import annotations

import json
import sys
from importlib import import_module
from typing import Any


def classes() -> dict[str, Any]:
    """The interfaces by name. Not imported with this module, which those who have no ur_rtde collect tests from too."""
    return {
        "control": import_module("rtde_control").RTDEControlInterface,
        "io": import_module("rtde_io").RTDEIOInterface,
        "receive": import_module("rtde_receive").RTDEReceiveInterface,
    }


def path_of(entries: list[list[Any]]) -> Any:
    """`[[kind of move, "joints" or "tool", parameters], ...]`"""
    rtde_control = import_module("rtde_control")
    path = rtde_control.Path()
    for kind, where, parameters in entries:
        path.addEntry(
            rtde_control.PathEntry(
                getattr(rtde_control.PathEntry, f"Move{kind}"),
                getattr(rtde_control.PathEntry, "PositionJoints" if where == "joints" else "PositionTcpPose"),
                parameters,
            )
        )
    return path


def main() -> None:
    made: dict[str, Any] = {}
    interfaces = classes()
    for line in sys.stdin:
        name, method, arguments = json.loads(line)
        try:
            if not method:
                made[name] = value = interfaces[name](*arguments)
                value = True
            elif method == "movePath":
                value = made[name].movePath(path_of(arguments[0]), *arguments[1:])
            else:
                value = getattr(made[name], method)(*arguments)
            reply = {"value": value}
        except Exception as error:
            reply = {"error": f"{type(error).__name__}: {error}"}
        try:
            text = json.dumps(reply)
        except TypeError:
            text = json.dumps({"value": repr(reply["value"])})
        # ur_rtde writes messages of its own to the standard output.
        sys.stderr.write(f"\n>>>{text}\n")
        sys.stderr.flush()


if __name__ == "__main__":
    main()
