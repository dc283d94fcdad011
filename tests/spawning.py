"""Commands in separate processes, which end with the test that started them."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any


def spawning(module: str) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Yield a function for a fixture: ``spawn("echo", ...)`` runs ``python -m module echo ...``."""
    started: list[subprocess.Popen[str]] = []

    def spawn(*argv: str, **options: Any) -> subprocess.Popen[str]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
        process = subprocess.Popen([sys.executable, "-m", module, *argv], text=True, **pipes)
        started.append(process)
        return process

    yield spawn
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()
