"""Draw stops by seed on simulated controllers, and count how often the right cause is found first.

    python -m tests.urlink.command.stops_drawn --runs 200 --seed 45

Each run draws a cause, an arm, a posture, a motion and the time of the disturbance. The diagnosis reads only the bytes
that the controller sends: real-time packets, and messages of the primary interface. With `--without-codes`, it reads no
messages, like a log of the real-time interface or of RTDE.
"""

from __future__ import annotations

import argparse
import collections
import math
import random
import sys
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from linkcore.errors import LinkError
from linkcore.streaming.flight_record import Received
from urlink.arm.kinematics import Arm
from urlink.arm.models import Model, model
from urlink.diagnosis.stop_causes import explain
from urlink.diagnosis.stop_record import StopRecord, columns_of, messages_of, packets_in
from urlink.errors.stop_explanation import StopExplanation
from urlink.packets import RealtimeState
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.realtime.protocol import RealtimeProtocol
from urlink.simulator import Controller, Plane, Still

FIRMWARES = ("3.15", "5.11", "10.12")
_ARMS = {"3.15": ("UR3", "UR5", "UR10"), "5.11": ("UR3e", "UR5e", "UR10e"), "10.12": ("UR5e", "UR10e", "UR16e")}
#: Time after the disturbance in which the stop must happen, in s, and time that is recorded after the stop.
_WITHIN, _AFTER = 8.0, 0.7


class Drawn(NamedTuple):
    """One drawn stop, and what the diagnosis found.

    Attributes:
        cause: Cause that was drawn.
        firmware: Firmware of the controller.
        found: Explanation; None if none was found.
        record: Data from which it was found.
    """

    cause: str
    firmware: str
    found: StopExplanation | None
    record: StopRecord

    @property
    def is_right(self) -> bool:
        """Whether the cause that was drawn is the first one that was found."""
        return self.found is not None and self.found.cause.name == self.cause

    def without_codes(self) -> Drawn:
        """Return the same stop with the diagnosis of a record without messages of the primary interface."""
        record = StopRecord(self.record.time, self.record.columns, model=self.record.model)
        found = explain(record)
        return Drawn(self.cause, self.firmware, found[0] if found else None, record)


class Scene:
    """One simulated controller, stepped cycle by cycle, with the bytes that it has sent."""

    def __init__(self, chance: random.Random, firmware: str) -> None:
        self.chance = chance
        self.model: Model = model(chance.choice(_ARMS[firmware]))
        self.arm = Arm(self.model)
        self.firmware = firmware
        self.fast: list[Received] = []
        self.slow: list[Received] = []
        self.own = "drawn_program"
        self.controller: Controller | None = None

    def posture(self) -> list[float]:
        """Return a posture that is neither stretched nor singular."""
        while True:
            draw = self.chance.uniform
            q = [draw(-2, 2), draw(-2.0, -1.0), draw(1.0, 2.2), draw(-2.2, -0.8), draw(0.8, 2.2), draw(-2, 2)]
            if self.distance(q) > 0.15 and self.arm.forward(q)[2] > 0.1:
                return q

    def distance(self, q: list[float]) -> float:
        """Return the distance from a singularity: the least singular value of the Jacobian, for an arm of 1 m."""
        return float(np.linalg.svd(self.arm.jacobian(q), compute_uv=False)[-1]) / self.model.reach

    def begin(self, q: list[float], text: str) -> Controller:
        """Start the controller at a posture, with a program of this client; return the controller."""
        self.controller = controller = Controller(
            self.model.name, self.firmware, motion=Still(q), seed=self.chance.randrange(1000)
        )
        for message in controller.greeting("primary"):
            self.slow.append(Received(0.0, message))
        self.step(round(0.3 * controller.firmware.rate))
        lines = "\n".join(f"  {line}" for line in text.splitlines())
        controller.take(f"def {self.own}():\n{lines}\nend\n")
        return controller

    def step(self, cycles: int) -> None:
        """Advance, and record the sent bytes."""
        controller = self.controller
        assert controller is not None
        for _ in range(cycles):
            controller.step()
            self.fast.append(Received(controller.time, controller.realtime_packet()))
            for message in controller.take_messages():
                self.slow.append(Received(controller.time, message))

    def wait(self, seconds: float) -> None:
        """Advance by a time in s."""
        assert self.controller is not None
        self.step(max(round(seconds * self.controller.firmware.rate), 1))

    def wait_for_stop(self) -> bool:
        """Advance until the arm is stopped; return False if it is not stopped in time."""
        controller = self.controller
        assert controller is not None
        for _ in range(round(_WITHIN * controller.firmware.rate)):
            self.step(1)
            if controller.stopped_since is not None:
                self.wait(_AFTER)
                return True
        return False

    def record(self, *, has_codes: bool) -> StopRecord:
        """Return the record that a live robot would have."""
        states = [each for each in packets_in(self.fast, RealtimeProtocol) if isinstance(each, RealtimeState)]
        time, columns = columns_of(states)
        reports, keys = messages_of(packets_in(self.slow, PrimaryProtocol))
        own = self.own
        if not has_codes:
            return StopRecord(time, columns, model=self.model)
        return StopRecord(time, columns, reports, keys, is_own=lambda name: name == own, model=self.model)


