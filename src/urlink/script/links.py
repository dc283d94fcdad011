"""The programs that this computer drives cycle by cycle: how messages reach them, and the loop that obeys them.

A message is fourteen big-endian int32: six numbers in millionths (`SCALE`), six more, what to do: `STOP`, `FOLLOW` or
`WAIT`, and a date. In `urlink.script.streaming` the numbers are positions of the joints, rad, and their speeds,
rad/s. After the n-th pause of the program, `WAIT` + n stands for `FOLLOW`: a program that finds the arm elsewhere after
a pause follows no message from before it.

The date is the cycle of the controller's clock in which the state was sent that the message answers, counted from the
first state of the motion. URScript cannot read that clock on every firmware, so the program counts its own cycles, and
keeps the smallest difference between its count and a date: that of the message that came quickest. A set-point whose
difference exceeds it by more than the watchdog's cycles counts as none. So set-points that waited in the socket while
the controller hung are followed for one watchdog time at most. A round of the loop takes one cycle at least, so the
program counts no faster than the controller's clock, and messages do not grow old by counting.

Over a `ReverseSocket` the program connects back to this computer, as those of public drivers do, and sends a token that
only its text holds: another peer that finds the port must not be taken for the robot. The answer of
``socket_read_binary_integer`` begins with the count that was read, which is less than fourteen after two seconds
without a message, or once the connection is lost. Over `InputRegisters` the program waits for the token instead.

Assignments in a thread or a nested function reach the variables of the program around them, as the programs of public
drivers rely on; nothing here needs ``global`` or ``local``, which the oldest firmware may not have. Lists are
written out element by element, since arithmetic on whole lists came late.

Why such a program ended before its time is in its last ``textmsg``: `NO_CONNECTION`, `LINK_ENDED`, `STARVED`,
`TOO_FAR`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from ..protocol.firmware import Firmware
from .text import each, indented, integer, lines, number, quoted

#: How many tokens there are: what a signed 32-bit integer holds.
TOKENS = 1 << 31
#: Factor between rad or rad/s and the integers of a message.
SCALE = 1_000_000
#: The last number but one: brake and end, go to this set-point, or do nothing yet.
STOP, FOLLOW, WAIT = 0, 1, 2

NO_CONNECTION = "urlink: cannot connect"
LINK_ENDED = "urlink: the link ended"
STARVED = "urlink: nothing to go to"
TOO_FAR = "urlink: the first point is too far away"

#: What brakes an arm whose program ends, with 4 rad/s².
BRAKE = "stopj(4.0)"
#: Seconds for which a program waits for the first message in its registers.
_LINK_TIMEOUT = 5.0


class ReverseSocket(NamedTuple):
    """A connection that the program makes back to this computer.

    Attributes:
        host, port: where it reaches this computer.
        token: by which the program proves to be the expected one.
    """

    host: str
    port: int
    token: int


class InputRegisters(NamedTuple):
    """Input registers that this computer writes by RTDE: nothing has to be reached from the robot.

    Set-points are in twelve floating point registers: positions, rad, and speeds, rad/s. Four integer registers hold
    the date; the number of the message, by which a new one is known; what to do; and the token. That a program sees all
    inputs of one RTDE package in the same cycle is what public clients with such programs rely on.

    Attributes:
        first_float, first_integer: number of the first register of each kind.
        token: what is in its register as long as this program's messages are: registers keep what others wrote.
    """

    first_float: int
    first_integer: int
    token: int

    @property
    def date(self) -> int:
        """The register that holds the date."""
        return self.first_integer

    @property
    def message(self) -> int:
        """The register that numbers the messages."""
        return self.first_integer + 1

    @property
    def mode(self) -> int:
        """The register that says what to do."""
        return self.first_integer + 2

    @property
    def proof(self) -> int:
        """The register that holds the token."""
        return self.first_integer + 3


#: Makes the lines of a program, for the link by which its messages come.
Writer = Callable[[ReverseSocket | InputRegisters], list[str]]


def message_loop(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    start: str,
    received: str,
    late: str,
    end: str,
    *,
    watchdog: float,
    most_missed: int,
    guard: str = "",
) -> list[str]:
    """A program that does something in each cycle, by the messages that come over a link.

    Args:
        link: how they come.
        start: what it does first; it sets ``missed`` to 0.
        received: for a new message that is not too old, whose numbers are ``goal`` and ``speed``; it sets ``missed`` to
            0, and takes a cycle.
        late: for the cycle ``missed`` without a message; it takes a cycle.
        end: what it does last, also when no message has come for longer.
        watchdog: seconds without a message after which the program ends.
        most_missed: rounds without one in these seconds, after which it says `STARVED` and ends; and rounds by which a
            message may be older than the one that came quickest.
        guard: for each round; where it sets ``held`` to True, messages from before the next pause count as none.
    """
    if isinstance(link, ReverseSocket):
        # Reading waits, so a thread of its own moves the arm.
        kind, shared, take, follow = "thread", _SHARED, _TAKE_SHARED, _over_socket(link, firmware, watchdog)
    else:
        kind, shared, take, follow = (
            "def",
            _SEEN,
            _take_registers(link),
            over_registers(link.proof, link.message, link.token, "servo()", firmware, watchdog),
        )
    holding = f"""
{guard}
        if held:
          if wanted == followed:
            is_new = False
          elif is_new:
            held = False
          end
        end
        if is_new:
          followed = wanted
        end
    """
    text = f"""
{indented(shared)}
        held = False
        followed = {WAIT}
        starved = False
        cycle = 0
        quickest = {SLOWEST}
        {kind} servo():
{indented(start, 10)}
          going = True
          while going:
            cycle = cycle + 1
{indented(take, 12)}
            if is_new:
              is_new = cycle - date - quickest <= {most_missed}
            end
{indented(holding if guard else "", 12)}
            if wanted == {STOP}:
              going = False
            elif wanted == {WAIT}:
              sync()
            elif is_new:
{indented(received, 14)}
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


