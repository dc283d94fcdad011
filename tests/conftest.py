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

# Few by default, so that the suite stays quick; `nox -f nightly.py -s fuzz` tries many.
settings.register_profile("default", deadline=None, derandomize=False, max_examples=10)
# A gate gives the same verdict on the same tree; `fuzz` and every run at home look for what is new.
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=10, print_blob=True)
settings.register_profile("fuzz", deadline=None, derandomize=False, max_examples=2000, print_blob=True)
# What fails ends the run of a mutant, so nothing is made smaller or remembered.
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
    """Let Ctrl-C end what tests start: a shell that begins the run in the background has all of it ignore SIGINT."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish() -> None:
    """Hundreds of tests collect garbage, so that a socket which nobody closed warns in the test that opened it."""
    # Imported for the first time on a computer, it makes a list of the fonts there, by a process and a thread.
    with contextlib.suppress(ImportError):
        importlib.import_module("matplotlib.font_manager")
    leave_to_stay()


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> None:
    """After each module of tests, whose own fixtures are gone by now."""
    if nextitem is None or nextitem.path != item.path:
        leave_to_stay()


def leave_to_stay() -> None:
    """Leave what there is now out of every later garbage collection.

    The collection of tests makes half a million objects, and modules keep what they have once imported, parsed or
    computed. All of it stays to the end; each collection would spend some 0.1 s on looking through it.
    """
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    real_captures.require(item)


@pytest.fixture
def captures() -> Path:
    """The folder of packets of real controllers, for a test marked ``captures("ur")``."""
    return real_captures.folder("ur")


@pytest.fixture(autouse=True)
def time_of_the_test(request: pytest.FixtureRequest) -> None:
    """Simulated, for the test and all of its own fixtures, where it or its module is marked ``simulated_time``."""
    if request.node.get_closest_marker("simulated_time") and not request.node.get_closest_marker("real_time"):
        request.getfixturevalue("simulated_time")


@pytest.fixture(autouse=True)
def leaves_nothing_that_keeps_the_interpreter(time_of_the_test: None) -> Iterator[None]:
    """The interpreter joins threads before it exits, so one that a test leaves behind would hang the run at its end."""
    before = set(threading.enumerate())
    yield
    until(lambda: all(thread.daemon for thread in set(threading.enumerate()) - before))


@pytest.fixture
def own_port() -> Iterator[int]:
    """A port for what stops and starts again: meanwhile no other program gets it, and connections to it are refused.

    A socket that is bound and does not listen keeps it. As both have SO_REUSEADDR, another one can listen there.
    """
    with socket.socket() as keeper:
        keeper.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        keeper.bind(("127.0.0.1", 0))
        yield keeper.getsockname()[1]