def _list(values: object) -> str:
    return "[" + ", ".join(f"{float(value):.6f}" for value in values) + "]"  # type: ignore[attr-defined]


def _moving(scene: Scene) -> None:
    """Begin a long motion between postures that are close to each other, and let it run for a while."""
    draw = scene.chance.uniform
    q = scene.posture()
    other = [a + draw(-0.5, 0.5) for a in q]
    a, v = draw(0.8, 3.0), draw(0.4, 1.2)
    if scene.chance.random() < 0.5:
        there, back = (f"movej({_list(each)}, a={a:.3f}, v={v:.3f})" for each in (other, q))
    else:
        up = scene.arm.forward(q).copy()
        up[2] += draw(0.03, 0.1)
        there, back = (f"movel(p{_list(each)}, a=0.5, v=0.1)" for each in (up, scene.arm.forward(q)))
    body = f"while True:\n  {there}\n  {back}\nend"
    scene.begin(q, body)
    scene.wait(draw(0.5, 2.0))


def joint_speed(scene: Scene) -> bool:
    draw, q = scene.chance.uniform, scene.posture()
    joint = scene.chance.randrange(6)
    limit = float(scene.model.max_speed[joint])
    sign = scene.chance.choice((-1, 1))
    qd = [0.0] * 6
    qd[joint] = sign * limit * draw(1.06, 1.6)
    acceleration = draw(3.0, 10.0)
    if joint in (1, 2) and limit**2 / acceleration > 1.6:  # would reach the end of the workspace before its speed
        acceleration = limit**2 / 1.6
        qd[joint] = (1.0 if joint == 2 else -1.0) * abs(qd[joint]) * (-1 if joint == 1 and q[1] < -1.5 else 1)
    scene.begin(q, f"speedj({_list(qd)}, {acceleration:.3f}, 5.0)")
    return scene.wait_for_stop()


