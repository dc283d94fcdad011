"""Effects on each kind of motion and call when something fails; `table.py` has the table.

The cells are tried in simulated time. `nox -f nightly.py -s fuzz` tries all of them, and observes continuing motions to
their end on the first firmware that supports them. One cell of each column is also tried in real time, in separate
processes.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from functools import cache

import pytest

from linkcore.simulated import simulated_time
from tests import platforms
from tests.matrix import IS_WHOLE
from tests.urlink.afterwards.rigs import TIMEOUT, Processes, Rig, Simulated
from tests.urlink.afterwards.table import (
    BACK,
    CALLED,
    COLUMNS,
    GOES_ON,
    LATE,
    NOT,
    ROWS,
    cells,
    firmwares,
    pages,
)

# A killed client does not close its sockets, so ignore the warnings.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")

#: Time for which a motion is observed after the time limit for braking, in s of the robot's time.
LONGER = 0.5
#: Longest rest of a continuing motion, for example at the corner of a path, in s.
RESTS = 0.1
#: Largest movement of an undone call, in rad and in counts of the gripper.
BEGUN = 0.1, 60


# -- events ---------------------------------------------------------------------------------------------------------


def cut(rig: Rig) -> None:
    rig.ask("cut")


def silence(rig: Rig) -> None:
    rig.network("down")
    rig.ask("after", 2.5)
    rig.network("up")


def suspended_controller(rig: Rig) -> None:
    rig.suspend("controller")
    time.sleep(rig.hold)  # until the client has aborted the connection
    rig.resume("controller")


def suspended_client(rig: Rig) -> None:
    rig.suspend("client")


def killed_client(rig: Rig) -> None:
    rig.kill("client")


def reboot(rig: Rig) -> None:
    rig.ask("reboot")


EVENTS = dict(zip(COLUMNS, (cut, silence, suspended_controller, suspended_client, killed_client, reboot), strict=False))


# -- the table ------------------------------------------------------------------------------------------------------


def test_pages_contain_the_current_tables() -> None:
    for path, text in pages().items():
        assert path.read_text(encoding="utf-8") == text, f"run python -m tests.urlink.afterwards.table to write {path}"


def tried() -> list[tuple[str, str, str]]:
    """Return all cells in the profile `fuzz`; otherwise each row with each column once.

    Most of these cells use the first firmware, because its cycles are the longest. If the effect differs on another
    firmware, the cell is included for that firmware, too.
    """
    whole = list(cells())
    if IS_WHOLE:
        return whole
    having: dict[tuple[str, str], list[tuple[str, str, str]]] = {}
    for cell in whole:
        having.setdefault(cell[1:], []).append(cell)
    chosen = [each[number // 8 % len(each) if number % 8 == 0 else 0] for number, each in enumerate(having.values())]
    else_there = [
        cell
        for cell in whole
        if ROWS[cell[1]].becomes(cell[2], cell[0]) != ROWS[cell[1]].becomes(cell[2], having[cell[1:]][0][0])
    ]
    return list(dict.fromkeys([*chosen, *else_there]))


def one_of_each_column() -> list[tuple[str, str, str]]:
    columns = [[each for each in cells() if each[2] == column] for column in COLUMNS]
    return [column[(7 * number + 5) % len(column)] for number, column in enumerate(columns)]


@pytest.mark.matrix(9)
@pytest.mark.parametrize(("firmware", "name", "column"), tried())
def test_motion_ends_or_continues_as_listed_in_the_table(firmware: str, name: str, column: str) -> None:
    is_watched = IS_WHOLE and ROWS[name].becomes(column, firmware) == GOES_ON and firmware == firmwares(name)[0]
    end = undisturbed(firmware, name) if is_watched else None
    with simulated_time(seed=1, limit=300.0) as sim:
        rig = Simulated(sim, firmware, name)
        what_becomes_of_it(rig, firmware, name, column)
        if end is not None:
            assert rig.ask("end") == end


@cache
def undisturbed(firmware: str, name: str) -> list[float]:
    """Return the final joint positions when nothing fails."""
    with simulated_time(seed=1, limit=300.0) as sim:
        rig = Simulated(sim, firmware, name)
        begin(rig)
        return rig.ask("end")  # type: ignore[no-any-return]


@pytest.mark.slow
@pytest.mark.timeout(120)
@platforms.needs_signals
@pytest.mark.parametrize(("firmware", "name", "column"), one_of_each_column())
@pytest.mark.real_time
def test_motion_of_real_processes_ends_or_continues_as_listed(
    rig: Callable[..., Processes], firmware: str, name: str, column: str
) -> None:
    is_alone = column == "silence"
    if is_alone and (os.geteuid() != 0 or not all(map(shutil.which, ("unshare", "nsenter", "ip")))):
        pytest.skip(platforms.NETWORKS)
    what_becomes_of_it(rig(firmware, name, is_alone=is_alone), firmware, name, column)


@pytest.fixture
def rig(request: pytest.FixtureRequest) -> Callable[..., Processes]:
    def make(firmware: str, name: str, *, is_alone: bool) -> Processes:
        made = Processes(firmware, name, is_alone=is_alone)
        request.addfinalizer(made.close)
        return made

    return make


def what_becomes_of_it(rig: Rig, firmware: str, name: str, column: str) -> None:
    row = ROWS[name]
    if name in ("freedrive", "teach", "force_mode"):
        rig.ask("push", 1)
    expected = row.becomes(column, firmware)
    if column == CALLED:
        called_meanwhile(rig, expected, is_answered=name == "send_line")
        return
    begin(rig)
    rig.ask("mark")
    EVENTS[column](rig)
    # A resumed process reads the data that its kernel has received, and a short speed motion asks for no permission.
    is_late = isinstance(rig, Processes) and (name, column) == ("speed_short", "suspended controller")
    within = row.within + rig.hold * is_late
    watched = within + LONGER
    rig.ask("after", watched)
    lasted, rested = rig.ask("moved")
    if expected == GOES_ON:
        assert lasted > watched - RESTS
        assert rested < RESTS
    else:
        assert lasted < within


def begin(rig: Rig) -> None:
    """Make the client call, and return some cycles after the arm has started to move."""
    rig.write("go")
    assert rig.read() == "made"
    deadline = time.monotonic() + TIMEOUT
    while not rig.ask("moves"):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    rig.ask("after", 0.3)


def called_meanwhile(rig: Rig, expected: str, *, is_answered: bool) -> None:
    q, fingers, mode, outputs = rig.ask("state")
    rig.ask("mark")
    rig.suspend("controller")
    try:
        rig.write("wait")
        failed = rig.read()
        time.sleep(rig.hold)
    finally:
        rig.resume("controller")
    rig.ask("after", 2.0)
    now, position, later, switched = rig.ask("state")
    way = max(abs(a - b) for a, b in zip(now, q, strict=True))
    is_same = (later, switched) == (mode, outputs)
    if expected == NOT:
        assert (rig.ask("moved"), way, position) == ((0.0, 0.0), pytest.approx(0.0, abs=1e-6), fingers)
        assert is_same
    elif expected == BACK:
        assert "might still be executed" in failed
        assert is_same
        assert way < BEGUN[0]
        assert position - fingers < BEGUN[1]
        assert not rig.ask("moves")
    else:
        assert expected == LATE
        assert not is_same or rig.ask("moves")
        assert failed == "made" if is_answered else "might still" in failed
