"""Programs that follow a stream of messages: set-points, one for each cycle of the controller, or jogging speeds.

The messages are the same, but jogging sends speeds in place of positions. If no message arrives, the arm brakes.
"""

from __future__ import annotations

from collections.abc import Sequence

from linkcore.arguments import check_number

from ..protocol.firmware import Firmware
from .commands import takes_duration
from .links import BRAKE, InputRegisters, ReverseSocket, message_loop, missable
from .text import each, indented, lines, number

#: Maximum time, in seconds, that the streaming program continues without a set-point, even if its watchdog is longer.
#: Chosen: the default watchdog. With a longer time, a computer that is too busy would drive the arm far past the end of
#: a movement.
COASTING = 0.1
#: Maximum acceleration, in rad/s², to a set-point on CB2. Chosen: twice the limit that arms of that generation
#: report for their wrists, so that set-points in time are not changed. The simulated arm stops at three times as
#: much.
_HARDEST = 50.0
#: For all joints together: speed of an arm at rest, in rad/s, and distance that counts as another place, in rad.
_RESTING, _ELSEWHERE = 1e-4, 5e-4
#: Code that must precede the first `found_elsewhere`.
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
    """Follow set-points, one per cycle, and brake if none arrives.

    If a set-point is late, the arm continues at the speed of the last one and slows down steadily. It comes to rest
    after `coasting` seconds, or after the watchdog's time if that is shorter. The speed is part of the message rather
    than the difference of the last two positions. If set-points arrive only every tenth cycle, such a difference mostly
    contains the program's own extrapolation, and the arm would continue in an outdated direction.

    No set-point is followed faster than the joints can move: a distant set-point is approached at their largest speed.
    Therefore the arm does not jump, whatever goes wrong during transmission. If the arm is found at rest in another
    place than in the previous round, the program was paused. The arm stays there until a set-point arrives that was
    sent after the pause, so that older set-points do not drive it back. On CB2, where ``servoj`` does not smooth, the
    change of speed is limited too.

    Args:
        link: Link that carries the set-points.
        speeds: Largest speed of each joint, shape (6,), in rad/s.
        watchdog: Maximum time without a set-point, in seconds; then the program brakes.
        coasting: Time without a set-point, in seconds, until the arm is at rest.
        lookahead_time, gain: Parameters of ``servoj``, if the firmware has them.
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
        # The first set-point might be one of several that arrive at once.
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
    """Return code that limits the movement of a joint in a cycle, because ``servoj`` has no look-ahead before 3.0.

    The joint moves to the set-point if the speed changes by no more than `_HARDEST` permits. Otherwise it moves as fast
    as it can while still being able to brake at the set-point, in addition to the speed of the set-point itself.
    Without this, several set-points that arrive at once would be one jump. This happens if this computer and the
    controller were both delayed.
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
    """Return code that sets ``elsewhere``: whether the arm, ``here``, is at rest at a new place.

    The place is new if the arm has moved further since the previous round than its speed at that time explains. Only a
    pause explains this: the controller has braked the arm, and a person might have moved it.
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
    """Return one cycle of ``servoj`` to `q`.

    Before 3.0, ``servoj`` has neither lookahead nor gain (docs/protocols/urscript.md, Differences).
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
    """Move at the speeds of the newest message, and brake if none has arrived for some time.

    ``speedj`` and ``speedl`` are called again in each cycle, with the time of one cycle, as public drivers do. The arm
    therefore changes from one speed to the next with `acceleration`.

    Args:
        link: Link that carries the messages.
        is_tool: Whether the speeds are of the tool in the base frame, in m/s and rad/s; otherwise of the joints, in
            rad/s.
        acceleration: Acceleration in m/s² or rad/s².
        watchdog: Maximum time without a message, in seconds; then the program brakes.
    """
    function, brake = ("speedl", "stopl") if is_tool else ("speedj", "stopj")
    hardness = number(acceleration, "acceleration")
    most_missed = missable(watchdog, firmware.rate)
    if takes_duration(firmware):
        go_on = f"{function}(speeds, {hardness}, {number(1.0 / firmware.rate)})"
    else:
        # The call takes one cycle or none, so at a steady speed a round takes at most two cycles.
        go_on = f"{function}(speeds, {hardness})\nsync()"
        most_missed = max(most_missed // 2, 2)
    start = "speeds = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\nmissed = 0"
    received = f"speeds = goal\nmissed = 0\n{go_on}"
    end = f"{brake}({hardness})"
    return message_loop(firmware, link, start, received, go_on, end, watchdog=watchdog, most_missed=most_missed)
