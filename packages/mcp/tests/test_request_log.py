"""The log of requests."""

from __future__ import annotations

import json
import logging
import os
import sys
from pathlib import Path

import pytest

import urlink
from urlink_mcp.request_log import Client, RequestLog

CLIENT = Client("agent\x1b[2J\n", "1.0", "stdio")


def test_note_appends_json_lines(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    for _ in range(2):
        log = RequestLog(path)
        log.note(CLIENT, "arm", "move_joints", "asked", acts=True, arguments={"q": [float("nan")]})
        log.close()
    rows = [json.loads(line) for line in path.read_text(encoding="ascii").splitlines()]
    assert len(rows) == 2
    assert rows[0].keys() == {"time", "client", "version", "session", "robot", "tool", "event", "arguments"}
    assert rows[0]["arguments"] == {"q": [None]}


def test_note_logs_on_one_line_without_control_characters(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "urlink.mcp"):
        log = RequestLog()
        log.note(CLIENT, "arm", "stop", "failed", acts=True, reason="a\x1b\nb")
        log.note(CLIENT, "arm", "get_state", "asked", acts=False)
    assert [each.levelname for each in caplog.records] == ["WARNING", "INFO"]
    assert caplog.messages[0] == r"arm: stop of agent\x1b[2J\n 1.0 (stdio): failed; reason: a\x1b\nb"


def test_client_name_is_shortened() -> None:
    assert len(str(Client("a" * 1000, "1", "stdio"))) < 80
    assert str(Client("", "", "stdio")) == "a client without a name (stdio)"


def test_log_rejects_path_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(urlink.BadValue, match="cannot write the log"):
        RequestLog(tmp_path / "missing" / "log.jsonl")


@pytest.mark.skipif(not os.path.exists("/dev/full") or sys.platform != "linux", reason="needs /dev/full")
def test_check_refuses_requests_when_disk_is_full() -> None:
    log = RequestLog("/dev/full")
    log.check()
    log.note(CLIENT, "arm", "stop", "asked", acts=True)
    with pytest.raises(urlink.LocalError, match="the request cannot be logged"):
        log.check()
    # The events of a stop still do not raise.
    log.note(CLIENT, "arm", "stop", "done", acts=True)
    log.close()
