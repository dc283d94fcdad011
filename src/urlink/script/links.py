"""Programs that this computer drives cycle by cycle: how they receive messages, and the loop that executes them.

A message consists of fourteen big-endian int32: six numbers in millionths (`SCALE`), six more, the command (`STOP`,
`FOLLOW` or `WAIT`), and a date. In `urlink.script.streaming`, the numbers are joint positions in rad and speeds in
rad/s. After the n-th pause of the program, `WAIT` + n replaces `FOLLOW`. If a program finds the arm in another place
after a pause, it follows no message from before the pause.

The date identifies the state that the message answers: the cycle of the controller's clock in which the state was sent,
counted from the first state of the motion. URScript cannot read that clock on every firmware. Therefore the program
counts its own cycles, and keeps the smallest difference between its count and a date, which belongs to the fastest
message. A set-point is ignored if its difference is larger by more than the watchdog's cycles. Set-points queued in
the socket while the controller hung are therefore followed for at most one watchdog time. A pass through the loop
takes at least one cycle, so the program never counts faster than the controller's clock, and counting alone never makes
a message seem too old.

With a `ReverseSocket`, the program connects back to this computer, as programs of public drivers do. It sends a token
that only its text contains, so that another peer that finds the port is not mistaken for the robot. The result of
``socket_read_binary_integer`` begins with the number of integers that were read. It is less than fourteen after two
seconds without a message, or when the connection is lost. With `InputRegisters`, the program waits for the token
instead.

Assignments in a thread or a nested function change the variables of the enclosing program; programs of public drivers
rely on this. No program here needs ``global`` or ``local``, which the oldest firmware might not have. Lists are written
element by element, because arithmetic on whole lists came late.

The last ``textmsg`` of such a program shows why it ended early: `NO_CONNECTION`, `LINK_ENDED`, `STARVED` or `TOO_FAR`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from ..protocol.firmware import Firmware
from .text import each, indented, integer, lines, number, quoted

#: Number of possible tokens: the range of a signed 32-bit integer.
TOKENS = 1 << 31
#: Factor between rad or rad/s and the integers of a message.
SCALE = 1_000_000
#: Commands, the second to last number of a message: brake and end, go to this set-point, or do nothing yet.
STOP, FOLLOW, WAIT = 0, 1, 2

NO_CONNECTION = "urlink: cannot connect"
LINK_ENDED = "urlink: the link ended"
STARVED = "urlink: nothing to go to"
TOO_FAR = "urlink: the first point is too far away"

#: Statement that brakes the arm when its program ends, with 4 rad/s².
BRAKE = "stopj(4.0)"
#: Time, in seconds, that a program waits for the first message in its registers.
_LINK_TIMEOUT = 5.0


class ReverseSocket(NamedTuple):
    """A connection that the program makes back to this computer.

    Attributes:
        host, port: Address of this computer for the robot.
        token: Number that proves that the connecting program is the expected one.
    """

    host: str
    port: int
    token: int


class InputRegisters(NamedTuple):
    """Input registers that this computer writes over RTDE, so the robot need not connect to it.

    Set-points are in twelve floating point registers: positions in rad and speeds in rad/s. Four integer registers hold
    the date, the number of the message (which identifies a new message), the command, and the token. Assumption: a
    program sees all inputs of one RTDE package in the same cycle. Public clients with such programs rely on this.

    Attributes:
        first_float, first_integer: Number of the first register of each kind.
        token: Value of the token register while the messages belong to this program. It is needed because registers
            keep the values of other clients.
    """

    first_float: int
    first_integer: int
    token: int

    @property
    def date(self) -> int:
        """Number of the register with the date."""
        return self.first_integer

    @property
    def message(self) -> int:
        """Number of the register with the message number."""
        return self.first_integer + 1

    @property
    def mode(self) -> int:
        """Number of the register with the command."""
        return self.first_integer + 2

    @property
    def proof(self) -> int:
        """Number of the register with the token."""
        return self.first_integer + 3


#: Function that returns the lines of a program for the link that carries its messages.
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
    """Return a program that does something in each cycle, according to messages from a link.

    Args:
        link: Link that carries the messages.
        start: Code to run first; it must set ``missed`` to 0.
        received: Code for a new message that is not too old, with its numbers in ``goal`` and ``speed``. It must set
            ``missed`` to 0 and take one cycle.
        late: Code for cycle number ``missed`` without a message; it must take one cycle.
        end: Code to run last, even if no message has arrived for too long.
        watchdog: Maximum time without a message, in seconds; then the program ends.
        most_missed: Maximum number of rounds without a message; then the program sends `STARVED` and ends. This number
            is also the maximum delay of a message, in rounds, compared with the fastest message.
        guard: Code for each round. If it sets ``held`` to True, messages from before the next pause are ignored.
    """
    if isinstance(link, ReverseSocket):
        # Reading blocks, so a separate thread moves the arm.
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


#: Larger than any possible initial difference between a cycle count and a date.
SLOWEST = 1_000_000_000
#: Number of integers in a message.
_MESSAGE = 14
#: Time, in seconds, that a read waits for a message.
_READ = 2.0
#: Variables for passing messages from the thread that reads the socket to the thread that moves the arm.
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
    """Return code that connects and passes on messages until the link ends.

    A read that has timed out after `_READ` s is repeated until the watchdog's time has passed. If a read returns sooner
    without a message, the connection is closed; this holds for the simulator. How soon such a read returns on a real
    controller is unknown. If it takes `_READ` s there too, the watchdog ends the program.
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


#: Number of the last message. Messages are counted from 1, so the message that arrives with the token is new.
_SEEN = "seen = 0"


def _take_registers(link: InputRegisters) -> str:
    """Return code that reads the newest message, and determines whether it is new."""
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
    """Return code that waits for the token, for a limited time, and then follows the registers.

    If the program cannot end itself, the controller's own watchdog on the registers ends it. The time of that watchdog
    is one second longer, so that the arm comes to rest first.

    Args:
        at: Number of the register with the token.
        message: Number of the register with the message number.
        follow: Call that follows the registers.
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
    """Return code that keeps the difference of the fastest message; messages without a set-point count too."""
    return f"""
        behind = cycle - {date}
        if behind < quickest:
          quickest = behind
        end
    """


def missable(watchdog: float, rate: int) -> int:
    """Return the number of cycles without a set-point before the program brakes: `watchdog` seconds, at least two."""
    return max(math.ceil(watchdog * rate), 2)


def introduction(token: int) -> str:
    """Return the statement that sends the token as four bytes, the most significant byte first."""
    return f"socket_send_int({integer(token, 0, TOKENS - 1)})"
