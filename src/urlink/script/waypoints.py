"""The program that receives a trajectory point by point and interpolates on its own; firmware 3.x and later.

It requests a point by sending its number as a line of text. The answer is a list of floats in brackets. The line `BEAT`
asks whether to continue, and the answer is ``(1)``. The line `ARRIVED` reports that the last point is reached. If the
arm was moved during a pause, it stays where it is. `HELD` then asks how many seconds of the path have passed at that
place; for example, ``(1.1)`` means 0.1. `urlink.script.links` describes the parts that all such programs share.
"""

from __future__ import annotations

import math

from ..protocol.firmware import Firmware
from .links import BRAKE, LINK_ENDED, NO_CONNECTION, STARVED, TOO_FAR, introduction
from .streaming import LAST_PLACE, found_elsewhere, servo_cycle
from .text import each, indented, integer, lines, number, quoted

#: Lines of the program that are not the number of a point.
BEAT, ARRIVED, HELD = -1, -2, -3
#: Number in the answer after the last waypoint.
NO_MORE = -1

#: Time, in seconds, that the last waypoint is held, so that the arm catches up.
_SETTLING = 0.2
#: Time, in seconds, for fading out a difference from the path after a pause.
FADING = 0.4
#: Speed of a waypoint, in rad/s, above which the program does not wait for the next one, but brakes immediately. Time,
#: in seconds, that it waits if the last waypoint was slow.
_SLOW, _PATIENCE = 0.05, 2.0
#: Largest allowed distance, in rad, between the first waypoint and the joints.
_NEAR = 0.01
#: Interval, in seconds, for checking that this computer is present while no waypoint is needed.
_HEARTBEAT = 0.25


def numbers_of_point(is_quintic: bool) -> int:
    """Return how many numbers an answer has.

    An answer has the number of its point, positions, velocities, accelerations if `is_quintic`, and the seconds since
    the previous waypoint.
    """
    return 20 if is_quintic else 14


def interpolating(
    firmware: Firmware,
    host: str,
    port: int,
    token: int,
    *,
    is_quintic: bool,
    lookahead_time: float = 0.1,
    gain: float = 300.0,
) -> list[str]:
    """Request waypoints one after the other and interpolate between them; for 3.x and later.

    While the robot moves to a waypoint, the next waypoint is already in transit to the robot.

    Args:
        host: Address of this computer for the robot.
        token: Number that proves that the connecting program is the expected one.
        is_quintic: Whether waypoints have accelerations.
        lookahead_time, gain: Parameters of ``servoj``.
    """
    servo = servo_cycle(firmware, lookahead_time, gain)
    go = f"""
        def go():
          if faded == 0.0:
            apart = [{each("here[{i}] - q[{i}]")}]
          end
          if faded < 1.0:
            left = 1.0 - faded * faded * (3.0 - 2.0 * faded)
            q = [{each("q[{i}] + left * apart[{i}]")}]
            faded = faded + {number(1.0 / (FADING * firmware.rate))}
          end
{indented(found_elsewhere(firmware), 10)}
          if elsewhere:
            held = True
            q = here
            while held and not leave:
              {servo}
            end
            t = t + skipped
            faded = 0.0
            patient = True
          else:
            {servo}
          end
        end
    """
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
        held = False
        skipped = 0.0
        patient = False
        faded = 1.0
        apart = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        q = apart
        t = 0.0
        here = apart
{indented(LAST_PLACE)}
{indented(go)}
        thread follow():
{indented(LAST_PLACE, 10)}
          q = [{each("before[{q}]")}]
          c0 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c1 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c2 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c3 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c4 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          c5 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
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
{indented(coefficients, 16)}
                i = i + 1
              end
              while t < h and not leave:
                u = t / h
                patient = False
                q = [{each(curve)}]
                go()
                t = t + {period}
              end
              t = t - h
              before = next
              waited = 0.0
            elif is_last:
              t = 0.0
              while (t < {number(_SETTLING)} or faded < 1.0) and not leave:
                q = [{each("before[{q}]")}]
                go()
                t = t + {period}
              end
              going = False
            elif patient:
              q = here
              {servo}
            else:
              i = 0
              while i < 6:
                if before[8 + i] > {number(_SLOW)} or before[8 + i] < {number(-_SLOW)}:
                  waited = {number(_PATIENCE)}
                end
                i = i + 1
              end
              if waited < {number(_PATIENCE)}:
                q = [{each("before[{q}]")}]
                go()
                waited = waited + {period}
                t = 0.0
              else:
                textmsg({quoted(STARVED)})
                leave = True
              end
            end
          end
          {BRAKE}
          moving = False
        end
        def pause():
          cycles = cycles + 1
          if held:
            socket_send_string({HELD})
            socket_send_byte(10)
            message = socket_read_ascii_float(1)
            if message[0] < 1:
              textmsg({quoted(LINK_ENDED)})
              leave = True
            else:
              skipped = message[1] - 1.0
              held = False
            end
          elif cycles < {math.ceil(_HEARTBEAT * firmware.rate)}:
            sync()
          else:
            cycles = 0
            socket_send_string({BEAT})
            socket_send_byte(10)
            message = socket_read_ascii_float(1)
            if message[0] < 1:
              textmsg({quoted(LINK_ENDED)})
              leave = True
            elif not (message[1] == 1):
              leave = True
            end
          end
        end
        if socket_open({quoted(host)}, {integer(port, 1, 65535)}):
          {introduction(token)}
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
                  if away > {number(_NEAR)} or away < {number(-_NEAR)}:
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
    return lines(text)


#: Polynomial of one joint between two waypoints, in u from 0 to 1.
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
