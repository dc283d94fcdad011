"""Assembly of programs from the lines of a client."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from urlink.simulator.programs.loader import LONGEST_PROGRAM, LineAssembler


def fed(lines: list[str], assembler: LineAssembler | None = None) -> list[str]:
    assembler = LineAssembler() if assembler is None else assembler
    return [text for text in map(assembler.feed, lines) if text is not None]


def test_single_line_is_a_program() -> None:
    assert fed(["stopj(2)", "movej([0,0,0,0,0,0])"]) == ["stopj(2)", "movej([0,0,0,0,0,0])"]


@pytest.mark.parametrize("kind", ["def", "sec"])
def test_program_ends_at_its_end_line(kind: str) -> None:
    program = [f"{kind} f():", "  if True:", "    sync()", "  end", "", "  # end", "end"]
    assert fed([*program, "stopj(2)"]) == ["\n".join(program) + "\n", "stopj(2)"]


@pytest.mark.parametrize("line", ["", "   ", "\t", "# stop", "   # stop"])
def test_blank_and_comment_lines_are_no_programs(line: str) -> None:
    assert fed([line]) == []


@pytest.mark.parametrize("line", ["end", "end # of f", "end   ", "end#", "end\t# of f"])
def test_end_line_completes_a_program(line: str) -> None:
    assert fed(["def f():", line]) == [f"def f():\n{line}\n"]


@pytest.mark.parametrize("line", [" end", "ending()", "end = 1", "end()", "# end", "ende", "define = 1"])
def test_similar_lines_do_not_end_a_program(line: str) -> None:
    assert fed(["def f():", line]) == []


@pytest.mark.parametrize("line", ["define = 1", "sector = 2", " def f():", "default()"])
def test_similar_lines_do_not_start_a_program(line: str) -> None:
    assert fed([line, "sync()"]) == [line, "sync()"]


def test_too_long_program_is_discarded_up_to_its_end() -> None:
    assembler = LineAssembler()
    line = "  " + "x" * 65_533
    long = ["def f():", *[line] * 20, "end"]
    assert sum(len(text) + 1 for text in long) > LONGEST_PROGRAM
    assert fed(long, assembler) == []
    assert assembler.refused == sum(len(text) + 1 for text in long)
    assert fed(["def g():", "end", "sync()"], assembler) == ["def g():\nend\n", "sync()"]
    assert assembler.refused == sum(len(text) + 1 for text in long)


def test_longest_program_is_accepted() -> None:
    lines = ["def f():", "x" * (LONGEST_PROGRAM - 14), "end"]
    assert sum(len(text) + 1 for text in lines) == LONGEST_PROGRAM
    assert len(fed(lines)[0]) == LONGEST_PROGRAM
    assembler = LineAssembler()
    lines[1] += "x"
    assert fed(lines, assembler) == []
    assert assembler.refused == LONGEST_PROGRAM + 1


_BODY = st.sampled_from(["  sync()", "", "# note", "  end", "x = 1", " end # of it"])
_PROGRAM = st.tuples(st.sampled_from(["def f():", "sec s():"]), st.lists(_BODY, max_size=5), st.just("end"))
_PIECES = st.lists(st.one_of(st.sampled_from(["sync()", "", "# note", "set speed 0.5"]), _PROGRAM), max_size=12)


@pytest.mark.property
@given(_PIECES)
def test_programs_and_lines_come_out_whole_and_in_order(pieces: list[str | tuple[str, list[str], str]]) -> None:
    lines: list[str] = []
    expected: list[str] = []
    for piece in pieces:
        if isinstance(piece, str):
            lines.append(piece)
            expected += [piece] if piece not in ("", "# note") else []
        else:
            whole = [piece[0], *piece[1], piece[2]]
            lines += whole
            expected.append("\n".join(whole) + "\n")
    assert fed(lines) == expected