def sudden_change(scene: Scene) -> bool:
    draw, q = scene.chance.uniform, scene.posture()
    joint, jump = scene.chance.randrange(6), draw(0.6, 1.5) * scene.chance.choice((-1, 1))
    far = list(q)
    far[joint] += jump
    rate = 500 if not scene.firmware.startswith("3") else 125
    count = scene.chance.randrange(rate // 2, 2 * rate)
    amplitude, omega = draw(0.02, 0.1), draw(1.0, 4.0)
    body = f"""i = 0
while i < {count}:
  q = {_list(q)}
  q[{joint}] = q[{joint}] + {amplitude:.4f}*sin({omega:.3f}*i/{rate})
  servoj(q, t={1.0 / rate}, lookahead_time=0.05, gain=300)
  i = i + 1
end
servoj({_list(far)}, t={1.0 / rate}, lookahead_time=0.05, gain=300)
sync()"""
    scene.begin(q, body)
    return scene.wait_for_stop()


def position_deviation(scene: Scene) -> bool:
    draw, q = scene.chance.uniform, scene.posture()
    joint = scene.chance.randrange(6)
    other = list(q)
    other[joint] += draw(0.5, 0.9) * scene.chance.choice((-1, 1))
    a, v = draw(0.8, 3.0), draw(0.4, 1.2)
    controller = scene.begin(
        q, f"while True:\n  movej({_list(other)}, a={a:.3f}, v={v:.3f})\n  movej({_list(q)}, a={a:.3f}, v={v:.3f})\nend"
    )
    scene.wait(draw(0.5, 2.0))
    controller.faults.drag(joint, draw(0.3, 1.0))
    return scene.wait_for_stop()


def contact(scene: Scene) -> bool:
    draw, q = scene.chance.uniform, scene.posture()
    start = scene.arm.forward(q)
    way = np.array([draw(-1, 1), draw(-1, 1), draw(-1, 0.2)])
    way *= draw(0.12, 0.2) / np.linalg.norm(way)
    end = start.copy()
    end[:3] += way
    place = start[:3] + way * draw(0.3, 0.7)
    controller = scene.begin(q, f"movel(p{_list(end)}, a={draw(0.3, 1.2):.3f}, v={draw(0.05, 0.25):.3f})")
    controller.world.add(Plane(place.tolist(), (-way).tolist(), stiffness=10 ** draw(4.0, 5.0)))
    return scene.wait_for_stop()


def singularity(scene: Scene) -> bool:
    draw = scene.chance.uniform
    near = scene.posture()
    if scene.chance.random() < 0.6:
        near[4] = draw(0.004, 0.03) * scene.chance.choice((-1, 1))
    else:  # above the shoulder: the centre of the wrist is on the axis of the base
        a2, a3, d5 = (float(each) for each in (scene.model.dh_a[1], scene.model.dh_a[2], scene.model.dh_d[4]))
        near[2] = draw(1.2, 2.0)
        near[3] = draw(-2.2, -1.0)
        shoulder = np.linspace(-3.0, 0.0, 3001)
        along = a2 * np.cos(shoulder) + a3 * np.cos(shoulder + near[2]) + d5 * np.sin(shoulder + near[2] + near[3])
        near[1] = float(shoulder[np.argmin(np.abs(along - draw(0.002, 0.01)))])
    pose = scene.arm.forward(near)
    # In this direction, the joints have to move fastest.
    u, _, _ = np.linalg.svd(scene.arm.jacobian(near))
    way = u[:3, -1] / max(float(np.linalg.norm(u[:3, -1])), 1e-9) * draw(0.1, 0.2)
    begin, end = pose.copy(), pose.copy()
    begin[:3] -= way
    end[:3] += way
    try:
        q = scene.arm.inverse(begin, near).tolist()
    except LinkError:
        begin, end = end, begin
        q = scene.arm.inverse(begin, near).tolist()
    if scene.distance(q) < 0.06:
        return False
    scene.begin(q, f"movel(p{_list(end)}, a=1.0, v={draw(0.15, 0.4):.3f})")
    return scene.wait_for_stop()


def reach(scene: Scene) -> bool:
    draw, q = scene.chance.uniform, scene.posture()
    if scene.chance.random() < 0.25:
        joint = scene.chance.choice((0, 3)) if scene.model.name != "UR3e" else 0
        sign = scene.chance.choice((-1, 1))
        q[joint] = sign * draw(5.6, 6.0)
        qd = [0.0] * 6
        qd[joint] = sign * draw(0.2, 0.8)
        scene.begin(q, f"speedj({_list(qd)}, 1.0, 5.0)")
        return scene.wait_for_stop()
    pose = scene.arm.forward(q)
    out = np.array([math.cos(q[0]), math.sin(q[0]), 0.0]) * float(
        np.sign(pose[0] * math.cos(q[0]) + pose[1] * math.sin(q[0]))
    )
    out[2] = draw(-0.2, 0.5)
    if scene.chance.random() < 0.5:
        end = pose.copy()
        end[:3] += 1.5 * out / np.linalg.norm(out)
        text = f"movel(p{_list(end)}, a=0.8, v={draw(0.1, 0.3):.3f})"
    else:
        speed = draw(0.08, 0.25) * out / np.linalg.norm(out)
        text = f"speedl({_list([*speed, 0, 0, 0])}, 0.5, 20.0)"
    scene.begin(q, text)
    return scene.wait_for_stop()


def wrong_payload(scene: Scene) -> bool:
    draw, q = scene.chance.uniform, scene.posture()
    known = draw(0.0, 0.3) * scene.model.payload
    if scene.chance.random() < 0.4:
        controller = scene.begin(
            q, f"set_payload({known:.3f}, [0, 0, 0.05])\nsleep({draw(1.0, 2.0):.3f})\nfreedrive_mode()\nsleep(5)"
        )
        controller.world.carry(known + draw(4.3, 7.0), (0.0, 0.0, draw(0.02, 0.08)))
        scene.wait(0.9)
        return controller.stopped_since is None and scene.wait_for_stop()
    # The arm moves away from its base, until the weight needs too much torque.
    q[1], q[2], q[3] = draw(-1.9, -1.6), draw(1.9, 2.2), draw(-2.0, -1.6)
    other = [q[0], draw(-0.8, -0.5), draw(0.6, 0.9), q[3], q[4], q[5]]
    far = float(np.hypot(*scene.arm.forward(other)[:2]))
    mass = draw(1.15, 1.5) * 0.25 * float(scene.model.max_torque[1]) / (9.82 * far)
    controller = scene.begin(
        q,
        f"set_payload({known:.3f}, [0, 0, 0.05])\nsleep({draw(1.6, 2.2):.3f})\n"
        f"movej({_list(other)}, a=0.8, v={draw(0.2, 0.6):.3f})\nsleep(5)",
    )
    controller.world.carry(known + mass, (0.0, 0.0, draw(0.02, 0.08)))
    scene.wait(1.6)
    return controller.stopped_since is None and scene.wait_for_stop()


def safeguard(scene: Scene) -> bool:
    _moving(scene)
    assert scene.controller is not None
    scene.controller.faults.safeguard_stop()
    return scene.wait_for_stop()


def emergency(scene: Scene) -> bool:
    _moving(scene)
    assert scene.controller is not None
    scene.controller.faults.emergency_stop()
    return scene.wait_for_stop()


def another_client(scene: Scene) -> bool:
    _moving(scene)
    assert scene.controller is not None
    kind = scene.chance.randrange(3)
    if kind == 0:
        scene.controller.take("def of_another_client():\n  movej([0, -1.5, 1.5, -1.5, -1.5, 0], a=0.5, v=0.3)\nend\n")
    elif kind == 1:
        scene.controller.take("stop program\n")
    else:
        scene.controller.take("def of_another_client():\n  sleep(0.2)\n  protective_stop()\nend\n")
    scene.wait(1.5)
    return True


CAUSES: dict[str, Callable[[Scene], bool]] = {
    "joint speed": joint_speed,
    "sudden change of target": sudden_change,
    "position deviation": position_deviation,
    "contact": contact,
    "singularity": singularity,
    "reach": reach,
    "wrong payload": wrong_payload,
    "safeguard": safeguard,
    "emergency": emergency,
    "another client": another_client,
}


def draw(runs: int, seed: int, *, has_codes: bool = True) -> Iterator[Drawn]:
    """Draw stops, and yield each with its diagnosis. Each cause and each firmware gets the same number of stops."""
    chance = random.Random(seed)
    names = list(CAUSES)
    for number in range(runs):
        cause, firmware = names[number % len(names)], FIRMWARES[(number // len(names)) % len(FIRMWARES)]
        while True:
            scene = Scene(random.Random(chance.random()), firmware)
            try:
                if CAUSES[cause](scene):
                    break
            except LinkError:
                continue  # the drawn posture is out of reach
        record = scene.record(has_codes=has_codes)
        found = explain(record)
        yield Drawn(cause, firmware, found[0] if found else None, record)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="number of stops (default: 200)")
    parser.add_argument("--seed", type=int, default=45, help="seed (default: 45)")
    parser.add_argument("--without-codes", action="store_true", help="use no messages of the primary interface")
    parser.add_argument("--show", action="store_true", help="print each wrong explanation")
    options = parser.parse_args(arguments)
    counts: dict[tuple[str, str], list[int]] = collections.defaultdict(lambda: [0, 0])
    for drawn in draw(options.runs, options.seed, has_codes=not options.without_codes):
        if options.without_codes and drawn.cause == "another client":
            continue  # without messages, programs have no names
        count = counts[drawn.cause, drawn.firmware]
        count[0] += drawn.is_right
        count[1] += 1
        if options.show and not drawn.is_right:
            print(f"--- {drawn.cause}, firmware {drawn.firmware}")
            print("nothing found" if drawn.found is None else drawn.found.text(picture=False))
    print(f"{'cause':26}" + "".join(f"{firmware:>10}" for firmware in FIRMWARES))
    for cause in CAUSES:
        cells = [counts[cause, firmware] for firmware in FIRMWARES]
        print(f"{cause:26}" + "".join(f"{f'{right}/{total}':>10}" for right, total in cells))
    right, total = (sum(count[at] for count in counts.values()) for at in (0, 1))
    print(f"right cause first: {right} of {total}, {100 * right / max(total, 1):.1f} %")
    return 0 if total and right >= 0.95 * total else 1


if __name__ == "__main__":
    sys.exit(main())
