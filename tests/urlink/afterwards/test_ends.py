"""Effects of leaving a block, closing the robot and ending the process on each kind of motion; see `table.py`."""

from __future__ import annotations

import pytest

from linkcore.simulated import simulated_time
from tests.urlink.afterwards.interrupts import KINDS
from tests.urlink.afterwards.rigs import Simulated
from tests.urlink.afterwards.table import BRAKES, ROWS, cases, firmwares
from tests.urlink.afterwards.test_afterwards import LONGER, RESTS, begin

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")

#: Kinds in `interrupts.py` for rows with another name. Calls of the compatibility layers use these kinds internally.
INTERRUPTED = {
    "play": "Taught.play",
    "speed_short": "speed_joints, short",
    "speed_rtde": "speed_joints over RTDE",
    "follow_rtde": "follow over RTDE",
    "follow_low_bandwidth": "follow, low bandwidth",
    "stream_rtde": "stream over RTDE",
    "script": "script.run",
    "script_detached": "script.run",
    "urx": "move_joints",
    "ur_rtde": "move_joints",
    "ur_rtde_speed": "speed_joints",
}


@pytest.mark.matrix(9)
@pytest.mark.parametrize(("name", "how"), list(cases()))
def test_arm_behaves_as_listed_in_the_table_when_a_program_ends(name: str, how: str) -> None:
    row, firmware = ROWS[name], firmwares(name)[-1]
    with simulated_time(seed=1, limit=300.0) as sim:
        rig = Simulated(sim, firmware, name)
        if name in ("freedrive", "teach", "force_mode"):
            rig.ask("push", 1)
        begin(rig)
        rig.ask("mark")
        rig.write(how)
        watched = row.within + LONGER
        rig.ask("after", watched)
        lasted, rested = rig.ask("moved")
        if row.ends(how) == BRAKES:
            assert lasted < row.within
        else:
            assert lasted > watched - RESTS
            assert rested < RESTS


def test_every_interruptible_row_has_a_kind() -> None:
    missing = [
        name for name, row in ROWS.items() if row.lasts and row.interrupted and INTERRUPTED.get(name, name) not in KINDS
    ]
    assert not missing, f"add {missing} to KINDS in tests/urlink/afterwards/interrupts.py"
