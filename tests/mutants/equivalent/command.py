from __future__ import annotations

from tests.mutants.equivalent import Equivalent

CHANNEL = "urlink/command/channel.py"
INTERPRETER = "urlink/command/interpreter.py"
IO = "urlink/command/io.py"
MONITOR = "urlink/command/safety_monitor.py"
PROGRAMS = "urlink/command/programs.py"

EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(CHANNEL, "_has_turn", "return False", "return None", "its only caller asks whether it is true"),
    Equivalent(INTERPRETER, "__exit__", "0", "1", "type and exception are both None, or neither is"),
    Equivalent(IO, "set_tool_communication", "3", "4", "numbers of 32 bits up to 40 are that exact"),
    Equivalent(MONITOR, "wait_for", "left <= 0.0", "left < 0.0", "a clock that says exactly this costs one more look"),
    Equivalent(PROGRAMS, "__init__", "4", "5", "the number with which tokens begin is random with either"),
    Equivalent(
        PROGRAMS,
        "_after_stop",
        "self._clock() - self._given_up.stop_sent > _IGNORED",
        "self._clock() - self._given_up.stop_sent >= _IGNORED",
        "a state that comes exactly then, or the next",
    ),
)
