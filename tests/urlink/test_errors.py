"""The errors of commanding: where they hang in the tree, and that they travel."""

from __future__ import annotations

import pickle

import pytest

from linkcore.errors import LinkError, LocalError, RemoteError
from urlink import errors
from urlink.errors import CompileError, NotEnabled, NotOffered, NotRunning, SafetyStop, ScriptFailed

OWN = {name: each for name, each in vars(errors).items() if getattr(each, "__module__", None) == errors.__name__}


def test_they_hang_below_what_the_peer_does_wrong() -> None:
    assert NotEnabled in OWN.values()
    # What another client offers and this library does not is the fault of nobody else.
    (local,) = (each for each in OWN.values() if issubclass(each, LocalError))
    assert local is NotOffered
    assert all(issubclass(each, RemoteError) and not issubclass(each, LocalError) for each in {*OWN.values()} - {local})


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (SafetyStop("stopped: fault", "fault"), "stopped: fault"),
        (NotEnabled("not enabled", "not enabled"), "not enabled"),
        (NotRunning("IDLE"), "IDLE"),
        (CompileError(2, 1, "syntax_error_on_line:2:end:"), "line 2, column 1: syntax_error_on_line:2:end:"),
        (ScriptFailed(3, 4, "division by zero"), "line 3, column 4: division by zero"),
    ],
)
def test_they_say_what_is_wrong_here_and_elsewhere(error: LinkError, text: str) -> None:
    assert str(error) == text
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), vars(copy)) == (type(error), text, vars(error))


def test_the_tree_is_drawn_whole() -> None:
    assert errors.__doc__ is not None
    assert all(name in errors.__doc__ for name in OWN)
