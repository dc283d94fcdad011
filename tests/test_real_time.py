"""Only a few tests run in real time, and each of them has the mark `real_time`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import platforms
from tests.real_time import SHARE, is_marked

pytest_plugins = ["pytester"]

#: Minimum number of tests in a run of the whole suite.
_WHOLE = 8000


def test_share_of_real_time_tests_is_small(request: pytest.FixtureRequest) -> None:
    items = request.session.items
    if len(items) < _WHOLE:
        pytest.skip(f"{len(items)} tests are not the whole suite")
    marked = sum(map(is_marked, items))
    assert marked <= SHARE * len(items), f"{marked} of {len(items)} tests are marked real_time"


def test_interop_tests_with_a_controller_are_marked_real_time() -> None:
    """The gate runs without the packages of others and skips these tests, so it would not detect a missing mark."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in Path(__file__).parent.glob("interop/test_*.py")}
    unmarked = [name for name, text in texts.items() if "Controller(" in text and "mark.real_time" not in text]
    assert (len(texts) > 5, unmarked) == (True, [])


USES = {
    "it starts a thread": "threading.Thread(target=print).start()",
    "it binds a socket": "socket.create_server(('127.0.0.1', 0)).close()",
    "it starts a process": "subprocess.run([sys.executable, '-c', ''])",
}
if not platforms.IS_WINDOWS:
    USES["it sends a signal"] = "signal.pthread_kill(threading.get_ident(), 0)"


@pytest.mark.real_time
def test_unmarked_test_with_system_calls_fails(pytester: pytest.Pytester) -> None:
    pytester.makeini("[pytest]\nmarkers = real_time")
    test = pytester.mkdir("tests") / "test_uses.py"
    test.write_text(
        "import pytest, signal, socket, subprocess, sys, threading\n"
        + "".join(
            f"{mark}\ndef test_{number}_{len(mark)}():\n    {use}\n"
            for number, use in enumerate(USES.values())
            for mark in ("", "@pytest.mark.real_time")
        )
    )
    result = pytester.runpytest_inprocess("-p", "tests.real_time", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=len(USES), failed=len(USES))
    result.stdout.fnmatch_lines_random([f"*{said}: mark it simulated_time*" for said in USES])


@platforms.needs_linux
def test_page_examples_run_in_simulated_time(pytester: pytest.Pytester) -> None:
    waits = ">>> import time\n>>> begun = time.monotonic()\n>>> time.sleep(3600)\n"
    waits += ">>> time.monotonic() - begun > 3599\nTrue\n"
    pytester.makefile(".md", page=waits)
    result = pytester.runpytest_inprocess("-p", "tests.real_time", "-p", "no:cacheprovider", "--doctest-glob=*.md")
    result.assert_outcomes(passed=1)
