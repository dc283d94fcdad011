"""Commands in separate processes, which end with the test that started them."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests import platforms


def spawning(module: str) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Yield a function for a fixture: ``spawn("echo", ...)`` runs ``python -m module echo ...``."""
    started: list[subprocess.Popen[str]] = []

    def spawn(*argv: str, **options: Any) -> subprocess.Popen[str]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
        process = subprocess.Popen(
            [sys.executable, "-m", module, *argv], text=True, creationflags=_OWN_CONSOLE, **pipes
        )
        started.append(process)
        return process

    yield spawn
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


def interrupt(process: subprocess.Popen[str]) -> None:
    """Press Ctrl-C for a process of `spawning`."""
    if sys.platform == "win32":
        # Ctrl-C goes to all processes of a console, so another process attaches to the console and presses it there.
        subprocess.run([sys.executable, "-c", _PRESS, str(process.pid)], check=True, timeout=20)
    else:
        process.send_signal(signal.SIGINT)


def terminate(process: subprocess.Popen[str]) -> None:
    """Send SIGTERM to a process."""
    process.send_signal(signal.SIGTERM)


#: Function that ends a command from outside.
Ending = Callable[["subprocess.Popen[str]"], None]

#: Both ways to end a command from outside, and its exit status.
ENDINGS = [
    pytest.param(interrupt, 130, id="SIGINT"),
    pytest.param(terminate, 143, id="SIGTERM", marks=platforms.needs_signals),
]

#: Flag for a process with a console of its own, which has no window (Windows).
_OWN_CONSOLE: int = getattr(subprocess, "CREATE_NO_WINDOW", 0)

#: Program that presses Ctrl-C in the console of another process (Windows).
_PRESS = """
import ctypes, sys
kernel = ctypes.WinDLL("kernel32", use_last_error=True)
kernel.FreeConsole()
if not kernel.AttachConsole(int(sys.argv[1])):
    sys.exit(f"AttachConsole failed: error {ctypes.get_last_error()}")
kernel.SetConsoleCtrlHandler(None, True)
if not kernel.GenerateConsoleCtrlEvent(0, 0):
    sys.exit(f"GenerateConsoleCtrlEvent failed: error {ctypes.get_last_error()}")
"""
