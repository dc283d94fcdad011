"""Programs with the constructs of public programs must compile, and run to their end or until they wait."""

from __future__ import annotations

import pytest

from tests.fakes.world import NotedWorld
from tests.urlink.simulator.urscript.corpus import programs
from urlink.protocol.firmware import Firmware
from urlink.simulator.urscript import Execution, compile_script

PROGRAMS = dict(programs())
#: Number of cycles after which a running program must be waiting for the outside: no program here computes for longer.
CYCLES = 40


@pytest.mark.parametrize("version", ["3.15", "5.11", "10.12"])
def test_every_corpus_program_compiles_and_runs(version: str) -> None:
    firmware = Firmware.parse(version)
    count = 0
    for name, text in PROGRAMS.items():
        if "e-Series" in name and not firmware.is_e_series:
            continue
        script = compile_script(text, firmware)
        count += 1
        # The programs run in the same way on all firmware; only compiling differs.
        if version == "5.11":
            world = NotedWorld(version)
            execution = Execution(script, world)
            for _ in range(CYCLES):
                execution.advance()
                world.cycle += 1
                world.sockets.step()
            assert execution.error is None, f"{name}: {execution.error}\n{text}"
            execution.stop()
    assert count >= 140