#: More than the difference between a count of cycles and a date can be at first.
SLOWEST = 1_000_000_000
#: Numbers of a message.
_MESSAGE = 14
#: Seconds for which a read waits for one.
_READ = 2.0
#: The variables by which the thread that reads the socket hands messages to the one that moves the arm.
_SHARED = f"""
    target = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    target_speed = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    date_told = 0
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
    date = date_told
    exit_critical
"""


def _over_socket(link: ReverseSocket, firmware: Firmware, watchdog: float) -> str:
    """Connect, and hand over what comes until the link ends.

    A read that has waited for `_READ` s is tried again until the watchdog's time is over. One that returns sooner
    without a message finds the connection closed: so it is in the simulator. How soon a real controller returns then is
    not known; if it takes as long, the program ends by its watchdog.
    """
    most_silent, waited = int(watchdog / _READ) + 1, round(firmware.rate * _READ / 2)
    return f"""
        if socket_open({quoted(link.host)}, {integer(link.port, 1, 65535)}):
          {introduction(link.token)}
          servo_thread = run servo()
          reading = True
          silent = 0
          while reading:
            since = cycle
            message = socket_read_binary_integer({_MESSAGE})
            if message[0] < {_MESSAGE}:
              silent = silent + 1
              if starved or silent >= {most_silent} or cycle - since < {waited}:
                if not starved:
                  textmsg({quoted(LINK_ENDED)})
                end
                reading = False
              end
            elif starved:
              reading = False
            elif message[13] == {STOP}:
              reading = False
            else:
              silent = 0
              date_read = message[14]
{indented(keep_quickest("date_read"), 14)}
              if not (message[13] == {WAIT}):
                goal_read = [{each("message[{n}] / " + number(SCALE))}]
                speed_read = [{each("message[{way}] / " + number(SCALE), [str(7 + i) for i in range(6)])}]
                enter_critical
                target = goal_read
                target_speed = speed_read
                date_told = date_read
                fresh = True
                mode = message[13]
                exit_critical
              end
            end
          end
          mode = {STOP}
          join servo_thread
          socket_close()
        else:
          textmsg({quoted(NO_CONNECTION)})
        end
    """


#: The number of the last message; they are counted from 1, so the one that comes with the token is new.
_SEEN = "seen = 0"


def _take_registers(link: InputRegisters) -> str:
    """The newest message, and whether it is a new one."""
    return f"""
        wanted = read_input_integer_register({link.mode})
        number = read_input_integer_register({link.message})
        is_new = number != seen
        seen = number
        date = read_input_integer_register({link.date})
        if is_new:
{indented(keep_quickest("date"), 10)}
        end
        goal = [{each("read_input_float_register({way})", [str(link.first_float + i) for i in range(6)])}]
        speed = [{each("read_input_float_register({way})", [str(link.first_float + 6 + i) for i in range(6)])}]
    """


def over_registers(at: int, message: int, token: int, follow: str, firmware: Firmware, watchdog: float) -> str:
    """Wait for the token, for a bounded time, and follow what the registers say.

    The controller's own watchdog over the registers ends the program where this one cannot: it is given a second more,
    in which an arm has braked.

    Args:
        at: the register that holds the token.
        message: the one that numbers the messages.
        follow: the call that follows them.
    """
    proof = f"read_input_integer_register({at})"
    variable = quoted(f"input_int_register_{message}")
    return f"""
        cycles = 0
        while cycles < {round(_LINK_TIMEOUT * firmware.rate)} and {proof} != {integer(token, 1, TOKENS - 1)}:
          cycles = cycles + 1
          sync()
        end
        if {proof} == {token}:
          rtde_set_watchdog({variable}, {number(1.0 / (watchdog + 1.0))}, "stop")
          {follow}
        else:
          textmsg({quoted(NO_CONNECTION)})
        end
    """


def keep_quickest(date: str) -> str:
    """Keep the difference of the message that came quickest; messages without a set-point count too."""
    return f"""
        behind = cycle - {date}
        if behind < quickest:
          quickest = behind
        end
    """


def missable(watchdog: float, rate: int) -> int:
    """Cycles without a set-point after which the streaming program brakes: `watchdog` seconds, and two at least."""
    return max(math.ceil(watchdog * rate), 2)


def introduction(token: int) -> str:
    """The statement that sends the token: four bytes, the highest first."""
    return f"socket_send_int({integer(token, 0, TOKENS - 1)})"
