"""Fixtures for a real MQTT broker (mosquitto), if it is installed."""

from __future__ import annotations

import contextlib
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.waiting import until

__all__ = ["needs_broker", "running"]

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed (apt install mosquitto)")


@contextlib.contextmanager
def running(folder: Path, settings: str = "") -> Iterator[int]:
    """Run a mosquitto at 127.0.0.1 that accepts anonymous clients, and yield its port.

    Args:
        folder: Folder for its configuration.
        settings: Additional lines for the configuration of its listener.
    """
    assert MOSQUITTO is not None
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
    config = folder / "mosquitto.conf"
    # If root starts mosquitto, it would switch to a user that cannot read the files of the test.
    config.write_text(f"user root\nlistener {port} 127.0.0.1\nallow_anonymous true\n{settings}")
    process = subprocess.Popen([MOSQUITTO, "-c", str(config)], stderr=subprocess.DEVNULL)

    def answers() -> bool:
        assert process.poll() is None, "mosquitto has ended"
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
        except OSError:
            return False
        return True

    try:
        until(answers)
        yield port
    finally:
        process.kill()
        process.wait()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[int]:
    """Port of a running mosquitto."""
    with running(tmp_path) as port:
        yield port
