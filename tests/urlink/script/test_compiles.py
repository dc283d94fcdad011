"""Sent programs and commands compile on the simulated controller, for one firmware of each kind."""

from __future__ import annotations

import pytest

from urlink.protocol.firmware import Firmware
from urlink.script import commands
from urlink.script.wrapping import Permission, StartPlace, wrap
from urlink.simulator.urscript import ProgramError, compile_script

FIRMWARES = ("1.8", "3.1", "3.4", "5.0", "5.11", "10.12")

SOURCES = {
    "statement": "movej([0,0,0,0,0,0])",
    "function": "def f():\n  return 1\nend",
    "thread in a function": "def f():\n  thread t():\n    sync()\n  end\n  h = run t()\n  join h\nend",
    "thread": "thread t():\n  sync()\nend\nh = run t()\nkill h",
    "secondary": "sec s():\n  textmsg(1)\nend",
    "two functions": "global a = 1\ndef g(x=1):\n  if x > 0:\n    halt\n  end\nend\ndef f():\n  g(2)\nend",
}


@pytest.mark.parametrize("permission", [None, Permission(StartPlace(None, (31, 7)), 3, 100)])
@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("name", SOURCES)
def test_wrapped_programs_compile(name: str, firmware: str, permission: Permission | None) -> None:
    wrapped = wrap(SOURCES[name], "t", permission)
    script = compile_script(wrapped.text, Firmware.parse(firmware))
    assert script.name == wrapped.name
    assert script.kind == ("sec" if wrapped.is_secondary else "def")


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_every_script_command_compiles(firmware: str) -> None:
    version = Firmware.parse(firmware)
    statements = [
        *(commands.digital_out(version, bank, 0, True) for bank in (commands.STANDARD, commands.TOOL)),
        commands.analog_out(version, 0, 0.5),
        commands.tool_voltage(24),
        commands.flag(3, True),
        commands.payload(version, 1),
        commands.tcp((0, 0, 0.1, 0, 0, 0)),
        commands.popup("a # b", "c", True, False),
    ]
    if not version.is_cb2:
        statements += [
            commands.digital_out(version, commands.CONFIGURABLE, 0, True),
            commands.payload(version, 1, (0, 0, 0.1)),
        ]
    if version >= (5, 10):
        statements.append(commands.payload(version, 1, (0, 0, 0.1), (0.1,) * 6))
    compile_script(commands.secondary(*statements), version)


def test_compile_error_has_line_of_user_source() -> None:
    wrapped = wrap("a = 1\nb =\nc = 2", "t")
    with pytest.raises(ProgramError) as caught:
        compile_script(wrapped.text, Firmware(5, 11))
    assert wrapped.place(caught.value.line, caught.value.column)[0] in (2, 3)
    assert wrapped.words(caught.value.text).startswith(("syntax_error_on_line:2", "syntax_error_on_line:3"))
