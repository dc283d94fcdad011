"""Commands for motions, motion settings and odometry.

`commands` has the table of all commands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from .arithmetic import format_number
from .effects import MissionEffects
from .expressions import LineFault
from .interpreter import never
from .motion.basic import Align, FollowDirection, Forward, FunctionGenerator, Stop, Wheels
from .motion.control import Standing
from .motion.following import FollowLine, FollowWall, FollowWallTable
from .motion.topoint import DriveToPoint
from .motion.turning import ArcTurn, Clothoid, Turn
from .plan import Outcome
from .planar_pose import PlanarPose
from .sensors import LineKind


def forward(effects: MissionEffects, distance: float) -> Outcome:
    """`fwd`: drive straight ahead by a distance in m; a negative distance is backward."""
    effects.vehicle.control.distance = distance
    return effects.move(Forward(distance))


def turn(effects: MissionEffects, angle: float, unit: object = None) -> Outcome:
    """`turn`: turn on the spot."""
    return effects.move(Turn(_radians(angle, unit)))


def turn_on_arc(effects: MissionEffects, radius: float, angle: float, unit: object = None) -> Outcome:
    """`turnr`: turn along an arc with a radius in m."""
    return effects.move(ArcTurn(radius, _radians(angle, unit)))


def turn_on_clothoid(effects: MissionEffects, radius: float, angle: float, unit: object = None) -> Outcome:
    """`turnc`: turn along an arc whose curvature grows and shrinks."""
    return effects.move(Clothoid(radius, _radians(angle, unit)))


def drive(effects: MissionEffects, *reference: float) -> Outcome:
    """`drive`: drive along the line through a point in a direction, by default the current pose."""
    return _follow(effects, FollowDirection(), reference)


def drive_on(effects: MissionEffects, *reference: float) -> Outcome:
    """`driveon`: as `drive`, but begin at the commanded speed."""
    return _follow(effects, FollowDirection(keeps_speed=True), reference)


def drive_in_world(effects: MissionEffects, *reference: float) -> Outcome:
    """`drivew`: as `drive`, in world coordinates."""
    return _follow(effects, FollowDirection(is_world=True), reference)


def drive_on_in_world(effects: MissionEffects, *reference: float) -> Outcome:
    """`driveonw`: as `driveon`, in world coordinates."""
    return _follow(effects, FollowDirection(keeps_speed=True, is_world=True), reference)


def _follow(effects: MissionEffects, motion: FollowDirection, reference: Sequence[float]) -> Outcome:
    vehicle = effects.vehicle
    vehicle.control.distance = 0.0
    if len(reference) < 3:
        here = vehicle.estimated_pose()
        vehicle.control.reference.set(here.x, here.y, here.th)
        return effects.move(motion)
    x, y, th = reference[:3]
    vehicle.control.reference.set(x, y, _radians(th, reference[3] if len(reference) > 3 else None))
    return effects.move(motion)


def drive_to_point(
    effects: MissionEffects, x: float, y: float, th: float, radius: float, frame: object = None
) -> Outcome:
    """`drivetopoint`: drive to a pose along arcs of a radius and a straight line."""
    goal = PlanarPose(x, y, _radians(th, None))
    return effects.move(DriveToPoint(goal, radius, is_absolute=frame == "abs"))


def set_wheels(effects: MissionEffects, left: float, right: float) -> Outcome:
    """`motorcmds`: set the speeds of the wheels, in m/s."""
    return effects.move(Wheels(left, right))


def follow_line(effects: MissionEffects, kind: str) -> Outcome:
    """`followline`: follow a black or a white line."""
    try:
        effects.vehicle.line_kind = LineKind(kind)
    except ValueError:
        names = ", ".join(each.value for each in LineKind)
        effects.reject_name(f'followline has no line "{kind}", only {names}')
        effects.vehicle.line_kind = LineKind.BLACK_MIDDLE
    return effects.move(FollowLine())


def follow_wall(effects: MissionEffects, side: str, distance: float) -> Outcome:
    """`followwall`: follow a wall at a distance in m."""
    _choose_side(effects, side)
    return effects.move(FollowWall(effects.side_is_left, distance))


def follow_wall_by_table(effects: MissionEffects, side: str, distance: float) -> Outcome:
    """`followwall2`: follow a wall at a distance, with the gains of wdssparam.dat."""
    _choose_side(effects, side)
    if side[1:2] not in ("d", "r"):
        effects.reject_name(f'followwall2 has no method "{side[1:2]}", only d and r', "Wrong parameter \n")
    if side[1:2] == "r":
        raise LineFault(
            "followwall2 by regression needs an estimator of walls, which does not exist here; use rd or ld"
        )
    if not effects.vehicle.control.parameters.wall_table:
        raise LineFault("followwall2 needs the table of wdssparam.dat (wall_table of the robot's configuration)")
    return effects.move(FollowWallTable(effects.side_is_left, distance))


def _choose_side(effects: MissionEffects, side: str) -> None:
    if side[:1] in ("l", "r"):
        effects.side_is_left = side[:1] == "l"
    else:
        effects.reject_name(f'a side is "l" or "r", not "{side}"', "wrong parameter\n")


def stop(effects: MissionEffects) -> Outcome:
    """`stop`: stop, and hold the heading."""
    return effects.move(Stop())


def idle(effects: MissionEffects) -> Outcome:
    """`idle`: set the motors to zero."""
    return effects.move(Standing())


def align(effects: MissionEffects) -> Outcome:
    """`align`: press both wheels against an obstacle."""
    return effects.move(Align())


def move_to(effects: MissionEffects, x: float, y: float, z: float) -> Outcome:
    """`movetoxyz`: call the user's function."""
    effects.use_hook(x, y, z)
    return effects.wait(never)


def generate(effects: MissionEffects, *parameters: float) -> Outcome:
    """`funcgen`: generate a signal.

    Omitted parameters keep their values from the previous signal.
    """
    effects.signal[: len(parameters)] = parameters
    return effects.move(FunctionGenerator(effects.signal))


def ignore_obstacles(effects: MissionEffects) -> Outcome:
    """`ignoreobstacles`: the next motion does not slow down before obstacles."""
    effects.vehicle.control.ignore_obstacles()
    return effects.at_once()


def set_target_here(effects: MissionEffects) -> Outcome:
    """`targethere`: let the next motion begin at the current position of the robot."""
    effects.vehicle.control.target = effects.vehicle.odometry.pose.copy()
    return effects.go_on()


def reset_covariance(effects: MissionEffects) -> Outcome:
    """`resetodocov`: reset the uncertainty of the pose."""
    effects.vehicle.covariance.reset()
    return effects.go_on()


def reset_motors(effects: MissionEffects) -> Outcome:
    """`resetmotors`: stop for six cycles, in which the motors of an SMR are reset."""
    vehicle = effects.vehicle
    effects.output.message(f" p0 {format_number(effects.routine_result)} \n")
    start = PlanarPose()

    def routine(cycle: int) -> bool:
        nonlocal start
        if cycle == 0:
            effects.output.message("reset state1\n")
            start = vehicle.odometry.pose.copy()
            effects.routine_result = start.x
            vehicle.control.start(Standing())
            vehicle.outputs.reset_motors()
        if cycle < 6:
            return False
        effects.output.message("reset state2 \n")
        vehicle.odometry.pose = start
        return True

    effects.run.start_routine(routine)
    return Outcome.WAIT


def _radians(angle: float, unit: object) -> float:
    """Convert an angle from degrees. With any value of `unit`, the angle is already in rad."""
    return angle * math.pi / 180.0 if unit is None else angle
