"""The programs that move an arm, as text: the lines within their ``def``, for the firmware that is to run them.

Assignments in a thread or a nested function reach the variables of the program around them, as the programs of public
drivers rely on; nothing here needs ``global`` or ``local``, which the oldest firmware may not have. Lists are
written out element by element, since arithmetic on whole lists came late.

Two of the programs open a socket back to this computer (reference ur-script, sections 2 and 5):

- `streaming` reads seven big-endian int32 per set-point: six joints in millionths of a rad, and what to do, one of
  `STOP`, `FOLLOW` and `WAIT`. The answer of ``socket_read_binary_integer`` begins with the count that was read; after
  two seconds without anything, or once the link is gone, that is less than seven.
- `waypoints` asks for a point by its number, a line of text, and is answered with a list of floats in brackets. The
  line `BEAT` asks whether to go on, and `ARRIVED` says that the last point is reached.

What ends them before their time they say with a ``textmsg``: `NO_CONNECTION`, `LINK_ENDED`, `STARVED`, `TOO_FAR`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import dedent, indent

from ..firmware import Firmware
from .text import integer, number, pose, quoted, vector

__all__ = [
    "ARRIVED",
    "BEAT",
    "FOLLOW",
    "LINK_ENDED",
    "NO_CONNECTION",
    "NO_MORE",
    "SCALE",
    "STARVED",
    "STOP",
    "TOO_FAR",
    "WAIT",
    "move_joints",
    "move_linear",
    "numbers_of_point",
    "speed_joints",
    "speed_linear",
    "stop",
    "streaming",
    "waypoints",
]

#: What a set-point is multiplied by.
SCALE = 1_000_000
#: The last of the seven numbers: brake and end, go to this set-point, or do nothing yet.
STOP, FOLLOW, WAIT = 0, 1, 2
#: Lines of the waypoint program that are no number of a point.
BEAT, ARRIVED = -1, -2
#: The number of the answer after the last waypoint.
NO_MORE = -1

NO_CONNECTION = "urlink: cannot connect"
LINK_ENDED = "urlink: the link ended"
STARVED = "urlink: nothing to go to"
TOO_FAR = "urlink: the first point is too far away"

#: Part of its last step that an arm goes on by in each cycle without a set-point: a late one makes no dent, and without
#: any it comes to rest within nine steps.
_FADING = 0.9
#: Seconds for which the last waypoint is held, so that the arm catches up.
_SETTLING = 0.2
#: rad/s; at a waypoint that is faster there is no waiting for the next one.
_SLOW = 0.05


# -- one command ---------------------------------------------------------------------------------------


def move_joints(q: Sequence[float], speed: float, acceleration: float, time: float | None = None) -> list[str]:
    """Move the joints to `q` (6, rad), at most so fast (rad/s, rad/s²), or in `time` seconds."""
    return [f"movej({vector(q, what='q')}, {_how(speed, acceleration, time)})"]


def move_linear(target: Sequence[float], speed: float, acceleration: float, time: float | None = None) -> list[str]:
    """Move the tool in a straight line to a pose (m, rad), at most so fast (m/s, m/s²), or in `time` seconds."""
    return [f"movel({pose(target)}, {_how(speed, acceleration, time)})"]


def _how(speed: float, acceleration: float, time: float | None) -> str:
    limits = f"a={number(acceleration, 'acceleration')}, v={number(speed, 'speed')}"
    return limits if time is None else f"{limits}, t={number(time, 'time')}"


def speed_joints(firmware: Firmware, qd: Sequence[float], acceleration: float, duration: float) -> list[str]:
    """Turn the joints at `qd` (6, rad/s) for `duration` seconds, then brake."""
    return _speed(firmware, "speedj", vector(qd, what="qd"), acceleration, duration, "stopj")


def speed_linear(firmware: Firmware, xd: Sequence[float], acceleration: float, duration: float) -> list[str]:
    """Move the tool at `xd` (6, m/s and rad/s) for `duration` seconds, then brake."""
    return _speed(firmware, "speedl", vector(xd, what="xd"), acceleration, duration, "stopl")


def _speed(
    firmware: Firmware, function: str, speeds: str, acceleration: float, duration: float, brake: str
) -> list[str]:
    a, t = number(acceleration, "acceleration"), number(duration, "duration")
    # 3.1 and 3.2 take no time here: they return once the speed is reached, and keep it (reference ur-script, section 2)
    timed = [f"{function}({speeds}, {a}, {t})"]
    untimed = [f"{function}({speeds}, {a})", f"sleep({t})"]
    return [*(untimed if (3, 1) <= firmware[:2] < (3, 3) else timed), f"{brake}({a})"]


def stop(acceleration: float) -> list[str]:
    """Brake all joints with so many rad/s²."""
    return [f"stopj({number(acceleration, 'acceleration')})"]


# -- programs that talk back -----------------------------------------------------------------------------


def streaming(
    firmware: Firmware,
    host: str,
    port: int,
    *,
    watchdog: float = 0.1,
    lookahead_time: float = 0.1,
    gain: float = 300.0,
    deceleration: float = 4.0,
) -> list[str]:
    """Follow set-points that come over a socket, one per cycle, and brake where they stay away.

    Args:
        host: address at which the robot reaches this computer.
        watchdog: seconds without a set-point after which it brakes.
        lookahead_time, gain: of ``servoj``, where the firmware has them.
        deceleration: rad/s² with which it brakes.
    """
    servo = _servo(firmware, lookahead_time, gain)
    missable = max(math.ceil(watchdog * firmware.rate), 2)
    text = f"""
        target = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        mode = {WAIT}
        fresh = False
        starved = False
        thread servo():
          q = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          last = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          step = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          missed = 0
          begun = False
          going = True
          while going:
            enter_critical
            wanted = mode
            is_new = fresh
            fresh = False
            goal = target
            exit_critical
            if wanted == {STOP}:
              going = False
            elif wanted == {WAIT}:
              sync()
            elif is_new:
              if begun:
                share = 1.0 / (missed + 1)
                step = [{_each("(goal[{i}] - last[{i}]) * share")}]
              end
              begun = True
              missed = 0
              last = goal
              q = goal
              {servo}
            elif missed < {missable}:
              missed = missed + 1
              step = [{_each("step[{i}] * " + number(_FADING))}]
              q = [{_each("q[{i}] + step[{i}]")}]
              {servo}
            else:
              starved = True
              textmsg({quoted(STARVED)})
              going = False
            end
          end
          stopj({number(deceleration)})
        end
        if socket_open({quoted(host)}, {integer(port, 1, 65535)}):
          servo_thread = run servo()
          reading = True
          while reading:
            word = socket_read_binary_integer(7)
            if word[0] < 7:
              if not starved:
                textmsg({quoted(LINK_ENDED)})
              end
              reading = False
            elif starved:
              reading = False
            elif word[7] == {FOLLOW}:
              goal_read = [{_each("word[{n}] / " + number(SCALE))}]
              enter_critical
              target = goal_read
              fresh = True
              mode = {FOLLOW}
              exit_critical
            elif word[7] == {STOP}:
              reading = False
            end
          end
          mode = {STOP}
          join servo_thread
          socket_close()
        else:
          textmsg({quoted(NO_CONNECTION)})
        end
    """
    return _lines(text)


def numbers_of_point(is_quintic: bool) -> int:
    """Numbers in an answer: its own, positions, velocities, accelerations if it is quintic, seconds since the last."""
    return 20 if is_quintic else 14


def waypoints(
    firmware: Firmware,
    host: str,
    port: int,
    *,
    is_quintic: bool,
    lookahead_time: float = 0.1,
    gain: float = 300.0,
    deceleration: float = 4.0,
    max_difference: float = 0.01,
    max_wait: float = 2.0,
    heartbeat: float = 0.25,
) -> list[str]:
    """Ask for waypoints one after the other and interpolate between them; for 3.x and later.

    One waypoint is under way to the robot while it moves to the one before.

    Args:
        host: address at which the robot reaches this computer.
        is_quintic: waypoints have accelerations.
        lookahead_time, gain: of ``servoj``.
        deceleration: rad/s² with which it brakes.
        max_difference: rad that the first waypoint may be away from the joints.
        max_wait: seconds for which it waits for a waypoint, where the last one was slow; else it brakes at once.
        heartbeat: seconds between two questions whether this computer is there, while it needs no waypoint.
    """
    servo = _servo(firmware, lookahead_time, gain)
    period = number(1.0 / firmware.rate)
    count = numbers_of_point(is_quintic)
    coefficients = _QUINTIC if is_quintic else _CUBIC
    curve = "c0[{i}] + u * (c1[{i}] + u * (c2[{i}] + u * c3[{i}]))"
    if is_quintic:
        curve = "c0[{i}] + u * (c1[{i}] + u * (c2[{i}] + u * (c3[{i}] + u * (c4[{i}] + u * c5[{i}]))))"
    text = f"""
        point = [{", ".join(["0.0"] * (count + 1))}]
        before = point
        ready = False
        complete = False
        leave = False
        moving = True
        cycles = 0
        thread follow():
          q = [{_each("before[{q}]")}]
          c0 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c1 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c2 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c3 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c4 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c5 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          t = 0.0
          waited = 0.0
          going = True
          while going:
            enter_critical
            is_there = ready
            next = point
            ready = False
            is_last = complete
            exit_critical
            if leave:
              going = False
            elif is_there:
              h = next[{count}]
              i = 0
              while i < 6:
{indent(dedent(coefficients), " " * 16).rstrip()}
                i = i + 1
              end
              while t < h and not leave:
                u = t / h
                q = [{_each(curve)}]
                {servo}
                t = t + {period}
              end
              t = t - h
              before = next
              waited = 0.0
            elif is_last:
              q = [{_each("before[{q}]")}]
              t = 0.0
              while t < {number(_SETTLING)} and not leave:
                {servo}
                t = t + {period}
              end
              going = False
            else:
              i = 0
              while i < 6:
                if before[8 + i] > {number(_SLOW)} or before[8 + i] < {number(-_SLOW)}:
                  waited = {number(max_wait)}
                end
                i = i + 1
              end
              if waited < {number(max_wait)}:
                q = [{_each("before[{q}]")}]
                {servo}
                waited = waited + {period}
                t = 0.0
              else:
                textmsg({quoted(STARVED)})
                leave = True
              end
            end
          end
          stopj({number(deceleration)})
          moving = False
        end
        def pause():
          cycles = cycles + 1
          if cycles < {max(math.ceil(heartbeat * firmware.rate), 1)}:
            sync()
          else:
            cycles = 0
            socket_send_string({BEAT})
            socket_send_byte(10)
            word = socket_read_ascii_float(1)
            if word[0] < 1:
              textmsg({quoted(LINK_ENDED)})
              leave = True
            elif not (word[1] == 1):
              leave = True
            end
          end
        end
        if socket_open({quoted(host)}, {integer(port, 1, 65535)}):
          n = 0
          asking = True
          while asking and not leave:
            socket_send_string(n)
            socket_send_byte(10)
            answer = socket_read_ascii_float({count})
            if answer[0] < {count}:
              textmsg({quoted(LINK_ENDED)})
              leave = True
            elif answer[1] == n:
              if n == 0:
                here = get_actual_joint_positions()
                k = 0
                while k < 6:
                  away = answer[2 + k] - here[k]
                  if away > {number(max_difference)} or away < {number(-max_difference)}:
                    leave = True
                  end
                  k = k + 1
                end
                if leave:
                  textmsg({quoted(TOO_FAR)})
                else:
                  before = answer
                  follow_thread = run follow()
                  n = 1
                end
              else:
                while ready and not leave:
                  pause()
                end
                enter_critical
                point = answer
                ready = True
                exit_critical
                n = n + 1
              end
            elif answer[1] == {NO_MORE}:
              complete = True
              asking = False
            else:
              textmsg({quoted(LINK_ENDED)})
              leave = True
            end
          end
          if n > 0:
            while moving and not leave:
              pause()
            end
            join follow_thread
            if not leave:
              socket_send_string({ARRIVED})
              socket_send_byte(10)
            end
          end
          socket_close()
        else:
          textmsg({quoted(NO_CONNECTION)})
        end
    """
    return _lines(text)


#: One joint of the polynomial between two waypoints, in u from 0 to 1.
_CUBIC = """
    v0 = before[8 + i] * h
    v1 = next[8 + i] * h
    way = next[2 + i] - before[2 + i]
    c0[i] = before[2 + i]
    c1[i] = v0
    c2[i] = 3.0 * way - 2.0 * v0 - v1
    c3[i] = v0 + v1 - 2.0 * way
