"""A mission controller on a turtle in this process, without sockets, threads or real time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.world import World
from rhdlink.smrcl.controller import MissionController
from rhdlink.smrcl.profile import SOUND, Profile, find_profile
from rhdlink.smrcl.recipients import Said, SaidKind
from rhdlink.smrcl.robot_conf import SMR, VELOMEGA, RobotConf
from rhdlink.smrcl.robot_link import PluginLink

#: Number of cycles of a run without a limit.
FOREVER = 100_000


@dataclass
class Bench:
    """A robot and the controller that drives it.

    Attributes:
        robot: Drive of the robot, "velomega" or "differential".
        profile: Profile of the controller, "mrc" or "sound".
        conf: Configuration of the robot for the controller; if None, that of the turtle.
        speeds: Written forward speed in m/s and turn rate in rad/s, for each cycle.
        said: All output of the controller.
    """

    robot: str = "velomega"
    profile: Profile | str = SOUND
    conf: RobotConf | None = None
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.world = World(1000.0)
        self.turtle = Turtle(self.world) if self.robot == "velomega" else SmrTurtle(self.world)
        self.link = PluginLink([self.turtle])
        usual = VELOMEGA if self.robot == "velomega" else SMR
        self.controller = MissionController(
            self.conf or usual, self.link.read, self.link.write, profile=find_profile(self.profile), **self.options
        )
        self.request = self.controller.first_request()
        self.said: list[Said] = []
        self.speeds: list[tuple[float, float]] = []
        self.written: dict[str, Sequence[int]] = {}

    def load(self, source: str) -> Bench:
        self.controller.load(source)
        return self

    def cycle(self) -> bool:
        """Run one exchange with the robot; return False when the controller has finished."""
        self.written |= self.request
        answer = self.link.exchange(self.request)
        if self.controller.is_finished:
            return False
        self.request = self.controller.step(answer)
        self.said += self.controller.take_said()
        control = self.controller.vehicle.control
        if self.robot == "velomega":
            self.speeds.append((control.left, control.omega))
        else:
            self.speeds.append(((control.left + control.right) / 2, (control.right - control.left) / 0.26))
        return True

    def run(self, source: str | None = None, *, cycles: int = FOREVER) -> Bench:
        """Run to the end, or for at most this many cycles."""
        if source is not None:
            self.load(source)
        for _ in range(cycles):
            if not self.cycle():
                break
        return self

    def run_until(self, is_true: Callable[[], bool], *, cycles: int = 10_000) -> Bench:
        for _ in range(cycles):
            if is_true():
                return self
            assert self.cycle(), "the controller ended before the condition became true"
        raise AssertionError("the condition did not become true")

    # -- results ----------------------------------------------------------------------------------

    def texts(self, kind: SaidKind) -> list[str]:
        return [said.text for said in self.said if said.kind is kind]

    @property
    def values(self) -> list[list[float]]:
        """Values that `eval` has computed, line by line."""
        return [[float(word) for word in text.split()] for text in self.texts(SaidKind.VALUES)]

    @property
    def value(self) -> float:
        """The only value that `eval` has computed."""
        ((found,),) = self.values
        return found

    @property
    def printed(self) -> str:
        return "".join(said.printed for said in self.said)

    @property
    def pose(self) -> tuple[float, float, float]:
        """True pose of the robot in m, m and degrees, with an unwrapped heading."""
        x, y, theta = self.world.odometry
        return x, y, math.degrees(theta)

    @property
    def reason(self) -> str:
        """Reason for the failure."""
        assert self.controller.failure is not None, "the controller did not fail"
        return self.controller.failure.reason

    @property
    def is_over(self) -> bool:
        return self.controller.is_finished and self.controller.failure is None
