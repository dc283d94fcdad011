"""One program, `ur_rtde_program.py`, moves the arm in the same way with ur_rtde and with `urlink.compat`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from urlink.simulator import Controller, Still

pytest.importorskip("rtde_control", reason="ur_rtde is not installed; `nox -s interop` installs it where it can be had")

pytestmark = pytest.mark.real_time

#: ur_rtde always uses the standard ports, so each process of the tests has its own address.
PROGRAM = Path(__file__).with_name("ur_rtde_program.py")
HOST = f"127.30.1.{4 + int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])}"
#: Tolerances for values that are not computed exactly: the text of a path has four decimals, a servo approaches its
#: last set-point asymptotically, and a tool speed is produced by joint speeds.
WITHIN = {
    "a path": 1e-3,
    "moveJ_IK": 1e-6,
    "moveL": 1e-6,
    "moveL_FK": 1e-6,
    "servoJ": 1e-3,
    "servoL": 1e-3,
    "speedJ: speed": 1e-3,
    "speedL: speed": 1e-3,
    "jog: speed": 1e-3,
    "after stopJ: speed": 1e-6,
    "analogue": 1e-6,
}


def run(firmware: str, prefix: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run the program; return the values that it has read, and the final values of the controller."""
    with Controller(None, firmware, host=HOST, ports="standard", motion=Still()) as controller:
        done = subprocess.run(
            [sys.executable, str(PROGRAM), HOST, prefix, str(controller.firmware.rate)],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        replies = [line[3:] for line in done.stdout.splitlines() if line.startswith(">>>")]
        assert replies, done.stderr
        inputs = controller.registers.inputs
        kept = {
            "tcp": controller.arm.tcp,
            "payload": controller.arm.payload,
            "cog": controller.arm.payload_cog,
            "registers": [inputs.integers[18], inputs.floats[19]],
            "domains": controller.signals.analog_output_domains,
        }
        return json.loads(replies[0]), kept


# Each run takes 12 s, and several times as long on a busy computer.
@pytest.mark.timeout(300)
@pytest.mark.parametrize("firmware", ["3.15", "5.4", "5.11", "5.25"])
def test_program_with_compat_equals_ur_rtde(firmware: str) -> None:
    theirs, theirs_kept = run(firmware, "")
    ours, ours_kept = run(firmware, "urlink.compat.")
    assert ours.keys() == theirs.keys()
    differ = {}
    for name, value in theirs.items():
        if not np.allclose(ours[name], value, rtol=0, atol=WITHIN.get(name, 1e-9)):
            differ[name] = (value, ours[name])
    assert not differ
    for name, value in theirs_kept.items():
        assert np.allclose(ours_kept[name], value), name
