"""Differences between operating systems: the allowed reasons to skip a test, and what Wine does differently.

A test may be skipped on macOS or Windows only for one of `REASONS`, or because a package or a program is not installed.
At the end of a run, the plugin counts the skipped tests by reason. If another reason was used, the run fails.
"""

from __future__ import annotations

import collections
import ctypes
import os
import re
import signal
import socket
import sys
import sysconfig
import time

import pytest

FORK = "this system cannot fork"
SIGNALS = "this system has no POSIX signals, which the test needs"
NETWORKS = "a separate network needs Linux, with root, unshare and ip"
DESCRIPTORS = "processes cannot share descriptors on this system"
LINUX = "the test uses calls or options that only the Linux kernel has"
TERMINALS = "this system has no pseudo-terminals"
UNACKNOWLEDGED = "this system does not report unacknowledged bytes, so close does not wait for them"
CLOCKS = "this system has no clock_gettime"
OWNERS = "on a free-threaded build, the collector also finds objects that wait for the thread that made them"
PORTS = "Wine cannot listen again on a port whose connections have just ended"
MACHINE = "this computer does not have what the test needs"

#: The only allowed reasons that depend on the operating system.
REASONS = (FORK, SIGNALS, NETWORKS, DESCRIPTORS, LINUX, TERMINALS, UNACKNOWLEDGED, CLOCKS, OWNERS, PORTS, MACHINE)

#: Reasons that do not depend on the operating system: something is not installed, or a case is not defined.
_INSTALLED = re.compile(
    r"not installed|could not import|needs viser|captures.*does not exist|Python 3\.\d+|not the whole suite"
    r"|need an arm that is powered on|the weight of a .* is not known"
)

#: Whether this build has no global interpreter lock, even if the lock is switched on.
IS_FREE_THREADED = bool(sysconfig.get_config_var("Py_GIL_DISABLED"))

IS_LINUX = sys.platform == "linux"
IS_WINDOWS = sys.platform == "win32"
if sys.platform == "win32":
    IS_WINE = hasattr(ctypes.windll.ntdll, "wine_get_version")
else:
    IS_WINE = False

needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason=FORK)
needs_signals = pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason=SIGNALS)
needs_shared_descriptors = pytest.mark.skipif(IS_WINDOWS, reason=DESCRIPTORS)
needs_posix_clocks = pytest.mark.skipif(not hasattr(time, "clock_gettime"), reason=CLOCKS)
needs_reusable_ports = pytest.mark.skipif(IS_WINE, reason=PORTS)
needs_linux = pytest.mark.skipif(not IS_LINUX, reason=LINUX)
#: For tests that count what only the collector finds. There, an object that one thread made and another one released is
#: deleted later, by its own thread.
needs_prompt_release = pytest.mark.skipif(IS_FREE_THREADED, reason=OWNERS)
needs_acknowledgements = pytest.mark.skipif(IS_WINDOWS, reason=UNACKNOWLEDGED)


def was_reset(connection: socket.socket) -> bool:
    """Whether the other side has reset a connection whose bytes were read to the end.

    Under Wine, `recv` reports a reset as an orderly end. Only the next `send` fails.
    """
    if not IS_WINE:
        return False
    try:
        connection.send(b"\0")
    except ConnectionResetError:
        return True
    return False


def reason_of(report: pytest.TestReport | pytest.CollectReport) -> str:
    """Return the reason of a skipped test or module."""
    found = report.longrepr
    return found[2].removeprefix("Skipped: ") if isinstance(found, tuple) else str(found)


def is_allowed(reason: str) -> bool:
    """Whether a test may be skipped on macOS and Windows for this reason."""
    return reason in REASONS or bool(_INSTALLED.search(reason))


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Let the run fail if a test was skipped for a reason that is not allowed."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if IS_LINUX or reporter is None:
        return
    reasons = collections.Counter(reason_of(report) for report in reporter.stats.get("skipped", []))
    if any(not is_allowed(reason) for reason in reasons) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Count the skipped tests by reason."""
    if IS_LINUX:
        return
    reasons = collections.Counter(reason_of(report) for report in terminalreporter.stats.get("skipped", []))
    for reason, count in sorted(reasons.items()):
        note = "" if is_allowed(reason) else "NOT ALLOWED (tests/platforms.py): "
        terminalreporter.write_line(f"{count} skipped: {note}{reason}")
