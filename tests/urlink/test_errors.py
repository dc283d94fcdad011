"""Tests of the errors of commands: their base classes, their texts, and pickling."""

from __future__ import annotations

import pickle

import pytest

from linkcore.errors import LinkError, LocalError, RemoteError
from urlink import errors
from urlink.errors import CompileError, LimitExceeded, NotEnabled, NotOffered, NotRunning, SafetyStop, ScriptFailed

OWN = {name: each for name, each in vars(errors).items() if getattr(each, "__module__", None) == errors.__name__}


def test_errors_are_remote_errors_except_local_ones() -> None:
    assert NotEnabled in OWN.values()
    # A call that only another library offers, or that exceeds a limit of the session, is not an error of the peer.
    local = {each for each in OWN.values() if issubclass(each, LocalError)}
    assert local == {NotOffered, LimitExceeded}
    assert all(issubclass(each, RemoteError) and not issubclass(each, LocalError) for each in {*OWN.values()} - local)


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
def test_errors_keep_their_text_when_pickled(error: LinkError, text: str) -> None:
    assert str(error) == text
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy), vars(copy)) == (type(error), text, vars(error))


def test_module_docstring_names_every_error() -> None:
    assert errors.__doc__ is not None
    assert all(name in errors.__doc__ for name in OWN)
