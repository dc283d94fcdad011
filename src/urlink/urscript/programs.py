"""The programs that move an arm, as text: the lines within their ``def``, for the firmware that is to run them.

Assignments in a thread or a nested function reach the variables of the program around them, as the programs of public
drivers rely on; nothing here needs ``global`` or ``local``, which the oldest firmware may not have. Lists are
written out element by element, since arithmetic on whole lists came late.

Two of the programs open a socket back to this computer, as those of public drivers do: the one in
`urlink.urscript.waypoints`, and `streaming`. Both say first which program they are, by a token that only this text
holds, since whoever else finds the port must not be taken for the robot. Over registers (`InputRegisters`) it is the
other way round: the program waits for the token. Over its socket `streaming` then reads thirteen big-endian int32
per set-point: positions of the six joints in millionths of a rad, their speeds in millionths of a rad/s, and what to
do, one of `STOP`, `FOLLOW` and `WAIT`. The answer of ``socket_read_binary_integer`` begins with the count that was
read; after two seconds without anything, or once the link is gone, that is less than thirteen.

What ends such a program before its time it says with a ``textmsg``: `NO_CONNECTION`, `LINK_ENDED`, `STARVED`,
`TOO_FAR`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from textwrap import dedent, indent
from typing import NamedTuple

from ..firmware import Firmware
from .text import checked, integer, number, pose, quoted, vector

__all__ = [
    "COASTING",
    "FOLLOW",
    "LINK_ENDED",
    "NO_CONNECTION",
    "SCALE",
    "STARVED",
    "STOP",
    "TOKENS",
    "TOO_FAR",
    "WAIT",
    "InputRegisters",
    "ReverseSocket",
    "each",
    "indented",
    "interpreter_mode",
    "introduction",
    "lines",
    "missable",
    "move_circular",
    "move_joints",
    "move_linear",
    "segment",
    "segment_of",
    "servo_cycle",
    "speed_joints",
    "speed_linear",
    "stop",
    "streaming",
    "takes_duration",
    "word_loop",
]

#: How many tokens there are: what a signed 32-bit integer holds.
TOKENS = 1 << 31
#: What a set-point is multiplied by.
SCALE = 1_000_000
#: The last of the thirteen numbers: brake and end, go to this set-point, or do nothing yet.
STOP, FOLLOW, WAIT = 0, 1, 2

NO_CONNECTION = "urlink: cannot connect"
LINK_ENDED = "urlink: the link ended"
STARVED = "urlink: nothing to go to"
TOO_FAR = "urlink: the first point is too far away"
_SEGMENT = "urlink: segment "

#: Seconds for which the streaming program goes on by itself, whatever its watchdog lets it. Chosen: the default
#: watchdog. Longer, an arm would be led a good way past the end of a movement by a computer that is too busy.
COASTING = 0.1
#: rad/s² with which a set-point is approached at most on CB2. Chosen: twice what the arms of that generation report as
#: the limit of their wrists, so that what is sent in time is left as it is; a third of what the simulated one stops at.
_HARDEST = 50.0
#: Seconds for which a program waits for the first word in its registers.
_LINK_TIMEOUT = 5.0


# -- one command ---------------------------------------------------------------------------------------


def move_joints(
    q: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the joints to `q` (6, rad), at most so fast (rad/s, rad/s²), or in `time` seconds."""
    return [f"movej({vector(q, what='q')}, {_how(speed, acceleration, time, blend)})"]


def move_linear(
    target: Sequence[float], speed: float, acceleration: float, time: float | None = None, blend: float = 0.0
) -> list[str]:
    """Move the tool in a straight line to a pose (m, rad), at most so fast (m/s, m/s²), or in `time` seconds."""
    return [f"movel({pose(target)}, {_how(speed, acceleration, time, blend)})"]


def move_circular(
    via: Sequence[float], to: Sequence[float], speed: float, acceleration: float, blend: float = 0.0
) -> list[str]:
    """Move the tool along the circle through one pose to another (m, rad), at most so fast (m/s, m/s²)."""
    return [f"movec({pose(via, 'via')}, {pose(to, 'to')}, {_how(speed, acceleration, None, blend)})"]


def _how(speed: float, acceleration: float, time: float | None, blend: float) -> str:
    figures = f"a={number(acceleration, 'acceleration')}, v={number(speed, 'speed')}"
    if time is not None:
        figures += f", t={number(time, 'time')}"
    return f"{figures}, r={number(blend, 'blend')}" if blend else figures


def segment(index: int) -> str:
    """What a path says before its movement `index`; where the one before blends into it, as the blend begins.

    A `textmsg` takes no time. That it does not end a blend, as no statement does that takes none, is how the vendor's
    own programs look, which set outputs between blended waypoints.
    """
    return f"textmsg({quoted(f'{_SEGMENT}{index}')})"


