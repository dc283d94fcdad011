"""The command `urlink serve mcp` over standard input and output, and the examples."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcp import Client
from mcp.client.stdio import StdioServerParameters

import urlink
from packages.mcp.tests.clients import MODES, Asked, is_moving, rests_before, run, text, turned, until, values
from packages.mcp.tests.test_http import INITIALIZE
from urlink.simulator import Controller

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

ROOT = Path(__file__).parents[3]
EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


@pytest.fixture
def watcher(controller: Controller) -> Iterator[urlink.Robot]:
    """Second connection to the same controller. It commands nothing until the test has ended."""
    with urlink.connect(controller.address, silence=20.0, stale_after=20.0) as robot:
        yield robot
        robot.motion.stop(wait=20.0)


def arguments(controller: Controller, *options: str) -> list[str]:
    return ["-m", "urlink.cli", "serve", "mcp", f"arm={controller.address}", *options]


ALLOW = ("--allow", "--limits", "teaching")


@pytest.mark.parametrize("mode", MODES)
def test_stdio_client_reads_and_moves_with_consent(
    controller: Controller, watcher: urlink.Robot, mode: str, log: Path
) -> None:
    person = Asked("accept", {"consent": True})

    async def elicit(context: Any, params: Any) -> Any:
        return await person(params.message)

    async def main() -> None:
        server = StdioServerParameters(command=sys.executable, args=arguments(controller, *ALLOW, "--log", str(log)))
        async with Client(server, mode=mode, elicitation_callback=elicit) as client:
            q = turned(watcher, 0.1)
            assert values(await client.call_tool("move_joints", {"q": q, "speed": 0.5})) == {"phase": "done"}
            np.testing.assert_allclose(watcher.realtime.wait(20.0).q_actual, q, atol=1e-3)
            assert "(in degrees?)" in text(await client.call_tool("move_joints", {"q": [90.0] * 6}))

    run(main())
    assert len(person.questions) == 1
    assert json.loads(log.read_text(encoding="utf-8").splitlines()[0])["session"] == "stdio"


@pytest.mark.parametrize("mode", MODES)
def test_killed_stdio_client_stops_arm(controller: Controller, watcher: urlink.Robot, mode: str) -> None:
    code = (
        "import asyncio, sys\n"
        "from mcp import Client\n"
        "from mcp.client.stdio import StdioServerParameters\n"
        "from mcp_types import ElicitResult\n"
        "async def elicit(context, params):\n"
        "    return ElicitResult(action='accept', content={'consent': True})\n"
        "async def main():\n"
        "    server = StdioServerParameters(command=sys.executable, args=eval(sys.argv[3]))\n"
        "    async with Client(server, mode=sys.argv[1], elicitation_callback=elicit) as client:\n"
        "        await client.call_tool('move_joints', {'q': eval(sys.argv[2]), 'speed': 0.1})\n"
        "asyncio.run(main())\n"
    )
    goal = turned(watcher, 2.0)
    command = [sys.executable, "-c", code, mode, repr(goal), repr(arguments(controller, *ALLOW))]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            run(until(lambda: is_moving(watcher)))
            assert process.poll() is None
            process.kill()
            run(rests_before(watcher, goal))
        finally:
            process.kill()


def served(controller: Controller, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, *arguments(controller, *options)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen(command, text=True, **pipes)  # type: ignore[call-overload, no-any-return]


def test_standard_output_contains_only_the_protocol(controller: Controller) -> None:
    with served(controller) as process:
        sent = [
            json.dumps(INITIALIZE),
            "this is not JSON",
            json.dumps({"jsonrpc": "2.0", "method": "notifications/initialized"}),
            json.dumps({"jsonrpc": "2.0", "id": 2, "method": "tools/list"}),
            json.dumps({"jsonrpc": "2.0", "id": 3, "method": "tools/call", "params": {"name": "get_state"}}),
        ]
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write("\n".join(sent) + "\n")
            process.stdin.flush()
            replies: list[Any] = []
            while not any(each.get("id") == 3 for each in replies):
                replies.append(json.loads(process.stdout.readline()))
            out, err = process.communicate(timeout=60.0)
        finally:
            process.kill()
    assert out == ""
    assert process.returncode == 0
    assert "serving arm over mcp" in err
    assert {each.get("id") for each in replies} >= {1, 2, 3}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM that a program can handle")
def test_sigterm_ends_server_while_input_is_open(controller: Controller) -> None:
    with served(controller) as process:
        try:
            assert process.stdin is not None
            assert process.stderr is not None
            while "serving arm over mcp" not in process.stderr.readline():
                assert process.poll() is None
            process.send_signal(signal.SIGTERM)
            assert process.wait(60.0) == 128 + signal.SIGTERM
        finally:
            process.kill()


def example(name: str, *options: str, entered: str = "") -> str:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *options],
        input=entered,
        capture_output=True,
        text=True,
        timeout=120.0,
        check=True,
        env=os.environ,
    )
    return done.stdout


def test_example_reads_state(controller: Controller) -> None:
    out = example("read_state.py", f"arm={controller.address}")
    assert "tools: list_robots, get_state" in out
    assert "move_joints" not in out
    assert re.search(r"base at -?\d+\.\d+ degrees, NORMAL\n", out)


@pytest.mark.parametrize(
    ("entered", "end", "degrees"),
    [
        ("yes\n", 'result: {"phase": "done"}', 5.0),
        ("no\n", "refused: the person declined", 0.0),
        ("y\n", "refused: the person declined", 0.0),
        ("", "refused: the person declined", 0.0),
    ],
)
def test_example_moves_only_after_yes(
    controller: Controller, watcher: urlink.Robot, entered: str, end: str, degrees: float
) -> None:
    before = watcher.realtime.wait(20.0).q_target[0]
    out = example("ask_to_move.py", f"arm={controller.address}", entered=entered)
    assert end in out
    assert "Requested by mcp" in out
    turned_by = np.degrees(watcher.realtime.wait(20.0).q_target[0] - before)
    assert turned_by == pytest.approx(degrees, abs=0.1)
