"""Fixtures and settings for every test."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import Phase, settings

from tests import real_captures
from tests.waiting import until

# The default is few examples, so that the test run stays fast; `nox -f nightly.py -s fuzz` tries many.
settings.register_profile("default", deadline=None, derandomize=False, max_examples=10)
# The gate (CI) must give the same result for the same files; `fuzz` and local runs search for new failures.
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=10, print_blob=True)
settings.register_profile("fuzz", deadline=None, derandomize=False, max_examples=2000, print_blob=True)
# The run of a mutant ends with the first failure, so failing examples are neither shrunk nor saved.
settings.register_profile(
    "mutants",
    deadline=None,
    derandomize=True,
    max_examples=25,
    database=None,
    phases=(Phase.explicit, Phase.generate),
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") else "default"))


def pytest_configure() -> None:
    """Restore the handler of SIGINT, because a shell that starts the run in the background ignores SIGINT."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Freeze all objects made so far, because hundreds of tests collect garbage to find unclosed sockets."""
    # At its first import on a computer, this module lists the installed fonts with a process and a thread.
    with contextlib.suppress(ImportError):
        importlib.import_module("matplotlib.font_manager")
    leave_to_stay()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """Freeze the remaining objects after each test module, when its fixtures have been removed."""
    if nextitem is None or nextitem.path != item.path:
        leave_to_stay()


def leave_to_stay() -> None:
    """Exclude all current objects from later garbage collections.

    Collecting the tests makes half a million objects, and modules keep everything that they imported, parsed or
    computed. All of these objects stay until the end, and each garbage collection would spend about 0.1 s on them.
    """
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    real_captures.require(item)


@pytest.fixture
def captures() -> Path:
    """Folder of packets of real controllers, for a test marked ``captures("ur")``."""
    return real_captures.folder("ur")


@pytest.fixture(autouse=True)
def time_of_the_test(request: pytest.FixtureRequest) -> None:
    """Simulate time for the test and its fixtures, if the test or its module is marked ``simulated_time``."""
    if request.node.get_closest_marker("simulated_time") and not request.node.get_closest_marker("real_time"):
        request.getfixturevalue("simulated_time")


@pytest.fixture(autouse=True)
def leaves_nothing_that_keeps_the_interpreter(time_of_the_test: None) -> Iterator[None]:
    """Check that no thread is left, because the interpreter joins threads before it exits and the run would hang."""
    before = set(threading.enumerate())
    yield
    until(lambda: all(thread.daemon for thread in set(threading.enumerate()) - before))


@pytest.fixture
def own_port() -> Iterator[int]:
    """Port for a server that stops and starts again; meanwhile it refuses connections and no other program gets it.

    A socket that is bound but does not listen reserves the port. The server can still listen there, because both
    sockets have SO_REUSEADDR.
    """
    with socket.socket() as keeper:
        keeper.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        keeper.bind(("127.0.0.1", 0))
        yield keeper.getsockname()[1]
