from __future__ import annotations

from tests.mutants.equivalent import Equivalent

CHANNEL = "urlink/command/channel.py"
INTERPRETER = "urlink/command/interpreter.py"
IO = "urlink/command/io.py"
MONITOR = "urlink/command/safety_monitor.py"
PROGRAMS = "urlink/command/programs.py"

EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(CHANNEL, "_has_turn", "return False", "return None", "its only caller tests whether the result is true"),
    Equivalent(INTERPRETER, "__exit__", "0", "1", "type and exception are both None, or neither is"),
    Equivalent(IO, "set_tool_communication", "3", "4", "32-bit numbers up to 40 are exact to more decimals than that"),
    Equivalent(
        MONITOR,
        "wait_for",
        "left <= 0.0",
        "left < 0.0",
        "if the clock shows exactly this time, the condition is checked once more",
    ),
    Equivalent(PROGRAMS, "__init__", "4", "5", "the first token is random in both cases"),
    Equivalent(
        PROGRAMS,
        "_after_stop",
        "self._clock() - self._given_up.stop_sent > _IGNORED",
        "self._clock() - self._given_up.stop_sent >= _IGNORED",
        "either a state at exactly this time counts, or the next one",
    ),
)
