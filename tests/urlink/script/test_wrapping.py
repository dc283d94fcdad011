"""Wrapping of a user's program before it is sent, and conversion of line numbers back to the user's source."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.fakes.line import START_PLACE
from urlink.protocol.firmware import Firmware
from urlink.script.wrapping import LARGEST, Permission, StartPlace, grant, program, wrap


def body(source: str) -> list[str]:
    """Return the lines between the markers."""
    lines = wrap(source, "t").text.splitlines()
    assert lines[0].endswith("():")
    assert lines[1].strip().startswith("textmsg(")
    assert lines[-2].strip().startswith("textmsg(")
    assert lines[-1] == "end"
    return lines[2:-2]


def test_statements_are_wrapped_in_a_function() -> None:
    assert wrap("movej(q)\nstopl(1)", "t").text == (
        'def urlink_t():\n  textmsg("urlink_t started")\n  movej(q)\n  stopl(1)\n  textmsg("urlink_t finished")\nend\n'
    )


def test_function_is_called() -> None:
    assert body("def job():\n  halt\nend") == ["  def job():", "    halt", "  end", "  job()"]


def test_last_of_several_functions_is_called() -> None:
    source = "def one():\n  a()\nend\n# and\n\ndef two():\n  one()\nend\n"
    assert body(source)[-1] == "  two()"
    assert wrap(source, "t").name == "two_t"


@pytest.mark.parametrize(
    ("source", "unused"),
    [
        ("def one():\n  a()\nend\ndef two():\n  b()\nend\n", "one"),
        ('def one():\n  one()\nend\ndef two():\n  textmsg("one")\n  # one()\nend\n', "one"),
        ("def one():\nend\ndef also():\nend\ndef two():\nend\n", "one, also"),
    ],
)
def test_wrap_rejects_several_programs_in_one_text(source: str, unused: str) -> None:
    with pytest.raises(BadValue, match=rf"nothing calls {unused}, so only the last one, two, would run"):
        wrap(source, "t")


def test_wrap_accepts_helpers_that_are_not_called() -> None:
    source = "def used():\nend\ndef unused():\nend\ndef main():\n  used()\nend\n"
    assert wrap(source, "t").name == "main_t"


def test_statements_above_the_last_function_run_first() -> None:
    assert body("global a = 1\ndef job():\n  b(a)\nend")[-1] == "  job()"
    assert body("def job():\n  b(a)\nend\njob()\njob()")[-2:] == ["  job()", "  job()"]
    assert body("thread t():\n  b()\nend\ndef job():\n  run t()\nend\nthread u():\n  c()\nend")[-1] == "  job()"


def test_function_with_default_arguments_is_called() -> None:
    assert body("def job(a = 1, b=2):\nend")[-1] == "  job()"
    with pytest.raises(BadValue, match=r"line 2 .* job takes arguments"):
        wrap("\ndef job(a, b=2):\nend", "t")


def test_secondary_program_is_wrapped() -> None:
    assert wrap("# lamp\nsec lamp():\n  set_flag(1, True)\nend\n", "t").text == (
        'sec lamp_t():\n  textmsg("lamp_t started")\n  set_flag(1, True)\n  textmsg("lamp_t finished")\nend\n'
    )
    with pytest.raises(BadValue, match="alone"):
        wrap("sec a():\n  b()\nend\nc()", "t")
    with pytest.raises(BadValue, match="on separate lines"):
        wrap("sec a(): b()\nend", "t")
    with pytest.raises(BadValue, match="on separate lines"):
        wrap("sec a():\n b() end", "t")


@pytest.mark.parametrize("permission", [None, Permission(START_PLACE, 5, 100)])
@pytest.mark.parametrize(
    "source", ["movej(q)", "def f():\n  movej(q)\nend", "sec f():\n  movej(q)\nend", "\n\nsec f():\n  x\nend"]
)
def test_place_returns_position_in_user_source(source: str, permission: Permission | None) -> None:
    wrapped = wrap(source, "t", permission)
    sent, own = wrapped.text.splitlines(), source.splitlines()
    for number, line in enumerate(sent, 1):
        if number <= wrapped.above and not wrapped.is_secondary:
            continue  # the lines of the beginning and of the permission
        if "textmsg" in line or "_t()" in line or line.strip() in ("end", "f()"):
            continue
        at, column = wrapped.place(number, len(line) - len(line.lstrip()) + 1)
        assert own[at - 1].strip() == line.strip()
        assert own[at - 1][column - 1 :] == line.strip()
    for number in (-5, 0, 99):
        assert 1 <= wrapped.place(number, 0)[0] <= len(own)
        assert wrapped.place(number, 0)[1] == 1


def test_program_waits_for_token_in_register() -> None:
    permission = Permission(StartPlace(47, (31,)).on(Firmware(5, 11)), token=4711, cycles=250)
    wrapped = wrap("movej(q)", "t", permission)
    assert wrapped.permission == permission
    assert wrapped.text == (
        "def urlink_t():\n"
        "  write_output_integer_register(47, 0)\n"
        '  textmsg("urlink_t started")\n'
        "  urlink_cycles = 0\n"
        "  while urlink_cycles < 250 and not (read_output_integer_register(47) == 4711):\n"
        "    urlink_cycles = urlink_cycles + 1\n"
        "    if not (read_output_integer_register(47) == 0):\n"
        "      write_output_integer_register(47, 0)\n"
        '      textmsg("urlink_t started")\n'
        "    end\n"
        "    sync()\n"
        "  end\n"
        "  if not (read_output_integer_register(47) == 4711):\n"
        '    textmsg("urlink_t was not permitted to go on")\n'
        "    halt\n"
        "  end\n"
        "  movej(q)\n"
        '  textmsg("urlink_t finished")\n'
        "end\n"
    )
    assert grant(permission) == "sec urlink_permission():\n  write_output_integer_register(47, 4711)\nend\n"
    # A sec must not take any time, so it cannot wait.
    assert wrap("sec a():\n  b()\nend", "t", permission).permission is None


def test_program_waits_for_token_in_flags_without_register() -> None:
    place = StartPlace(47, (31, 7, 30)).on(Firmware(3, 8))
    permission = Permission(place, token=5, cycles=250)
    assert place.tokens == 7
    text = wrap("movej(q)", "t", permission).text
    assert text.startswith(
        "def urlink_t():\n"
        "  set_flag(31, False)\n"
        "  set_flag(7, False)\n"
        "  set_flag(30, False)\n"
        '  textmsg("urlink_t started")\n'
        "  urlink_cycles = 0\n"
        "  while urlink_cycles < 250 and not (get_flag(31) and not get_flag(7) and get_flag(30)):\n"
        "    urlink_cycles = urlink_cycles + 1\n"
        "    if not (not get_flag(31) and not get_flag(7) and not get_flag(30)):\n"
    )
    assert grant(permission) == (
        "sec urlink_permission():\n  set_flag(31, True)\n  set_flag(7, False)\n  set_flag(30, True)\nend\n"
    )


@pytest.mark.parametrize(
    ("firmware", "tokens"), [("1.8", 255), ("3.8", 255), ("3.9", 2**31 - 1), ("5.2", 255), ("10.7", 2**31 - 1)]
)
def test_number_of_tokens_depends_on_firmware(firmware: str, tokens: int) -> None:
    assert START_PLACE.on(Firmware.parse(firmware)).tokens == tokens
    assert StartPlace(None, ()).on(Firmware.parse(firmware)).tokens == 0


def test_error_messages_get_the_line_of_the_user_source() -> None:
    assert wrap("a\nb\nc", "t").words("syntax_error_on_line:4:end:") == "syntax_error_on_line:2:end:"
    assert wrap("a", "t").words("compile_error_name_not_found:a:") == "compile_error_name_not_found:a:"


@pytest.mark.parametrize(
    ("source", "match"),
    [
        ("", "empty"),
        ("  \n# nothing\n", "empty"),
        ("def f():\n  a()", "line 1 .* `def` has no `end`"),
        ("def f():\n  if a:\n  b()\nend", "line 1 .* `def` has no `end`"),
        ("while True:\n  a()", "`while` has no `end`"),
        ("a()\nend", "line 2 .* this `end` closes no block"),
        ("def f():\nend\nend", "line 3"),
        ('textmsg("a)', "line 1 .* not closed"),
        ("a\0b", "control character"),
        ("a\x1bb", "control character"),
        ("a\ud800", "not a valid character"),
        ("def f)(:\n  a\nend", "expected something like"),
        (b"a()", "of type bytes"),
        ("#" * (LARGEST + 1), "bytes"),
    ],
)
def test_wrap_rejects_invalid_sources(source: str, match: str) -> None:
    with pytest.raises(BadValue, match=match):
        wrap(source, "t")


def test_keywords_in_strings_and_comments_are_ignored() -> None:
    source = 'textmsg("def end if")  # while the end\nend_q = 1\nrun_if = end_q'
    assert body(source) == [f"  {line}" for line in source.splitlines()]


def test_wrap_accepts_crlf_line_ends() -> None:
    assert body("a()\r\nb()\r\n") == ["  a()", "  b()"]


def test_program_wraps_lines_of_the_library() -> None:
    assert program("urlink_1", ["a()"]).text == (
        'def urlink_1():\n  textmsg("urlink_1 started")\n  a()\n  textmsg("urlink_1 finished")\nend\n'
    )
    with pytest.raises(BadValue):
        program("urlink 1", ["a()"])


@pytest.mark.property
@given(
    st.lists(
        st.sampled_from(["def f():", "thread t():", "if a:", "end", "a()", "# end", "", '"end"', "else:"]), max_size=12
    )
)
def test_any_accepted_source_gives_one_program(lines: list[str]) -> None:
    """A source cannot close the program around it and continue outside."""
    try:
        wrapped = wrap("\n".join(lines), "t")
    except BadValue:
        return
    depth = 0
    sent = wrapped.text.splitlines()
    for number, line in enumerate(sent, 1):
        word = line.split("#")[0].strip()
        depth += word.startswith(("def", "thread", "if")) - (word == "end")
        assert depth > 0 or number == len(sent)
    assert depth == 0


@pytest.mark.parametrize("end", ["b = a +", "f(1,", "x = [1, ", "y = not", "z = a and  # more?"])
def test_incomplete_last_statement_is_rejected(end: str) -> None:
    with pytest.raises(BadValue, match=r"line 2 .* in the middle of a statement"):
        wrap(f"a = 1\n{end}\n\n", "t")


def test_error_after_user_source_does_not_quote_library_line() -> None:
    """The controller reports an open bracket at the line after the source, which was generated by this library."""
    wrapped = wrap("popup(1", "t")
    sent = wrapped.text.splitlines()
    after = next(number for number, line in enumerate(sent, 1) if "popup(1" in line) + 1
    said = f"syntax_error_on_line:{after}:{sent[after - 1]}:"
    assert wrapped.words(said) == "syntax_error_on_line:1: the program ends in the middle of a statement"
    assert wrapped.words(f"syntax_error_on_line:{after - 1}:  popup(1:") == "syntax_error_on_line:1:popup(1:"
    assert wrapped.words("Division by zero") == "Division by zero"
