"""The program that buffers points of a stream, moves through them on its own, and brakes when the buffer is empty.

It needs firmware 3.4 or later. A message consists of twenty-four big-endian int32:

- the command (`STOP`, `POINT`, `WAIT` or `CUT`), the epoch, and a number;
- the length of the step to the point in microseconds, and the degree of the curve of the step;
- six positions in `FINE` parts of a rad, six speeds and six accelerations in millionths;
- the date, see `urlink.script.links`.

Points are counted from 1. A step ends at the point with its number. It begins with the position, speed and acceleration
at the end of the previous step. A step of degree 1 is straight. A step of degree 3 or 5 is the polynomial that its end
prescribes. Accelerations jump where cubics meet, so a step of degree 3 ends without an acceleration. A step of degree 4
is the beginning of a cubic, and its end keeps the acceleration.

The number in a `WAIT` is the pace, in millionths: the seconds of the steps that pass in one second of the program. The
pace is less than 1 if other arms are slower. It is 0 if the arm must wait on its path until they are ready. The program
changes its pace gradually. At rest the new pace applies immediately. While the arm brakes, the pace returns to 1. If
the program must end, the arm brakes from its current speed.

A `CUT` replaces the path after a place that the arm has not passed. The step after the point with its number is cut to
the given time, and its end is the next point. A `CUT` opens an epoch, and points of other epochs are rejected. If the
arm has passed that place, the whole epoch is rejected, and the arm continues as if no message had arrived.

After the last point, and when the program must end, all joints brake together, from any speed v and acceleration a: in
T seconds, the speed falls to zero on the cubic with the slopes a and 0. No joint exceeds an acceleration A, which |a|
must not exceed, if T is at least 1.5 sqrt(2) |v| / A. No joint exceeds a jerk J if 6 |v| / T² + 4 |a| / T is at most J.
However, the acceleration alone moves a joint by a T² / 12, which must stay below `STRAY`. Then the epoch is closed. A
`CUT` opens the next epoch, either during braking or at rest. The epoch is also closed if the arm is found at rest in
another place after a pause; the arm then stays there.

The program reports after each `CUT`, after each change of its phase, and every fiftieth of a second. A report consists
of six int32: the number of messages read, the last accepted epoch, the number of the last buffered point, the number of
the point where the current step began, the microseconds since then, and the phase.

With `PointRegisters`, a message is in input registers, which contain the same numbers. `messages` is then the number of
the last message that was read. A register holds only the newest value, so a missed point counts as a rejected point. A
`CUT` is written until it is answered, and a `CUT` for an epoch that was already accepted is not accepted again. The
report is written to output registers in each cycle.
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

#: Numbers in a message without its date, and in a report.
MESSAGE, REPORTED = 23, 6
#: Commands in addition to `STOP` and `WAIT`: buffer a point, or replace the path after a place.
POINT, CUT = 1, 3
#: Phases: at rest with the epoch closed, moving through points, braking, and at rest with an epoch open.
RESTING, MOVING, BRAKING, OPEN = 0, 1, 2, 3
#: Parts of a rad. Chosen: as fine as 32 bits allow for three turns. Points might be a few milliseconds apart, where one
#: part of a microradian would be a jolt of several rad/s².
FINE = 100_000_000
#: Braking time T that keeps every acceleration within A, divided by |v| / A.
BRAKING_FACTOR = 1.5 * 2.0**0.5
#: Distance, in rad, that an acceleration may move a joint beyond the last point. If the stream's jerk would allow more,
#: the joint brakes with more jerk.
STRAY = 0.05
#: Maximum rate of change of the pace, in 1/s of the program. Chosen: four times the rate at which the sent pace changes
#: (`urlink.command.program_time.RAMP`) without scaling, because a slider of 50 % requires it.
PACING = 25.0
#: Interval between two reports, in seconds.
_REPORTING = 0.02
#: Time, in seconds, that the controller's own watchdog allows for braking, in addition to its usual second.
_BRAKES = 2.0
#: Largest allowed distance, in rad, between the arm and the beginning of the stream.
_NEAR = 0.05
#: Names of the lists that buffer points, one for each of their eighteen numbers.
_KEPT = [f"kept_{quantity}{joint}" for quantity in "qva" for joint in range(6)]
#: Position on the current step, `t` s after its beginning.
_PLACE = "c0[{i}] + t * (c1[{i}] + t * (c2[{i}] + t * (c3[{i}] + t * (c4[{i}] + t * c5[{i}]))))"
_SPEED = "c1[{i}] + t * (2.0 * c2[{i}] + t * (3.0 * c3[{i}] + t * (4.0 * c4[{i}] + t * 5.0 * c5[{i}])))"
_ACCELERATION = "2.0 * c2[{i}] + t * (6.0 * c3[{i}] + t * (12.0 * c4[{i}] + t * 20.0 * c5[{i}]))"
_REST = "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"


class PointRegisters(NamedTuple):
    """Registers that hold a message, and registers for the report of the program.

    Fourteen integer registers hold the first five numbers of a message, the six positions, the date, the number of the
    message, and the token. Twelve floating point registers hold the speeds and accelerations, also in millionths. The
    seventh output register holds the token, which shows that the other output registers belong to this program.

    Attributes:
        first_float, first_integer: Number of the first input register of each kind.
        first_output: Number of the first output register.
        token: Value of the token register while the messages belong to this program.
    """

    first_float: int
    first_integer: int
    first_output: int
    token: int

    @property
    def date(self) -> int:
        """Number of the register with the date."""
        return self.first_integer + 11

    @property
    def message(self) -> int:
        """Number of the register with the message number."""
        return self.first_integer + 12

    @property
    def proof(self) -> int:
        """Number of the register with the token."""
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
    """Return a program that buffers points, moves through them, and brakes when the buffer is empty.

    Args:
        link: Link that carries the messages.
        capacity: Maximum number of buffered points.
        acceleration, jerk: Limits for braking the joints, shape (6,), in rad/s² and rad/s³.
        watchdog: Maximum time without a message, in seconds; then the program brakes and ends.
        lookahead_time, gain: Parameters of ``servoj``.
    """
    period, change = number(1.0 / firmware.rate), number(PACING / firmware.rate)
    most_missed = missable(watchdog, firmware.rate)
    # Reading blocks, and a scaled servoj takes several cycles, so a separate thread moves the arm.
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
    """Return code that connects and handles messages until the link ends."""
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
    """Return code that handles a new message in each cycle, and reports."""
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
    """Return code that computes the commanded position of each cycle.

    `at_q`, `at_v` and `at_a` are the position, speed and acceleration at the end of a step.

    Args:
        period: Duration of a cycle, in s.
        change: Maximum change of the pace in a cycle.
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
    """Return the functions that handle messages; each is called in a critical section.

    Args:
        rates: Expression for the speeds and accelerations of a message.
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
