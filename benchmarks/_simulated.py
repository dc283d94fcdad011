"""Simulated controller in a separate process, to which the benchmarks connect."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["simulated"]


@contextmanager
def simulated(model: str, firmware: str, *options: str) -> Iterator[str]:
    """Run ``urlink sim`` with these options during the block, and yield its address."""
    command = [sys.executable, "-m", "urlink.cli", "sim", "--model", model, "--firmware", firmware, *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        if not address:
            raise SystemExit(f"{' '.join(command)} ended with {process.wait(10)}")
        yield address
    finally:
        process.terminate()
        process.communicate(timeout=10)
