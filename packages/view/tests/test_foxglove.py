"""A robot in Foxglove, observed by a WebSocket client that implements its protocol."""

from __future__ import annotations

import contextlib
import importlib
import json
import struct
import sys
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

import urlink
import urlink.cli
from linkcore.recording.mcap_file import Topic
from linkcore.wire.packet import State
from urlink.packets import TextMessage
from urlink_view import live
from urlink_view.live import FoxgloveServer, RobotView

WHY = "it is not installed; nox -f nightly.py -s data installs it"


def view(address: str, topics: set[str], messages: int) -> tuple[dict[str, Any], dict[str, list[tuple[int, bytes]]]]:
    """Return advertised channels by topic, and time and bytes of each message."""
    client = importlib.import_module("websockets.sync.client")
    advertised: dict[str, Any] = {}
    found: dict[str, list[tuple[int, bytes]]] = {topic: [] for topic in topics}
    names: dict[int, str] = {}
    with client.connect(address, subprotocols=["foxglove.sdk.v1"]) as socket:
        while any(len(each) < messages for each in found.values()):
            said = socket.recv(timeout=20)
            if isinstance(said, bytes):
                operation, subscription, time = struct.unpack_from("<BIQ", said)
                if operation == 1:
                    found[names[subscription]].append((time, said[13:]))
                continue
            said = json.loads(said)
            for channel in said.get("channels", ()) if said["op"] == "advertise" else ():
                advertised[channel["topic"]] = channel
                if channel["topic"] in topics:
                    names[channel["id"]] = channel["topic"]
                    wanted = [{"id": channel["id"], "channelId": channel["id"]}]
                    socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    return advertised, found


@pytest.mark.real_time
def test_viewer_receives_states_of_arm() -> None:
    pytest.importorskip("foxglove", reason=WHY)
    pytest.importorskip("websockets", reason=WHY)
    records = pytest.importorskip("mcap.records", reason=WHY)
    decoders = pytest.importorskip("mcap_ros2.decoder", reason=WHY)
    over = threading.Event()
    with (
        contextlib.closing(FoxgloveServer("arm", port=0)) as server,
        urlink.connect("sim://ur5e?firmware=5.11") as robot,
        robot.realtime.history(60) as history,
    ):
        shown = RobotView(robot.realtime, robot.primary, robot.kinematics, server)

        def serve() -> None:
            while not over.wait(0.02):
                shown.show()

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            topics = {"/joint_states", "/tf", "/robot_description", "/realtime"}
            advertised, found = view(server.address, topics, 1)
        finally:
            over.set()
            thread.join()
            shown.close()
        positions = history.array("q_actual")["q_actual"].tolist()
    assert {"/joint_states", "/tf", "/tcp_pose", "/wrench", "/realtime", "/robot_description"} <= advertised.keys()
    assert advertised["/tf"]["schemaName"] == "tf2_msgs/msg/TFMessage"
    decoded = {}
    for topic, messages in found.items():
        channel = advertised[topic]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        schema = records.Schema(1, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
        decode = decoders.DecoderFactory().decoder_for(channel["encoding"], schema)
        decoded[topic] = decode(messages[0][1])
    assert list(decoded["/joint_states"].position) in positions
    assert [each.child_frame_id for each in decoded["/tf"].transforms][-1] == "tool0"
    assert "<cylinder" in decoded["/robot_description"].data
    assert decoded["/realtime"].robot_mode == urlink.packets.RobotMode.RUNNING
    stamp = decoded["/realtime"].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == found["/realtime"][0][0]


def test_hidden_view_keeps_only_newest_messages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_ROOM", 3)
    callbacks: list[Callable[[State], None]] = []
    written: list[list[Topic]] = []
    primary: Any = SimpleNamespace(latest=None, subscribe=lambda callback, kind, policy: callbacks.append(callback))
    realtime: Any = SimpleNamespace(latest=None, start=lambda: None)
    server: Any = SimpleNamespace(write=written.append)
    shown = RobotView(realtime, primary, None, server)
    for number in range(5):
        callbacks[0](TextMessage("5.11", text=f"line {number}"))
    shown.show()
    (log,) = written[0]
    assert [b"line 2" in log.messages[0], b"line 3" in log.messages[1], b"line 4" in log.messages[2]] == [True] * 3
    assert len(log.messages) == 3
    shown.show()
    assert written[1] == [], "each message is shown once"


@pytest.mark.real_time
def test_foxglove_command_serves_and_reports_port_in_use(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("foxglove", reason=WHY)
    with contextlib.closing(FoxgloveServer("other", port=0)) as other:
        assert urlink.cli.main(["foxglove", "sim://", "--port", str(other.port)]) == 1
        assert "cannot serve Foxglove" in capsys.readouterr().err
    assert urlink.cli.main(["foxglove", "sim://", "--port", "0", "--duration", "0.3"]) == 0
    assert "ws://127.0.0.1:" in capsys.readouterr().err


def test_foxglove_command_names_missing_extra(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    assert urlink.cli.main(["foxglove", "sim://"]) == 1
    assert "pip install 'urlink-view[foxglove]'" in capsys.readouterr().err
