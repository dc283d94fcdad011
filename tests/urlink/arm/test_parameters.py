"""The table of parameters: each row states its evidence and its module, and the table lists every guess."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from linkcore.errors import BadValue
from urlink.arm.models import MODELS
from urlink.arm.motors import friction, motors_of
from urlink.arm.parameters import Evidence, Parameter, is_assumed, number, numbers, parameters

SRC = Path(__file__).resolve().parents[3] / "src/urlink"
ROWS = list(parameters().values())
#: the word, but not as a part of a name in the code
GUESS = re.compile(r"(?<![`_\w])guess(es|ed)?(?![`_\w])", re.IGNORECASE)


def words(source: str) -> Iterator[str]:
    """Yield the docstrings and the comments of a module; consecutive comment lines are one comment."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            yield ast.get_docstring(node) or ""
    block: list[str] = []
    last = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            if token.start[0] != last + 1 or not token.line.lstrip().startswith("#"):
                yield " ".join(block)
                block = []
            block.append(token.string)
            last = token.start[0]
    yield " ".join(block)


def guesses(source: str) -> int:
    """Return the number of docstrings and comments that mention a guess."""
    return sum(bool(GUESS.search(text)) for text in words(source))


def place(row: Parameter) -> Path:
    if row.used.startswith("urlink_accept."):
        return (SRC.parents[1] / "packages/accept/src").joinpath(*row.used.split(".")).with_suffix(".py")
    return SRC.joinpath(*row.used.split(".")).with_suffix(".py")


def test_guesses_in_comments_and_docstrings_are_counted() -> None:
    assert guesses('"""A guess."""\n# one\n# and a guess: 3\nx = 1  # guessed\n') == 3
    assert guesses('"""Its `guesses`."""\nguess = guesses(1)  # as guess_sender does\n') == 0


@pytest.mark.slow
def test_parameter_table_lists_every_guess() -> None:
    """A module that mentions more guesses than the table has rows for it has a guess that is not listed."""
    listed = Counter(place(row) for row in ROWS if row.evidence == "guess")
    # The module that reads the table explains the word.
    modules = sorted(path for path in SRC.rglob("*.py") if path != SRC / "arm/parameters.py")
    found = {module: guesses(module.read_text(encoding="utf-8")) for module in modules}
    missing = {str(module.relative_to(SRC)): (n, listed[module]) for module, n in found.items() if n > listed[module]}
    assert missing == {}, "module: (comments and docstrings that mention a guess, rows of parameters.tsv for it)"


def test_every_row_states_valid_evidence() -> None:
    for row in ROWS:
        assert row.evidence in get_args(Evidence), row
        assert row.source, row
        value = (
            [float(each) for each in re.findall(r"-?[\d.]+(?:e-?\d+)?", row.value)]
            if row.value[0] in "-.0123456789"
            else []
        )
        if len(value) == 1:
            assert row.low is not None, row
            assert row.high is not None, row
            assert row.low <= value[0] <= row.high, row
        else:
            assert (row.low, row.high) == (None, None), row
            assert value or row.value in ("yes", "no", "assumed") or row.value.startswith("as "), row


def test_every_row_is_used_in_stated_module() -> None:
    sources = {place(row): place(row).read_text(encoding="utf-8") for row in ROWS}
    for row in ROWS:
        if row.value != "assumed" and not row.value.startswith("as "):
            assert f'"{row.name}"' in sources[place(row)], row


def test_each_number_is_used_by_one_module() -> None:
    used = Counter(name for name, _ in {(row.name, row.used) for row in ROWS})
    assert [name for name, modules in used.items() if modules > 1] == []


def test_parameter_table_contains_all_values_marked_as_guesses() -> None:
    borrowed = {name: {row.name for row in ROWS if (row.of, row.used) == (name, "arm.models")} for name in MODELS}
    assert borrowed == {name: set(arm.guesses) for name, arm in MODELS.items()}


def test_unknown_parameter_is_rejected() -> None:
    with pytest.raises(BadValue, match="'rotor_inertia' of 'size 9'"):
        number("rotor_inertia", "size 9")
    with pytest.raises(BadValue, match="unknown parameter 'wheels'"):
        numbers("wheels")
    assert is_assumed("servoj_lag_stretches")


# -- motors ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODELS)
def test_every_arm_has_motors(name: str) -> None:
    motors = motors_of(name)
    for each in (motors.rotor_inertias, motors.torque_constants, motors.coulomb, motors.viscous):
        assert len(each) == 6
        assert min(each) > 0.0
    # A stronger joint has a larger rotor.
    order = np.argsort(MODELS[name].max_torque, kind="stable")
    assert (np.diff(np.array(motors.rotor_inertias)[order]) >= 0.0).all()


def test_friction_grows_to_full_size_with_speed() -> None:
    assert friction(0.2, 0.5, 0.0) == 0.0
    assert friction(0.2, 0.0, 0.005) == pytest.approx(0.1)
    assert friction(0.2, 0.5, -1.0) == pytest.approx(-0.7)


def test_current_depends_on_torque_and_speed() -> None:
    motors = motors_of("UR10e")
    still = motors.current([11.98, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 6)
    assert still == pytest.approx([1.0, 0, 0, 0, 0, 0])
    assert motors.current([0.0] * 6, [1.0, 0, 0, 0, 0, 0])[0] == pytest.approx(1.6 + 1.39)
