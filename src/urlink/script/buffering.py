"""The program that holds points of a stream in a buffer, moves through them by itself, and brakes where none is left.

From 3.4 on. A message is twenty-four big-endian int32: what to do (`STOP`, `POINT`, `WAIT` or `CUT`), the epoch, a
number, the microseconds of the step to the point, the degree of the curve that leads there, six positions in `FINE`
parts of a rad, six speeds and six accelerations in millionths, and the date of `urlink.script.links`. Points are
counted from 1; a step ends at the point of its number, and begins with the position, speed and acceleration in which
the step before ends. A step of degree 1 is straight, one of degree 3 or 5 is the polynomial that its end prescribes.
Accelerations leap where cubics meet, so one of degree 3 ends without; one of degree 4 is the beginning of a cubic, and
its end keeps the acceleration.

A `WAIT` brings the pace, in millionths, as its number: the seconds on the steps that pass in one of the program. That
is less than 1 where other arms are slower, and 0 where the arm is to stand on its way until they are ready. It is
approached evenly. At rest it holds at once; while the arm brakes it goes back to 1. Where the program is to end, the
arm brakes from the speed that it has.

A `CUT` replaces what comes after a place that the arm has not passed: the step after the point of its number is cut to
the time that is given, and its end is the next point. It opens an epoch, and points of other epochs are refused. If the
arm has passed that place, the whole epoch is refused, and the arm goes on as if nothing had come.

After the last point, and where the program is to end, all joints brake together, from any speed v and acceleration a:
in T seconds the speed goes to zero on the cubic with the slopes a and 0. No joint exceeds an acceleration A, which |a|
must not exceed, if T is at least 1.5 sqrt(2) |v| / A; nor a jerk J if 6 |v| / T² + 4 |a| / T is at most J. But an
acceleration alone leads a joint by a T² / 12, which is to stay below `STRAY`. Then the
epoch is closed, and a `CUT` opens the next, within the braking or at rest. So it is where the arm is found at rest
elsewhere, after a pause: it stays there.

After each `CUT`, each change of its phase, and every fiftieth of a second it reports, six int32: messages that were
read, the last epoch taken, the number of the last point it holds, that of the point at which its step began, the
microseconds since, and its phase.

Over `PointRegisters` a message is in input registers, whose numbers are those of the message; `messages` is the number
of the last that was seen, since a register holds the newest only: a point that was missed is one that was refused. A
`CUT` is written until it is answered, and one of an epoch that is taken already is not taken again. The report is in
output registers, anew in each cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from ..protocol.firmware import Firmware
from .links import (
    BRAKE,
    LINK_ENDED,
    NO_CONNECTION,
    SCALE,
    SLOWEST,
    STARVED,
    STOP,
    TOO_FAR,
    WAIT,
    ReverseSocket,
    introduction,
    keep_quickest,
    missable,
    over_registers,
)
from .streaming import LAST_PLACE, found_elsewhere, servo_cycle
from .text import each, indented, integer, lines, number, quoted, vector

#: Numbers of a message without its date, and of a report.
MESSAGE, REPORTED = 23, 6
#: What to do, beside `STOP` and `WAIT`: keep a point, or replace what comes after a place.
POINT, CUT = 1, 3
#: Phases: at rest and closed, on its way through points, braking, and at rest with an epoch open.
RESTING, MOVING, BRAKING, OPEN = 0, 1, 2, 3
#: Parts of a rad. Chosen: as fine as 32 bits allow for three turns, because points may be a few milliseconds apart, and
#: a part of a microradian would then be a jolt of some rad/s².
FINE = 100_000_000
#: T >= this times |v| / A keeps every acceleration within A.
BRAKING_FACTOR = 1.5 * 2.0**0.5
#: rad that an acceleration may lead a joint beyond the last point: where the jerk of the stream would let it be more,
#: the joint brakes with more jerk.
STRAY = 0.05
#: 1/s, of the program, with which the pace changes at most. Chosen: four times as fast as it is sent
#: (`urlink.command.program_time.RAMP`) while nothing is scaled, because at a slider of 50 % it has to be.
PACING = 25.0
#: Seconds between two reports.
_REPORTING = 0.02
#: Seconds that the controller's own watchdog leaves to braking, beside the second that it has for that anyway.
_BRAKES = 2.0
#: rad between the place where the arm is and the one from which the stream is to begin.
_NEAR = 0.05
#: Names of the lists in which points are held, one for each of their eighteen numbers.
_KEPT = [f"kept_{quantity}{joint}" for quantity in "qva" for joint in range(6)]
#: The position on the present step, `t` s after its beginning.
_PLACE = "c0[{i}] + t * (c1[{i}] + t * (c2[{i}] + t * (c3[{i}] + t * (c4[{i}] + t * c5[{i}]))))"
_SPEED = "c1[{i}] + t * (2.0 * c2[{i}] + t * (3.0 * c3[{i}] + t * (4.0 * c4[{i}] + t * 5.0 * c5[{i}])))"
_ACCELERATION = "2.0 * c2[{i}] + t * (6.0 * c3[{i}] + t * (12.0 * c4[{i}] + t * 20.0 * c5[{i}]))"
_REST = "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"


class PointRegisters(NamedTuple):
    """Registers that hold a message, and those in which the program reports.

    Fourteen integer registers hold the first five numbers of a message, the six positions, the date, the number of the
    message and the token; twelve floating point registers the speeds and accelerations, in millionths too. Of the
    output registers, the seventh holds the token: what is in the others is this program's.

    Attributes:
        first_float, first_integer: number of the first input register of each kind.
        first_output: of the first output register.
        token: what is in its register as long as this program's messages are.
    """

    first_float: int
    first_integer: int
    first_output: int
    token: int

    @property
    def date(self) -> int:
        """The register that holds the date."""
        return self.first_integer + 11

    @property
    def message(self) -> int:
        """The register that numbers the messages."""
        return self.first_integer + 12

    @property
    def proof(self) -> int:
        """The register that holds the token."""
        return self.first_integer + 13


def buffering(
    firmware: Firmware,
    link: ReverseSocket | PointRegisters,
    *,
    capacity: int,
    acceleration: Sequence[float],
    jerk: Sequence[float],
    watchdog: float,
    lookahead_time: float = 0.03,
    gain: float = 300.0,
) -> list[str]:
    """Hold points, move through them, and brake where none is left.

    Args:
        link: how the messages come.
        capacity: points that it holds.
        acceleration, jerk: (6,) rad/s² and rad/s³ with which the joints brake.
        watchdog: seconds without a message after which it brakes and ends.
        lookahead_time, gain: of ``servoj``.
    """
    period, change = number(1.0 / firmware.rate), number(PACING / firmware.rate)
    most_missed = missable(watchdog, firmware.rate)
    # Reading waits, and a scaled servoj takes several cycles, so a thread of its own moves the arm.
    if isinstance(link, ReverseSocket):
        rates, follow = "message[12 + {at}]", _over_socket(firmware, link, most_missed)
    else:
        rates, follow = "rates[{at}]", _over_registers(firmware, link, most_missed, watchdog)
    text = f"""
{indented(_variables(capacity, acceleration, jerk))}
{indented(_geometry(period, change))}
{indented(_messages(capacity, rates))}
        thread play():
          going = True
          while going:
{indented(found_elsewhere(firmware), 12)}
            enter_critical
            if is_known and elsewhere:
              at_q = here
              head = base
              phase = {RESTING}
            end
            cycle = cycle + 1
            missed = missed + 1
            if missed > {most_missed}:
              starved = True
            end
            if leaving or starved:
              if phase == {MOVING}:
                degree = 5
                reach(passed)
                at_v = [{each("at_v[{i}] * pace")}]
                at_a = [{each("at_a[{i}] * pace * pace")}]
                pace = 1.0
                head = base
                brake()
                passed = 0.0
              elif phase == {OPEN}:
                phase = {RESTING}
              end
            end
            depart()
            keep_pace()
            advance()
            is_over = (leaving or starved) and phase == {RESTING}
            exit_critical
            if is_over:
              going = False
            elif is_known:
              q = goal
              {servo_cycle(firmware, lookahead_time, gain)}
            else:
              sync()
            end
          end
          if starved and not leaving:
            textmsg({quoted(STARVED)})
          end
          {BRAKE}
        end
{indented(follow)}
    """
    assert WAIT not in (POINT, CUT, STOP)
    return lines(text)


def _over_socket(firmware: Firmware, link: ReverseSocket, most_missed: int) -> str:
    """Connect, and hand over what comes until the link ends."""
    cycles = max(round(_REPORTING * firmware.rate), 1)
    return f"""
        if socket_open({quoted(link.host)}, {integer(link.port, 1, 65535)}):
          {introduction(link.token)}
          play_thread = run play()
          reading = True
          reported = {RESTING}
          unreported = 0
          while reading:
            message = socket_read_binary_integer({MESSAGE + 1})
            if message[0] < {MESSAGE + 1}:
              if not starved:
                textmsg({quoted(LINK_ENDED)})
              end
              reading = False
            elif starved or message[1] == {STOP}:
              reading = False
            else:
              enter_critical
{indented(keep_quickest(f"message[{MESSAGE + 1}]"), 14)}
              messages = messages + 1
              if behind - quickest <= {most_missed}:
                missed = 0
                if message[1] == {POINT}:
                  keep()
                elif message[1] == {CUT}:
                  cut()
                elif message[1] == {WAIT}:
                  pace_sent = message[3] / {SCALE}.0
                end
              end
              report = [messages, taken, head, base, floor(passed * {SCALE}.0), phase]
              exit_critical
              unreported = unreported + 1
              if message[1] == {CUT} or report[5] != reported or unreported >= {cycles}:
                sent = 0
                while sent < {REPORTED}:
                  socket_send_int(report[sent])
                  sent = sent + 1
                end
                reported = report[5]
                unreported = 0
              end
              if is_far:
                textmsg({quoted(TOO_FAR)})
                reading = False
              end
            end
          end
          leaving = True
          join play_thread
          socket_close()
        else:
          textmsg({quoted(NO_CONNECTION)})
        end
    """


def _over_registers(firmware: Firmware, link: PointRegisters, most_missed: int, watchdog: float) -> str:
    """Take what is new in each cycle, and report."""
    whole = [f"read_input_integer_register({at})" for at in range(link.first_integer, link.date)]
    parts = [f"read_input_float_register({at})" for at in range(link.first_float, link.first_float + 12)]
    report = [*("messages", "taken", "head", "base", f"floor(passed * {SCALE}.0)", "phase"), str(link.token)]
    reports = "\n".join(
        f"            write_output_integer_register({link.first_output + at}, {value})"
        for at, value in enumerate(report)
    )
    return f"""
        message = [{", ".join(["0"] * 12)}]
        rates = [{", ".join(["0.0"] * 12)}]
        def listen():
          play_thread = run play()
          reading = True
          while reading:
            enter_critical
            seen = read_input_integer_register({link.message})
            if read_input_integer_register({link.proof}) == {link.token} and seen != messages:
              messages = seen
              message = [{MESSAGE}, {", ".join(whole)}]
              rates = [{", ".join(parts)}]
{indented(keep_quickest(f"read_input_integer_register({link.date})"), 14)}
              if message[1] == {STOP}:
                reading = False
              elif behind - quickest <= {most_missed}:
                missed = 0
                if message[1] == {POINT}:
                  keep()
                elif message[1] == {CUT} and message[2] != taken:
                  cut()
                elif message[1] == {WAIT}:
                  pace_sent = message[3] / {SCALE}.0
                end
              end
            end
{reports}
            exit_critical
            if is_far:
              textmsg({quoted(TOO_FAR)})
              reading = False
            elif starved:
              reading = False
            end
            sync()
          end
          leaving = True
          join play_thread
        end
{indented(over_registers(link.proof, link.message, link.token, "listen()", firmware, watchdog + _BRAKES))}
    """


def _variables(capacity: int, acceleration: Sequence[float], jerk: Sequence[float]) -> str:
    empty = "[" + ", ".join(["0.0"] * capacity) + "]"
    kept = "\n".join(f"        {name} = {empty}" for name in (*_KEPT, "kept_length"))
    coefficients = "\n".join(f"        c{power} = {_REST}" for power in range(6))
    return f"""
{kept}
        kept_degree = [{", ".join(["0"] * capacity)}]
{coefficients}
        at_q = {_REST}
        at_v = {_REST}
        at_a = {_REST}
        goal = {_REST}
        hardest = {vector(acceleration)}
        sharpest = {vector(jerk)}
        degree = 5
        first = 0
        head = 0
        base = 0
        taken = 0
        phase = {RESTING}
        length = 0.0
        passed = 0.0
        pace = 1.0
        pace_sent = 1.0
        messages = 0
        missed = 0
        cycle = 0
        quickest = {SLOWEST}
        starved = False
        leaving = False
{indented(LAST_PLACE)}
        is_known = False
        is_far = False
    """


def _geometry(period: str, change: str) -> str:
    """Where the arm is to be, cycle by cycle: `at_q`, `at_v` and `at_a` are those at the end of a step.

    Args:
        period: s of a cycle.
        change: of the pace in a cycle.
    """
    way = "(kept_q{i}[first] - at_q[{i}]) / h"
    v0, v1, a0, a1 = "at_v[{i}]", "kept_v{i}[first]", "at_a[{i}]", "kept_a{i}[first]"
    cubic_2 = f"(3.0 * ({way}) - 2.0 * {v0} - {v1}) / h"
    cubic_3 = f"({v0} + {v1} - 2.0 * ({way})) / (h * h)"
    quintic_3 = f"(10.0 * ({way}) - 6.0 * {v0} - 4.0 * {v1} + h * (0.5 * {a1} - 1.5 * {a0})) / (h * h)"
    quintic_4 = f"(8.0 * {v0} + 7.0 * {v1} - 15.0 * ({way}) + h * (1.5 * {a0} - {a1})) / (h * h * h)"
    quintic_5 = f"(6.0 * ({way}) - 3.0 * {v0} - 3.0 * {v1} + h * 0.5 * ({a1} - {a0})) / (h * h * h * h)"
    return f"""
        def reach(t):
          at_q = [{each(_PLACE)}]
          at_v = [{each(_SPEED)}]
          at_a = [{each(_ACCELERATION)}]
          if degree == 3:
            at_a = {_REST}
          end
        end
        def begin():
          h = kept_length[first]
          c0 = at_q
          c2 = {_REST}
          c3 = {_REST}
          c4 = {_REST}
          c5 = {_REST}
          if kept_degree[first] == 1:
            c1 = [{each(way)}]
          elif kept_degree[first] < 5:
            c1 = at_v
            c2 = [{each(cubic_2)}]
            c3 = [{each(cubic_3)}]
          else:
            c1 = at_v
            c2 = [{each("0.5 * at_a[{i}]")}]
            c3 = [{each(quintic_3)}]
            c4 = [{each(quintic_4)}]
            c5 = [{each(quintic_5)}]
          end
          degree = kept_degree[first]
          length = h
        end
        def brake():
          least = 0.0
          joint = 0
          while joint < 6:
            speed = at_v[joint]
            if speed < 0.0:
              speed = 0.0 - speed
            end
            hard = at_a[joint]
            if hard < 0.0:
              hard = 0.0 - hard
            end
            needed = {number(BRAKING_FACTOR)} * speed / hardest[joint]
            if needed > least:
              least = needed
            end
            needed = (2.0 * hard + sqrt(4.0 * hard * hard + 6.0 * sharpest[joint] * speed)) / sharpest[joint]
            if hard * needed * needed > {number(12.0 * STRAY)}:
              without = sqrt(6.0 * speed / sharpest[joint])
              needed = sqrt({number(12.0 * STRAY)} / hard)
              if without > needed:
                needed = without
              end
            end
            if needed > least:
              least = needed
            end
            joint = joint + 1
          end
          if least < {period}:
            phase = {RESTING}
          else:
            c0 = at_q
            c1 = at_v
            c2 = [{each("0.5 * at_a[{i}]")}]
            c3 = [{each("(0.0 - at_v[{i}] / least - 2.0 * at_a[{i}] / 3.0) / least")}]
            c4 = [{each("(0.5 * at_v[{i}] / least + 0.25 * at_a[{i}]) / (least * least)")}]
            c5 = {_REST}
            length = least
            degree = 5
            phase = {BRAKING}
          end
        end
        def depart():
          if phase == {OPEN} and head > base:
            begin()
            phase = {MOVING}
            passed = 0.0
            pace = pace_sent
          end
        end
        def keep_pace():
          wanted = pace_sent
          if phase == {BRAKING}:
            wanted = 1.0
          end
          if phase == {RESTING} or phase == {OPEN}:
            pace = wanted
          elif pace < wanted - {change}:
            pace = pace + {change}
          elif pace > wanted + {change}:
            pace = pace - {change}
          else:
            pace = wanted
          end
        end
        def advance():
          if phase == {MOVING} or phase == {BRAKING}:
            passed = passed + {period} * pace
            while (phase == {MOVING} or phase == {BRAKING}) and passed >= length:
              passed = passed - length
              reach(length)
              if phase == {BRAKING}:
                phase = {RESTING}
              else:
                base = base + 1
                first = after(first, 1)
                if head > base:
                  begin()
                else:
                  brake()
                end
              end
            end
          end
          if phase == {MOVING} or phase == {BRAKING}:
            t = passed
            goal = [{each(_PLACE)}]
          else:
            passed = 0.0
            at_v = {_REST}
            at_a = {_REST}
            goal = at_q
          end
        end
    """


def _messages(capacity: int, rates: str) -> str:
    """What is done with a message; each is called in a critical section.

    Args:
        rates: where its speeds and accelerations are.
    """
    places = [f"message[{at}] / {number(FINE)}" for at in range(6, 12)]
    places += [f"{rates.format(at=at)} / {number(SCALE)}" for at in range(12)]
    store = "\n".join(f"          {name}[slot] = {place}" for name, place in zip(_KEPT, places, strict=True))
    return f"""
        def after(slot, count):
          if slot + count < {capacity}:
            return slot + count
          end
          return slot + count - {capacity}
        end
        def store():
          slot = after(first, head - base)
{store}
          kept_length[slot] = message[4] / {SCALE}.0
          kept_degree[slot] = message[5]
          head = head + 1
        end
        def keep():
          if message[2] == taken and message[3] == head + 1 and head - base < {capacity}:
            if phase == {MOVING} or phase == {OPEN}:
              store()
            end
          end
        end
        def cut():
          depart()
          if phase == {RESTING} or phase == {OPEN}:
            if message[3] == base and message[4] == 0:
              if not is_known:
                at_q = [{each("message[{way}] / " + number(FINE), [str(6 + i) for i in range(6)])}]
                shown = get_actual_joint_positions()
                k = 0
                while k < 6:
                  if at_q[k] - shown[k] > {number(_NEAR)} or shown[k] - at_q[k] > {number(_NEAR)}:
                    is_far = True
                  end
                  k = k + 1
                end
                is_known = not is_far
                goal = at_q
              end
              base = base + 1
              first = after(first, 1)
              head = base
              taken = message[2]
              phase = {OPEN}
            end
          elif message[3] == base:
            if message[4] / {SCALE}.0 > passed:
              length = message[4] / {SCALE}.0
              if degree == 3:
                degree = 4
              end
              head = base + 1
              taken = message[2]
              phase = {MOVING}
            end
          elif phase == {MOVING} and message[3] > base and message[3] <= head and message[3] - base < {capacity}:
            head = message[3]
            store()
            taken = message[2]
          end
        end
    """
