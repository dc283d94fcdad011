"""Worlds in simulated time: 200 in these tests, and any number with `nox -f nightly.py -s simulate`."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from linkcore.errors import Cancelled
from linkcore.handle import Lifecycle
from tests.worlds.__main__ import shrunk
from tests.worlds.drawn import draw, written
from tests.worlds.planted import NAMES
from tests.worlds.running import run
from tests.worlds.scenes import SCENES
from tests.worlds.world import Ask, Client, Event, World
from urlink.command.programs import Programs

# A killed client does not close its sockets, so ignore the warnings.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")

#: Seeds of `written` that have shown a defect of the library, with a description.
OF_THE_LIBRARY = {
    15_114: "a connection for a setting outlived its robot",
    16_722: "cancelling the task of a motion stopped another motion",
    29_855: "close did not wait until the stop of a cancelled program was sent again",
    30_459: "a connection for a setting outlived its robot",
    31_502: "a stream that ended immediately after its start raised in its thread",
    58_908: "two motions shared one link",
    59_665: "a speed motion started without permission",
    59_800: "a cancelled program ran for 18 ms when it was played",
    66_459: "a handle never ended",
    127_182: "an unknown safety mode prevented close from sending a stop",
    170_528: "close left a thread",
}
#: Seeds that have shown a defect of the simulator or of an oracle, or an unrecorded defect.
OF_OTHERS = [1010, 1389, 2786, 5233, 6725, 10_052, 11_072, 26_852, 34_459, 65_347, 82_445]
OF_OTHERS += [103_700, 115_143, 120_411, 166_641, 171_407]
FAILED = [*OF_THE_LIBRARY, *OF_OTHERS]

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("seeds", [range(first, first + 10) for first in range(0, 200, 10)], ids=str)
def test_arm_moves_only_when_requested(seeds: range) -> None:
    for seed in seeds:
        outcome = run(draw(seed))
        assert outcome.faults == [], "\n".join([f"python -m tests.worlds --seed {seed}", *outcome.log])


@pytest.mark.parametrize("seed", [*FAILED, pytest.param(159_034, marks=pytest.mark.slow)])
def test_previously_failed_seed_passes(seed: int) -> None:
    outcome = run(written(seed))
    assert outcome.faults == [], "\n".join(outcome.log)


@pytest.mark.slow
@pytest.mark.real_time
def test_seed_gives_the_same_world_in_every_process() -> None:
    """The other process has other hashes and addresses, and these worlds are its first ones."""
    program = (
        "from tests.worlds.drawn import draw\nfrom tests.worlds.running import run\n"
        "print([run(draw(seed)).trace for seed in (3, 17)])"
    )
    env = {**os.environ, "PYTHONHASHSEED": "7"}
    there = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env=env, capture_output=True, text=True, check=True, timeout=55
    )
    assert there.stdout == f"{[run(draw(seed)).trace for seed in (3, 17)]}\n"


@pytest.mark.parametrize("name", sorted(SCENES.keys() - set(NAMES)))
def test_scene_that_once_failed_passes(name: str) -> None:
    for seed in range(3):
        outcome = run(replace(SCENES[name], seed=seed))
        assert outcome.faults == [], "\n".join(outcome.log)


@pytest.fixture
def forgets_to_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make `Programs` report a cancelled motion as ended without stopping it."""

    def stop(programs: Programs, life: Lifecycle) -> None:
        life.fail(Cancelled("planted"))

    monkeypatch.setattr(Programs, "stop", stop)


@pytest.mark.slow
@pytest.mark.usefixtures("forgets_to_stop")
def test_motion_after_its_end_is_found_and_shrunk() -> None:
    cancelled = Ask("move_joints", "cancel", after=0.0, size=1.0, patience=0.1)
    harmless = Ask("output", "wait", after=0.0, size=1.0, patience=0.0)
    clients = (Client((harmless, cancelled), 0.0), Client((harmless,), 0.0))
    events = (Event("slider", at=0.01, lasts=0.0, client=1, size=0.9),)
    world = World(1, "5.11", 1e-4, 0.0, clients, events)
    assert "whose handle ended" in run(world).faults[0]
    least = Ask("move_joints", "cancel", after=0.0, size=1.0, patience=0.0)
    assert shrunk(world) == World(1, "5.10", 1e-4, 0.0, (Client((least,), 0.0),), ())