def segment_of(text: str) -> int | None:
    """Which movement a line of text announces; None if it is another text."""
    found = re.fullmatch(rf"{_SEGMENT}(\d{{1,4}})", text)
    return int(found[1]) if found else None


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
    timed = [f"{function}({speeds}, {a}, {t})"]
    untimed = [f"{function}({speeds}, {a})", f"sleep({t})"]
    return [*(timed if takes_duration(firmware) else untimed), f"{brake}({a})"]


def takes_duration(firmware: Firmware) -> bool:
    """Whether ``speedj`` and ``speedl`` take a time.

    In 3.1 and 3.2 they do not: they return once the speed is reached, and keep it (docs/protocols/urscript.md,
    Differences).
    """
    return not (3, 1) <= firmware[:2] < (3, 3)


def interpreter_mode() -> list[str]:
    """Take statements of clients until one of them ends it."""
    return ["interpreter_mode()"]


def stop(acceleration: float) -> list[str]:
    """Brake all joints with so many rad/s²."""
    return [f"stopj({number(acceleration, 'acceleration')})"]


# -- programs that talk back -----------------------------------------------------------------------------


class ReverseSocket(NamedTuple):
    """A connection that the program makes back to this computer.

    Attributes:
        host, port: where it reaches this computer.
        token: by which it tells that it is the program that is waited for.
    """

    host: str
    port: int
    token: int


class InputRegisters(NamedTuple):
    """Input registers that this computer writes by RTDE: nothing has to be reached from the robot.

    Set-points are in twelve floating point registers: positions, rad, and speeds, rad/s. Three integer registers hold
    the number of the word, by which a new one is known; what to do; and the token. That a program sees all inputs of
    one RTDE package in the same cycle is what public clients with such programs rely on.

    Attributes:
        first_float, first_integer: number of the first register of each kind.
        token: what is in its register as long as this program's words are: registers keep what others wrote.
    """

    first_float: int
    first_integer: int
    token: int

    @property
    def word(self) -> int:
        """The register that numbers the words."""
        return self.first_integer

    @property
    def mode(self) -> int:
        """The register that says what to do."""
        return self.first_integer + 1

    @property
    def proof(self) -> int:
        """The register that holds the token."""
        return self.first_integer + 2


def streaming(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    *,
    speeds: Sequence[float],
    watchdog: float = 0.1,
    coasting: float = COASTING,
    lookahead_time: float = 0.1,
    gain: float = 300.0,
    deceleration: float = 4.0,
) -> list[str]:
    """Follow set-points, one per cycle, and brake where they stay away.

    While one is late the arm goes on at the speed that came with the last, ever slower, and rests after `coasting`
    seconds, or when the watchdog's time is up, if that is sooner. The speed is told, and not derived from the last two
    positions: where set-points come only every tenth cycle, a difference between positions holds mostly what the
    program itself went on by, and so it would go on in a direction that is not wanted any more. No set-point is
    followed faster than the joints can move: where it is further away, it is approached at their largest speed. So
    whatever goes wrong on the way, the arm does not leap. On CB2, where ``servoj`` does not smooth, the change of speed
    is bounded too.

    Args:
        link: how the set-points come.
        speeds: (6,) rad/s at most of each joint.
        watchdog: seconds without a set-point after which it brakes.
        coasting: seconds without one after which the arm has come to rest.
        lookahead_time, gain: of ``servoj``, where the firmware has them.
        deceleration: rad/s² with which it brakes.
    """
    servo = servo_cycle(firmware, lookahead_time, gain)
    most_missed = missable(watchdog, firmware.rate)
    most_coasted = missable(min(watchdog, coasting), firmware.rate)
    cycle = number(1.0 / firmware.rate)
    ways = [number(checked(speed, "speed", 1e-3) / firmware.rate) for speed in speeds]
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
    start = """
        q = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        aim = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        step = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        missed = 0
        begun = False
    """
    told = f"""
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
    end = f"stopj({number(deceleration)})"
    loop = word_loop(firmware, link, start, told, late, end, watchdog=watchdog, most_missed=most_missed)
    return [*lines(bounds), *loop]


def _eased(firmware: Firmware) -> str:
    """How far a joint goes in a cycle where nobody smooths set-points: before 3.0 ``servoj`` has no look-ahead.

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


