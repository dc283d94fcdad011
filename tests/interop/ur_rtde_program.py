"""Typical program for ur_rtde, which runs once with ur_rtde and once with `urlink.compat`.

    python ur_rtde_program.py HOST PREFIX RATE

Prints one JSON object with the target position or the answer of each step. Like programs in the field, it runs a servo
loop paced by `initPeriod` and `waitPeriod`, and reads values with another interface.
"""

from __future__ import annotations

import json
import sys
import time
from importlib import import_module
from typing import Any

NEAR = [0.1, -1.4, 1.3, -1.5, -1.5, 0.2]
THERE = [0.3, -1.3, 1.2, -1.4, -1.4, 0.4]
TOOL = [0.0, 0.01, 0.15, 0.1, 0.0, 0.2]


def main(host: str, prefix: str, rate: str) -> dict[str, Any]:
    if prefix:
        # ur_rtde has no time limit for set-points. Raise the limit of urlink, because a busy computer may delay them.
        import_module(f"{prefix}control_blocks")._WATCHDOG = 10.0  # type: ignore[attr-defined]
    control = import_module(f"{prefix}rtde_control").RTDEControlInterface(host)
    receive = import_module(f"{prefix}rtde_receive").RTDEReceiveInterface(host)
    io = import_module(f"{prefix}rtde_io").RTDEIOInterface(host)
    period = 1.0 / float(rate)
    seen: dict[str, Any] = {}

    def note(name: str, read: Any = receive.getTargetQ) -> None:
        time.sleep(0.1)  # the values arrive on another connection
        seen[name] = read()

    assert control.moveJ(NEAR, 2.0, 4.0)
    note("moveJ")
    pose = receive.getTargetTCPPose()
    beside = [pose[0], pose[1] + 0.05, pose[2] - 0.05, *pose[3:]]
    assert control.moveL(beside, 0.5, 2.0)
    note("moveL", receive.getTargetTCPPose)
    assert control.moveJ_IK(pose, 2.0, 4.0)
    note("moveJ_IK")
    assert control.moveL_FK(THERE, 0.5, 2.0)
    note("moveL_FK")
    assert control.moveJ([[*NEAR, 2.0, 4.0, 0.01], [*THERE, 2.0, 4.0, 0.0]])
    note("a path")

    # Two servo loops, which stay at their end for a while.
    q = receive.getTargetQ()
    for cycle in range(225):
        begun = control.initPeriod()
        if cycle < 75:
            q[5] += 0.3 * period
        assert control.servoJ(q, 0.5, 0.5, period, 0.1, 300)
        control.waitPeriod(begun)
    note("servoJ")
    assert control.servoStop()
    pose = receive.getTargetTCPPose()
    for cycle in range(225):
        begun = control.initPeriod()
        if cycle < 75:
            pose[2] += 0.05 * period
        assert control.servoL(pose, 0.5, 0.5, period, 0.1, 300)
        control.waitPeriod(begun)
    note("servoL", receive.getTargetTCPPose)
    assert control.servoStop()

    # A speed that is sent repeatedly, as in the examples of ur_rtde, and speeds that are sent once until a stop.
    for _ in range(int(1.5 * float(rate))):
        begun = control.initPeriod()
        assert control.speedJ([0.0, 0.0, 0.0, 0.0, 0.0, 0.2], 2.0, period)
        control.waitPeriod(begun)
    seen["speedJ: speed"] = receive.getTargetQd()
    assert control.speedStop()
    assert control.moveJ(THERE, 2.0, 4.0)
    assert control.speedL([0.0, 0.0, 0.04, 0.0, 0.0, 0.0], 0.5)
    time.sleep(0.2)
    note("speedL: speed", receive.getTargetTCPSpeed)
    assert control.speedStop()
    assert control.jogStart([0.0, 0.0, -0.04, 0.0, 0.0, 0.0], 0, 0.5)
    time.sleep(0.2)
    note("jog: speed", receive.getTargetTCPSpeed)
    assert control.jogStop()

    assert control.moveJ(NEAR, 2.0, 4.0)
    assert control.moveJ(THERE, 0.2, 1.0, True)
    time.sleep(0.2)
    seen["asynchronous"] = control.getAsyncOperationProgress()
    control.stopJ(4.0)
    note("after stopJ: speed", receive.getTargetQd)
    seen["is over"] = control.getAsyncOperationProgress() < 0
    assert control.moveJ(NEAR, 2.0, 4.0)

    assert control.setTcp(TOOL)
    assert control.setPayload(0.5, [0.0, 0.0, 0.05])
    time.sleep(0.3)
    seen["offset"] = control.getTCPOffset()
    seen["forward"] = control.getForwardKinematics(THERE, TOOL)
    seen["inverse"] = control.getInverseKinematics(seen["forward"], NEAR)
    seen["limits"] = [control.isPoseWithinSafetyLimits(seen["forward"]), control.isJointsWithinSafetyLimits(NEAR)]
    seen["composed"] = control.poseTrans(seen["forward"], TOOL)
    seen["steady"] = control.isSteady()
    seen["runs"] = control.isProgramRunning()

    for number, on in ((3, True), (4, True), (3, False)):
        assert io.setStandardDigitalOut(number, on)
    assert io.setConfigurableDigitalOut(1, True)
    assert io.setToolDigitalOut(1, True)
    assert io.setSpeedSlider(0.75)
    assert io.setAnalogOutputVoltage(1, 0.5)
    assert io.setInputIntRegister(18, 5)
    assert io.setInputDoubleRegister(19, 0.25)
    note("outputs", receive.getActualDigitalOutputBits)
    seen["slider"] = receive.getTargetSpeedFraction()
    seen["analogue"] = receive.getStandardAnalogOutput1()
    seen["states"] = [receive.getRobotMode(), receive.getSafetyMode(), receive.isProtectiveStopped()]
    control.stopScript()
    for interface in (control, receive, io):
        interface.disconnect()
    return seen


if __name__ == "__main__":
    # ur_rtde writes its own messages to the standard output, so mark the result.
    print(">>>" + json.dumps(main(*sys.argv[1:])), flush=True)
