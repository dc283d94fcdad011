"""Options of `urlink serve mcp`."""

from __future__ import annotations

import argparse
from typing import Any

import pytest

from urlink import BadValue, SessionLimits
from urlink_mcp import cli


def parsed(*argv: str, **common: Any) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    cli.add_arguments(parser)
    namespace = argparse.Namespace(read_only=False, limits=None, require_enable="never")
    return parser.parse_args(argv, argparse.Namespace(**{**vars(namespace), **common}))


LIMITS = SessionLimits()


@pytest.mark.parametrize(
    ("argv", "common", "reason"),
    [
        (("--allow",), {}, "--allow needs limits of the session"),
        (("--allow",), {"limits": LIMITS, "read_only": True}, "contradict each other"),
        (("--allow",), {"limits": LIMITS, "require_enable": "always"}, "agents must not"),
        (("--http",), {}, "needs a token in the environment variable URLINK_MCP_TOKEN"),
        (("--consent-time", "0.5"), {}, r"consent_time is 0.5 s; expected 1 to 300 s"),
        (("--motion-time", "1000"), {}, r"motion_time is 1000.0 s; expected 1 to 600 s"),
        (("--log", "/no/such/folder/log"), {}, "cannot write the log"),
    ],
)
def test_serve_rejects_options(
    argv: tuple[str, ...], common: dict[str, Any], reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("URLINK_MCP_TOKEN", raising=False)
    with pytest.raises(BadValue, match=reason), cli.serve({}, parsed(*argv, **common)):
        pass


def test_serve_rejects_short_token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("URLINK_MCP_TOKEN", "short")
    with pytest.raises(BadValue, match="the token has 5 characters"), cli.serve({}, parsed("--http", "0")):
        pass


def test_port_of_http_has_a_default() -> None:
    assert (parsed().http, parsed("--http").http, parsed("--http", "9000").http) == (None, 8765, 9000)


def test_port_out_of_range_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("URLINK_MCP_TOKEN", "t" * 24)
    with pytest.raises(Exception, match="expected a port from 0 to 65535"), cli.serve({}, parsed("--http", "70000")):
        pass
