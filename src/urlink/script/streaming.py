"""Programs that obey a stream of messages: set-points, one for each cycle of the controller, or speeds to jog at.

The messages of both are the same, with speeds in the place of positions; where none comes, the arm brakes.
"""

from __future__ import annotations

from collections.abc import Sequence

from linkcore.arguments import check_number

from ..protocol.firmware import Firmware
from .commands import takes_duration
from .links import BRAKE, InputRegisters, ReverseSocket, message_loop, missable
from .text import each, indented, lines, number

#: Seconds for which the streaming program goes on by itself, whatever its watchdog lets it. Chosen: the default
#: watchdog. Longer, an arm would be led a good way past the end of a movement by a computer that is too busy.
COASTING = 0.1
#: rad/s² with which a set-point is approached at most on CB2. Chosen: twice what the arms of that generation report as
#: the limit of their wrists, so that what is sent in time is left as it is; a third of what the simulated one stops at.
_HARDEST = 50.0
#: rad/s, all joints together, below which an arm is at rest; and rad by which it has to be elsewhere then.
_RESTING, _ELSEWHERE = 1e-4, 5e-4
#: What comes before the first `found_elsewhere`.
LAST_PLACE = "last_here = get_target_joint_positions()\nlast_way = 0.0"


def streaming(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    *,
    speeds: Sequence[float],
    watchdog: float = 0.1,
    coasting: float = COASTING,
    lookahead_time: float = 0.1,
    gain: float = 300.0,
) -> list[str]:
    """Follow set-points, one per cycle, and brake where they stay away.

    While one is late the arm goes on at the speed that came with the last, ever slower, and rests after `coasting`
    seconds, or when the watchdog's time is up, if that is sooner. The speed is sent, and not derived from the last two
    positions: where set-points come only every tenth cycle, a difference between positions holds mostly what the
    program itself went on by, and so it would go on in a direction that is not wanted any more. No set-point is
    followed faster than the joints can move: where it is further away, it is approached at their largest speed. So
    whatever goes wrong on the way, the arm does not leap. Where the arm is found at rest in another place than in the
    round before, the program was paused: it stays there until a set-point comes from after the pause, so that those
    from before do not lead the arm back. On CB2, where ``servoj`` does not smooth, the change of speed is bounded too.

    Args:
        link: how the set-points come.
        speeds: (6,) rad/s at most of each joint.
        watchdog: seconds without a set-point after which it brakes.
        coasting: seconds without one after which the arm has come to rest.
        lookahead_time, gain: of ``servoj``, where the firmware has them.
    """
    servo = servo_cycle(firmware, lookahead_time, gain)
    most_missed = missable(watchdog, firmware.rate)
    most_coasted = missable(min(watchdog, coasting), firmware.rate)
    cycle = number(1.0 / firmware.rate)
    ways = [number(check_number(speed, "speed", 1e-3) / firmware.rate) for speed in speeds]
    if firmware.is_cb2:
        easing = _eased(firmware)
        move = f"moved = [{each('eased(aim[{i}], q[{i}], pace[{i}], moved[{i}], {way})', ways)}]"
        move += f"\nq = [{each('q[{i}] + moved[{i}]')}]"
        # The first, too, may be one of several that come at once.
        begin = f"if not begun:\n  q = get_actual_joint_positions()\nend\npace = step\n{move}"
        coast = f"pace = [{each('step[{i}] * share')}]\n{move}"
    else:
        easing = ""
        coast = f"q = [{each('bounded(aim[{i}], q[{i}], {way})', ways)}]"
        begin = f"if begun:\n  {coast}\nelse:\n  q = aim\nend"
    bounds = f"""
        def bounded(aim, here, way):
          if aim > here + way:
            return here + way
          elif aim < here - way:
            return here - way
          end
          return aim
        end
{indented(easing)}
    """
    held = "step = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"
    if firmware.is_cb2:
        held += "\nmoved = step"
    guard = f"""
{indented(found_elsewhere(firmware))}
        if begun and elsewhere:
          held = True
          q = here
          aim = here
{indented(held, 10)}
        end
    """
    start = f"""
{indented(LAST_PLACE)}
        q = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        aim = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        step = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        missed = 0
        begun = False
    """
    received = f"""
        step = [{each("speed[{i}] * " + cycle)}]
        aim = goal
{indented(begin)}
        begun = True
        missed = 0
        {servo}
    """
    late = f"""
        if missed < {most_coasted}:
          share = 1.0 - missed / {number(most_coasted)}
          aim = [{each("aim[{i}] + step[{i}] * share")}]
        else:
          share = 0.0
        end
{indented(coast)}
        {servo}
    """
    loop = message_loop(
        firmware, link, start, received, late, BRAKE, watchdog=watchdog, most_missed=most_missed, guard=guard
    )
    return [*lines(bounds), *loop]