def word_loop(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    start: str,
    told: str,
    late: str,
    end: str,
    *,
    watchdog: float,
    most_missed: int,
) -> list[str]:
    """A program that does something in each cycle, by the words that come over a link.

    Args:
        link: how they come.
        start: what it does first; it sets ``missed`` to 0.
        told: for a new word, whose numbers are ``goal`` and ``speed``; it sets ``missed`` to 0, and takes a cycle.
        late: for the cycle ``missed`` without a word; it takes a cycle.
        end: what it does last, also when no word has come for longer.
        watchdog: seconds without a word after which the program ends.
        most_missed: rounds without one in these seconds, after which it says `STARVED` and ends.
    """
    if isinstance(link, ReverseSocket):
        # Reading waits, so a thread of its own moves the arm.
        kind, shared, take, follow = "thread", _SHARED, _TAKE_SHARED, _over_socket(link)
    else:
        kind, shared, take, follow = "def", _SEEN, _take_registers(link), _over_registers(link, firmware, watchdog)
    text = f"""
{indented(shared)}
        starved = False
        {kind} servo():
{indented(start, 10)}
          going = True
          while going:
{indented(take, 12)}
            if wanted == {STOP}:
              going = False
            elif wanted == {WAIT}:
              sync()
            elif is_new:
{indented(told, 14)}
            elif missed < {most_missed}:
              missed = missed + 1
{indented(late, 14)}
            else:
              starved = True
              textmsg({quoted(STARVED)})
              going = False
            end
          end
{indented(end, 10)}
        end
{indented(follow)}
    """
    return lines(text)


#: What the thread that reads the socket hands over to the one that moves the arm.
_SHARED = f"""
    target = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    target_speed = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    mode = {WAIT}
    fresh = False
"""
_TAKE_SHARED = """
    enter_critical
    wanted = mode
    is_new = fresh
    fresh = False
    goal = target
    speed = target_speed
    exit_critical
"""


def _over_socket(link: ReverseSocket) -> str:
    """Connect, and hand over what comes until the link ends."""
    return f"""
        if socket_open({quoted(link.host)}, {integer(link.port, 1, 65535)}):
          {introduction(link.token)}
          servo_thread = run servo()
          reading = True
          while reading:
            word = socket_read_binary_integer(13)
            if word[0] < 13:
              if not starved:
                textmsg({quoted(LINK_ENDED)})
              end
              reading = False
            elif starved:
              reading = False
            elif word[13] == {FOLLOW}:
              goal_read = [{each("word[{n}] / " + number(SCALE))}]
              speed_read = [{each("word[{way}] / " + number(SCALE), [str(7 + i) for i in range(6)])}]
              enter_critical
              target = goal_read
              target_speed = speed_read
              fresh = True
              mode = {FOLLOW}
              exit_critical
            elif word[13] == {STOP}:
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


#: The number of the last word; they are counted from 1, so the one that comes with the token is new.
_SEEN = "seen = 0"


def _take_registers(link: InputRegisters) -> str:
    """The newest word, and whether it is a new one."""
    return f"""
        wanted = read_input_integer_register({link.mode})
        number = read_input_integer_register({link.word})
        is_new = number != seen
        seen = number
        goal = [{each("read_input_float_register({way})", [str(link.first_float + i) for i in range(6)])}]
        speed = [{each("read_input_float_register({way})", [str(link.first_float + 6 + i) for i in range(6)])}]
    """


def _over_registers(link: InputRegisters, firmware: Firmware, watchdog: float) -> str:
    """Wait for the token, for a bounded time, and follow what the registers say.

    The controller's own watchdog over the registers ends the program where this one cannot: it is given a second more,
    in which an arm has braked.
    """
    proof = f"read_input_integer_register({link.proof})"
    variable = quoted(f"input_int_register_{link.word}")
    return f"""
        cycles = 0
        while cycles < {round(_LINK_TIMEOUT * firmware.rate)} and {proof} != {integer(link.token, 1, TOKENS - 1)}:
          cycles = cycles + 1
          sync()
        end
        if {proof} == {link.token}:
          rtde_set_watchdog({variable}, {number(1.0 / (watchdog + 1.0))}, "stop")
          servo()
        else:
          textmsg({quoted(NO_CONNECTION)})
        end
    """


def indented(text: str, columns: int = 8) -> str:
    """The lines of a part of a program, where it is put into another text."""
    return indent("\n".join(lines(text)), " " * columns)


def missable(watchdog: float, rate: int) -> int:
    """Cycles without a set-point after which the streaming program brakes: `watchdog` seconds, and two at least."""
    return max(math.ceil(watchdog * rate), 2)


def introduction(token: int) -> str:
    """What a program says first over its connection: four bytes, the highest first."""
    return f"socket_send_int({integer(token, 0, TOKENS - 1)})"


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


def each(template: str, ways: Sequence[str] = ("",) * 6) -> str:
    """A list of six: `{i}` counts from 0, `{n}` from 1, `{q}` finds the position in an answer, `{way}` is of `ways`."""
    return ", ".join(template.format(i=i, n=i + 1, q=i + 2, way=way) for i, way in enumerate(ways))


def lines(text: str) -> list[str]:
    """The lines of a program that is indented as the module it stands in."""
    return [line.rstrip() for line in dedent(text).splitlines() if line.strip()]
