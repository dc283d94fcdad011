"""A hanging test ends the run with a dump of its stacks, whatever it hangs in."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests import platforms

pytestmark = pytest.mark.real_time

ROOT = Path(__file__).resolve().parents[1]

FORGETFUL = """
    import ctypes, signal, threading, time
    import pytest

    def test_keeps_the_interpreter_lock():
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})  # the alarm would interrupt the sleep
        ctypes.PyDLL(None).sleep(1000)

    @pytest.fixture
    def joins_a_blocked_thread():
        thread = threading.Thread(target=threading.Event().wait, daemon=True)
        thread.start()
        yield
        thread.join()

    @pytest.mark.timeout(0.5)
    def test_fails_and_then_blocks_again(joins_a_blocked_thread):
        assert False

    def test_breaks_off_while_it_is_reported(joins_a_blocked_thread):
        pass

    def test_leaves_a_thread():
        threading.Thread(target=threading.Event().wait).start()

    def test_is_in_order():
        pass
"""


BREAKS_OFF = """
    def pytest_runtest_makereport(item, call):
        if "breaks_off" in item.name and call.when == "call":
            raise RuntimeError("as the alarm of pytest-timeout does")
"""


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run pytest on the tests above with the watchdog, and without other installed plugins, so it starts faster."""
    for name, text in (("test_forgetful.py", FORGETFUL), ("conftest.py", BREAKS_OFF)):
        (folder / name).write_text("\n".join(line[4:] for line in text.splitlines()))
    (folder / "pytest.ini").write_text("[pytest]\n")
    plugins = ("-p", "pytest_timeout", "-p", "xdist", "-p", "tests.watchdog", "-p", "no:cacheprovider")
    return subprocess.run(
        [sys.executable, "-m", "pytest", *plugins, *arguments, str(folder)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        timeout=200,
    )


@platforms.needs_signals
@pytest.mark.parametrize(
    ("name", "stack"),
    [
        ("keeps_the_interpreter_lock", "in test_keeps_the_interpreter_lock"),
        ("fails_and_then_blocks_again", "in joins_a_blocked_thread"),
        ("breaks_off_while_it_is_reported", "in joins_a_blocked_thread"),
        ("leaves_a_thread", "in _shutdown"),
    ],
)
def test_hanging_test_ends_the_run_and_shows_its_stack(tmp_path: Path, name: str, stack: str) -> None:
    result = run(tmp_path, "--timeout=0.5", "-k", name)
    assert result.returncode == 1
    assert "Timeout" in result.stderr
    assert stack in result.stderr


@pytest.mark.slow
def test_watchdog_is_silent_when_a_test_ends(tmp_path: Path) -> None:
    result = run(tmp_path, "--timeout=20", "-k", "is_in_order")
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.slow
def test_other_tests_still_run_with_workers(tmp_path: Path) -> None:
    # Only the hanging test has a short limit. The general limit also applies to the end of the run, where the main
    # process waits for its workers, and that can take seconds on a busy computer.
    result = run(tmp_path, "--timeout=60", "-n", "1", "-k", "blocks_again or is_in_order")
    assert result.returncode == 1
    assert "crashed while running 'test_forgetful.py::test_fails_and_then_blocks_again'" in result.stdout
    assert "1 passed" in result.stdout