"""
_QUINTIC = """
    v0 = before[8 + i] * h
    v1 = next[8 + i] * h
    a0 = before[14 + i] * h * h
    a1 = next[14 + i] * h * h
    way = next[2 + i] - before[2 + i]
    c0[i] = before[2 + i]
    c1[i] = v0
    c2[i] = 0.5 * a0
    c3[i] = 10.0 * way - 6.0 * v0 - 4.0 * v1 - 1.5 * a0 + 0.5 * a1
    c4[i] = 8.0 * v0 + 7.0 * v1 + 1.5 * a0 - a1 - 15.0 * way
    c5[i] = 6.0 * way - 3.0 * v0 - 3.0 * v1 - 0.5 * a0 + 0.5 * a1
"""


def _servo(firmware: Firmware, lookahead_time: float, gain: float) -> str:
    """One cycle of ``servoj`` to `q`: before 3.0 it has neither lookahead nor gain (reference ur-script, section 5)."""
    smoothing = (
        ""
        if firmware.is_cb2
        else (
            f", lookahead_time={number(lookahead_time, 'lookahead_time', 0.03, 0.2)}"
            f", gain={number(gain, 'gain', 100, 2000)}"
        )
    )
    return f"servoj(q, t={number(1.0 / firmware.rate)}{smoothing})"


def _each(template: str) -> str:
    """A list of six: `{i}` counts from 0, `{n}` from 1, and `{q}` finds the position in an answer."""
    return ", ".join(template.format(i=i, n=i + 1, q=i + 2) for i in range(6))


def _lines(text: str) -> list[str]:
    return [line.rstrip() for line in dedent(text).splitlines() if line.strip()]
