"""Tasks of a new user, and the examples in the documentation that do them: ``python -m tests.new_user``.

For each task, the examples of one page up to the end of one section are extracted and run as a separate program. The
session `wheel` of nox runs them in an environment in which only the package is installed.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

__all__ = ["TASKS", "Task", "examples", "words"]

_DOCS = Path(__file__).resolve().parents[1] / "docs"
#: Time limit for the examples of one task on a busy machine, in s.
_TIMEOUT = 240.0


class Task(NamedTuple):
    """Task of a user, with the page and the section whose examples do it."""

    what: str
    page: str
    section: str


TASKS = (
    Task("see that it is installed", "install", "Install"),
    Task("read the positions of the joints", "first-ten-minutes", "Read its state"),
    Task("make the first movement", "first-ten-minutes", "Move it"),
    Task("make it slowly, with the robot", "first-day", "7. The first movement"),
    Task("keep the last seconds", "reading", "Wait for a state"),
    Task("be called for each state", "reading", "Subscribe with a callback"),
    Task("notice that the connection is lost", "reading", "When the connection is lost"),
    Task("receive messages of the controller", "reading", "Messages"),
    Task("decode bytes from a capture", "reading", "Decode bytes without a robot"),
    Task("move and wait", "moving", "Moving a robot"),
    Task("go through waypoints without stopping", "moving", "Pass waypoints without stopping (path)"),
    Task("move at a speed", "moving", "Move at a speed (speedj, speedl)"),
    Task("steer by a joystick", "moving", "Jog with a joystick or keys (jog)"),
    Task("stop a motion", "moving", "Stop and cancel"),
    Task("await a motion in asyncio", "moving", "Await a motion with asyncio"),
    Task("set an output and the payload", "settings", "Set outputs, payload, TCP, speed slider and popups"),
    Task("run a URScript program", "settings", "Run your own URScript"),
    Task("follow a trajectory", "trajectories", "Trajectories"),
    Task("close a loop", "servo", "Servo loops (servoj)"),
    Task("append points while it moves", "streams", "Points"),
    Task("press with a force", "force", "Apply a force"),
    Task("teach points by hand", "force", "Teach waypoints"),
    Task("resume after a protective stop", "safety", "Recover step by step"),
    Task("read variables by RTDE", "rtde", "Read variables"),
    Task("exchange numbers with a program", "rtde", "Registers"),
    Task("record and replay", "recording", "Replay"),
    Task("get a recording as arrays", "data", "Arrays"),
    Task("start a program of the pendant", "dashboard", "The commands"),
    Task("grasp something", "grippers", "Grippers"),
    Task("send statements one at a time", "interpreter", "Interpreter mode: execute URScript line by line"),
    Task("have the simulated robot fail", "simulator", "Inject faults"),
    Task("drive a mobile robot", "rhd", "The first ten minutes"),
    Task("run a mission", "missions", "Run a mission from Python"),
)


def examples(task: Task) -> str:
    """Return the examples of the page up to the end of the section, with their output.

    Raises:
        ValueError: If the page has no such section, or no examples up to its end.
    """
    lines = (_DOCS / f"{task.page}.md").read_text(encoding="utf-8").splitlines()
    found: list[str] = []
    is_example = is_code = has_begun = False
    for line in lines:
        heading = None if is_code else re.fullmatch(r"(#+) (.*)", line)
        if heading is not None:
            if has_begun:
                break
            has_begun = heading[2] == task.section
        if line.startswith("```"):
            is_code = not is_code
            is_example = is_code and line == "```pycon"
        elif is_example:
            found.append(line)
    if not has_begun or not found:
        raise ValueError(f"docs/{task.page}.md has no section {task.section!r} with examples up to its end")
    return "\n".join(found) + "\n"


def words() -> int:
    """Count the words from the first page to the first motion, without code."""
    ten = (_DOCS / "first-ten-minutes.md").read_text(encoding="utf-8").partition("## Record")[0]
    page = (_DOCS / "index.md").read_text(encoding="utf-8") + ten
    text = re.sub(r"(?ms)^```.*?^```$|^---$.*?^---$|\]\([^)]*\)|^:.*?$", "", page)
    return len(re.findall(r"\w[\w'.-]*", text))


def run(task: Task) -> str:
    """Run the examples of a task in a separate folder; return the failures, or an empty string."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "task.txt").write_text(examples(task), encoding="utf-8")
        env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
        try:
            done = subprocess.run(
                [sys.executable, "-m", "doctest", "-f", "-o", "ELLIPSIS", "task.txt"],
                cwd=folder,
                env=env,
                text=True,
                capture_output=True,
                timeout=_TIMEOUT,
            )
        except subprocess.TimeoutExpired:
            return f"the examples did not finish within {_TIMEOUT:g} s"
        return (done.stdout + done.stderr) if done.returncode else ""


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.new_user", description=__doc__)
    parser.add_argument("--only", metavar="TEXT", default="", help="run only tasks whose name contains TEXT")
    given = parser.parse_args()
    failed = 0
    for task in TASKS:
        if given.only in task.what:
            begun = time.perf_counter()
            wrong = run(task)
            failed += bool(wrong)
            print(f"{'FAILED' if wrong else 'ok':6} {time.perf_counter() - begun:5.1f} s  {task.what}  ({task.page})")
            if wrong:
                print(wrong)
    print(f"{len(TASKS)} tasks, {failed} failed; {words()} words from the first page to the first motion")
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())
