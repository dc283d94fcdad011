"""Recorded connections of real RTDE clients, sent to the simulated controller, which must reply in the same way.

The recordings were made with a stand-in server whose replies these clients accepted, so the simulator's replies are
compared with them. Data packages have other values, so they are only checked against the requested recipe.
"""

from __future__ import annotations

import csv
import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import real_captures
from tests.urlink.simulator.rtde_peer import Peer, package, packages, step
from urlink.protocol.rtde.recipes import Recipe
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.captures("rtde")

#: Maximum number of cycles between two pieces; a recording lasts up to 6 s.
LONGEST_PAUSE = 10


class Recording:
    """Recorded connection of one client.

    Attributes:
        name: Name of the recording, which contains the version of the controller.
        sent: Pieces that the client sent, as they arrived, each with its time in s.
        replies: Replies that the client accepted, without data packages.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self.name = name
        client = (folder / f"{name}.c2s.bin").read_bytes()
        self.replies = [entry for entry in packages((folder / f"{name}.s2c.bin").read_bytes()) if entry[0] != "U"]
        with open(folder / f"{name}.index.csv", newline="") as file:
            rows = [row for row in csv.DictReader(file) if row["direction"] == "c2s"]
        self.sent = [
            (float(row["time_s"]), client[int(row["offset"]) : int(row["offset"]) + int(row["length"])]) for row in rows
        ]
        assert b"".join(piece for _, piece in self.sent) == client

    @property
    def text(self) -> str:
        """Text of the message that the stand-in sent."""
        (payload,) = {payload for kind, payload in self.replies if kind == "M"}
        # Protocol 1 sends a level, then the text; protocol 2 sends the length, then the text.
        return payload[1:].decode() if payload[0] <= 3 else payload[1 : 1 + payload[0]].decode()

    def controller(self) -> Controller:
        """Return a controller that behaves like the stand-in."""
        controller = Controller(None, self.name.split("_")[1], motion=Still())
        faults = controller.faults
        if "v2refused" in self.name:
            faults.rtde_refuse_protocol_2()
        elif "-hello" in self.name:
            faults.rtde_hello()
        elif "-datafirst" in self.name:
            faults.rtde_data_before_start()
        elif "-msgbeforestart" in self.name:
            faults.rtde_text_before_reply("S", self.text)
        return controller

    def check(self, peer: Peer) -> None:
        """Check that the client got all replies in order, and data of its recipe only after a start."""
        replies: list[tuple[str, bytes]] = []
        recipe: Recipe | None = None
        for kind, payload in packages(bytes(peer.sent)):
            if kind == "U":
                assert recipe is not None, "data without a recipe"
                recipe.check(package("U", payload))
                continue
            if kind == "O":
                recipe = _recipe(payload)
            replies.append((kind, _without_source(kind, payload)))
        assert replies == [(kind, _without_source(kind, payload)) for kind, payload in self.replies], self.name


def _recipe(reply: bytes) -> Recipe | None:
    """Return a recipe with the types of a reply to O; the names do not affect the size."""
    number = reply[0] if reply[0] < 32 else None
    types = (reply if number is None else reply[1:]).decode().split(",")
    if number == 0 or "NOT_FOUND" in types:
        return None
    return Recipe([f"v{at}" for at in range(len(types))], types, number)


def _without_source(kind: str, payload: bytes) -> bytes:
    """Return a reply without the source of a text, because the stand-in used a different name."""
    if kind != "M":
        return payload
    return payload if payload[0] <= 3 else payload[: 1 + payload[0]]


def recordings() -> Iterator[Recording]:
    folder = real_captures.folder("rtde")
    with open(folder / "MANIFEST.csv", newline="") as file:
        names = [row["file"] for row in csv.DictReader(file)]
    assert len(names) == 76
    for name in names:
        yield Recording(folder, name)


def connected(recording: Recording) -> tuple[Controller, Peer]:
    """Return a controller and a client; a second client claims an input if the recording had one."""
    controller = recording.controller()
    name, _, later = recording.name.rpartition("_")
    if later in ("c2", "c3") and "-inuse" in name:
        holder = Peer(controller, protocol=1)
        for _, piece in Recording(real_captures.folder("rtde"), name).sent:
            holder.session.feed(piece)
    return controller, Peer(controller, protocol=1)


def test_recorded_clients_get_the_recorded_replies() -> None:
    for recording in recordings():
        controller, peer = connected(recording)
        before = 0.0
        for time, piece in recording.sent:
            step(controller, min(round((time - before) * controller.firmware.rate), LONGEST_PAUSE))
            before = time
            peer.session.feed(piece)
        recording.check(peer)
        assert peer.is_open, recording.name
        # These send a force in a package that is too short, data of an unknown recipe, and data that is too short.
        odd = ("urrtde-control", "err-hand-recipes")
        assert controller.counters.ignored_packages == 0 or recording.name.startswith(odd), recording.name
        peer.close()
        controller.faults.heal()
        if "-inuse" not in recording.name:
            assert Peer(controller).inputs("input_int_register_0", "speed_slider_mask")[0] == 1, recording.name


@pytest.mark.slow
def test_replies_do_not_depend_on_chunking() -> None:
    chance = random.Random(1)
    for recording in recordings():
        data = b"".join(piece for _, piece in recording.sent)
        for longest in (1, 300):
            _, peer = connected(recording)
            at = 0
            while at < len(data):
                size = chance.randint(1, longest)
                peer.session.feed(data[at : at + size])
                at += size
            recording.check(peer)
