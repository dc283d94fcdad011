"""Defects of the past, put back one at a time, and the smallest world in which each shows.

A defect is a patch in `defects/`, applied to a copy of `src` in a temporary folder. Worlds run on this copy by
``PYTHONPATH``: ``python -m tests.worlds --planted NAME`` looks for the first seed that fails, and makes its world
smaller.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from .drawn import Ask, Client, Event, World

__all__ = ["NAMES", "SHOWN", "apply", "planted", "worlds"]

ROOT = Path(__file__).resolve().parents[2]
_PATCHES = Path(__file__).parent / "defects"
#: The names of the defects.
NAMES = tuple(sorted(path.stem for path in _PATCHES.glob("*.patch")))


def _ask(
    what: str,
    then: str = "wait",
    *,
    after: float = 0.0,
    size: float = 1.0,
    patience: float = 0.0,
    thread: int = 0,
    at: float = 0.0,
) -> Ask:
    return Ask(what, then, after, size, patience, thread, at)


def _world(*clients: Client, events: tuple[Event, ...] = (), latency: float = 1e-4, lines: float = 0.0) -> World:
    return World(0, "5.11", latency, 0.0, clients, events, lines)


#: A small world that shows the defect, and with how many seeds in place of its own it is tried: which thread goes first
#: is the seed's.
SHOWN: Mapping[str, tuple[World, int]] = {
    # The program's text is lost on the way and sent again, when a stop has come and is over.
    "held-program-goes-on": (
        _world(
            Client((_ask("speed_joints", size=0.1), _ask("script", after=0.2)), 0.0),
            events=(Event("mute", 0.0, 0.5, 0, 1.0, 1), Event("protective_stop", 0.05, 0.2, 0, 1.0, 1)),
        ),
        3,
    ),
    # The block is left in the moment in which a state is answered.
    "word-after-the-last": (_world(Client((_ask("jog", "leave", size=0.6),), 0.0)), 40),
    "up-before-its-ports": (
        _world(
            Client((_ask("wait_state", after=0.5, patience=1.0),), 0.0), events=(Event("reboot", 0.01, 0.3, 0, 1.0),)
        ),
        3,
    ),
    "speed-outlives-its-program": (
        _world(Client((_ask("speed_held"),), 0.0), events=(Event("kill_client", 0.02, 0.3, 0, 1.0, 0),)),
        3,
    ),
    # The task is cancelled between two turns of the loop, while a thread prepares the motion.
    "cancelled-task-moves-the-arm": (
        _world(Client((_ask("move_joints", "cancel", size=0.5),), 0.0, "asyncio")),
        20,
    ),
    "cancel-brakes-not": (_world(Client((_ask("move_joints", "cancel", size=0.9, patience=0.1),), 0.0)), 3),
    "interlock-forgets-the-stop": (
        _world(
            Client((_ask("wait_state", after=0.1), _ask("move_joints", after=0.2)), 0.0),
            events=(Event("protective_stop", 0.0, 0.5, 0, 1.0, 0),),
        ),
        3,
    ),
    # The program of the second client has begun when the permission of the first one's comes.
    "one-permission-for-all": (
        _world(
            Client((_ask("move_joints", size=0.4, at=0.2),), 0.0),
            Client((_ask("move_joints", size=0.3, at=0.2, after=0.008),), 0.0),
            latency=5e-3,
        ),
        3,
    ),
    # Both are the first to command, before the first state has come.
    "first-word-of-two-threads": (
        _world(Client((_ask("output", size=0.4), _ask("output", size=0.4, thread=1)), 0.0)),
        3,
    ),
    # Both have slept longer than a state may be old, and wait for news.
    "stop-after-the-next": (
        _world(
            Client(
                (
                    _ask("move_joints", "cancel", size=0.4, patience=0.5, at=0.2),
                    _ask("move_joints", size=0.3, thread=1, at=0.9),
                ),
                0.0,
            ),
            events=(Event("hold_client", 0.3, 1.3, 0, 1.0),),
        ),
        40,
    ),
    # One of them makes way after it has looked, and before it sets.
    "two-connections-claim-the-same": (
        _world(
            Client((_ask("registers", size=0.4, at=0.1), _ask("registers", size=0.4, thread=1, at=0.1)), 0.0),
            lines=0.3,
        ),
        100,
    ),
}


@contextlib.contextmanager
def planted(name: str | None) -> Iterator[Path]:
    """A folder with `src` in which that defect is; without a name, `src` as it is.

    Raises:
        CalledProcessError: the patch does not apply any more.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        # With what is compiled, or each run would compile it all anew.
        shutil.copytree(ROOT / "src", root / "src")
        if name is not None:
            apply(name, root)
        yield root


def apply(name: str, root: Path, *options: str) -> None:
    """Apply a patch to the `src` in that folder, with options of ``git apply``.

    Raises:
        CalledProcessError: it does not apply any more.
    """
    subprocess.run(
        ["git", "apply", "--whitespace=nowarn", *options, str(_PATCHES / f"{name}.patch")],
        cwd=root,
        check=True,
        env={**os.environ, "GIT_CEILING_DIRECTORIES": str(root.parent)},
    )


def worlds(root: Path, arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """``python -m tests.worlds`` with the code of that folder, and what it prints."""
    env = {**os.environ, "PYTHONPATH": str(root / "src")}
    return subprocess.run(
        [sys.executable, "-m", "tests.worlds", *arguments], cwd=ROOT, env=env, text=True, stdout=subprocess.PIPE
    )
