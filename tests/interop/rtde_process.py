"""Separate process for ur_rtde that executes calls line by line.

The constructors of ur_rtde wait for the controller while they hold the interpreter lock. So a simulator in the same
process would never answer. A line is `[name of an interface or of its class, method, arguments]` as JSON;
`["control", "", [...]]` makes the interface. The reply is `{"value": ...}` or `{"error": ...}`.
"""

from __future__ import annotations

import json
import sys
from importlib import import_module
from typing import Any


def classes() -> dict[str, Any]:
    """Return the interfaces by name; import them here, because pytest imports this module even without ur_rtde."""
    return {
        "control": import_module("rtde_control").RTDEControlInterface,
        "io": import_module("rtde_io").RTDEIOInterface,
        "receive": import_module("rtde_receive").RTDEReceiveInterface,
    }


def path_of(entries: list[list[Any]]) -> Any:
    """Make a path from `[[kind of move, "joints" or "tool", parameters], ...]`."""
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
        # ur_rtde writes its own messages to the standard output, so replies use the standard error.
        sys.stderr.write(f"\n>>>{text}\n")
        sys.stderr.flush()


if __name__ == "__main__":
    main()