def _eased(firmware: Firmware) -> str:
    """How far a joint goes in a cycle where the controller does not smooth: before 3.0 ``servoj`` has no look-ahead.

    As far as the set-point, if the speed changes by no more than `_HARDEST` allows. Else as fast towards it as can be
    braked until there, beside the speed with which the set-point itself goes on. Several set-points that come at once,
    after this computer and the controller were both held up, are otherwise one leap.
    """
    hard = _HARDEST / firmware.rate**2
    braking = f"sqrt({number(0.25 * hard * hard)} + {number(2.0 * hard)} * left) - {number(0.5 * hard)}"
    return f"""
        pace = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        moved = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        def eased(goal, here, pace, last, way):
          move = goal - here
          if move > last + {number(hard)} or move < last - {number(hard)}:
            left = move - pace
            if left > 0.0:
              move = pace + {braking}
            else:
              left = 0.0 - left
              move = pace - ({braking})
            end
            move = bounded(move, last, {number(hard)})
          end
          return bounded(move, 0.0, way)
        end
    """


def found_elsewhere(firmware: Firmware) -> str:
    """Sets ``elsewhere``: whether the arm, ``here``, is at rest in another place than in the round before, further away
    than its speed was then. Nothing but a pause, in which the controller has braked it and a person may have moved it,
    explains that.
    """
    way = _length("(here[{i}] - last_here[{i}])")
    return f"""
        here = get_target_joint_positions()
        rate = get_target_joint_speeds()
        speed_now = {_length("rate[{i}]")}
        elsewhere = speed_now < {number(_RESTING)} and {way} > {number(_ELSEWHERE)} + last_way
        last_here = here
        last_way = {number(2.0 / firmware.rate)} * speed_now
    """


def _length(each_joint: str) -> str:
    parts = [each_joint.format(i=i) for i in range(6)]
    return f"sqrt({' + '.join(f'{part} * {part}' for part in parts)})"


def servo_cycle(firmware: Firmware, lookahead_time: float, gain: float) -> str:
    """One cycle of ``servoj`` to `q`.

    Before 3.0 it has neither lookahead nor gain (docs/protocols/urscript.md, Differences).
    """
    smoothing = (
        ""
        if firmware.is_cb2
        else (
            f", lookahead_time={number(lookahead_time, 'lookahead_time', 0.03, 0.2)}"
            f", gain={number(gain, 'gain', 100, 2000)}"
        )
    )
    return f"servoj(q, t={number(1.0 / firmware.rate)}{smoothing})"


def jogging(
    firmware: Firmware, link: ReverseSocket | InputRegisters, *, is_tool: bool, acceleration: float, watchdog: float
) -> list[str]:
    """Move at the speeds of the newest message, and brake where none has come for a while.

    ``speedj`` and ``speedl`` are called anew in each cycle, with the time of one cycle, as public drivers do. So the
    arm goes over from one speed to the next with `acceleration`.

    Args:
        link: how the messages come.
        is_tool: they are speeds of the tool in the base frame, m/s and rad/s, rather than of the joints, rad/s.
        acceleration: m/s² or rad/s².
        watchdog: seconds without a message after which it brakes.
    """
    function, brake = ("speedl", "stopl") if is_tool else ("speedj", "stopj")
    hardness = number(acceleration, "acceleration")
    most_missed = missable(watchdog, firmware.rate)
    if takes_duration(firmware):
        go_on = f"{function}(speeds, {hardness}, {number(1.0 / firmware.rate)})"
    else:
        # The call takes a cycle or none, so that two cycles are the longest that a round can take at a steady speed.
        go_on = f"{function}(speeds, {hardness})\nsync()"
        most_missed = max(most_missed // 2, 2)
    start = "speeds = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\nmissed = 0"
    received = f"speeds = goal\nmissed = 0\n{go_on}"
    end = f"{brake}({hardness})"
    return message_loop(firmware, link, start, received, go_on, end, watchdog=watchdog, most_missed=most_missed)
