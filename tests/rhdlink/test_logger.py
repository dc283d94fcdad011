"""The logger: every tick in the file, and no tick that waits for it."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from linkcore.errors import BadValue
from linkcore.recording.file import Kind, Recording
from rhdlink.config import Element
from rhdlink.host import Host, PluginFailed
from rhdlink.kinds import Int32
from rhdlink.plugin import Plugin
from rhdlink.plugins.logger import Logger
from rhdlink.variables import Read, Write
from rhdlink.wire import ServerStream
from tests.rhdlink.party import Party


class Double(Plugin):
    order = Write(Int32)
    both = Read(Int32, 2)

    def periodic(self, tick: int) -> None:
        self.both = [self.order, 2 * self.order]


def drive(logger: Logger, ticks: int = 5) -> None:
    with Host([logger, Double()], port=0, pacing="lockstep") as host, Party(host.port, b"aw") as master:
        master.greeting()
        for number in range(1, ticks + 1):
            master.sync({"order": number})


def test_a_table_has_every_tick_and_every_word(tmp_path: Path) -> None:
    logger = Logger(tmp_path / "drive.csv")
    drive(logger)
    with (tmp_path / "drive.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    assert head == ["tick", "time", "tick", "both[0]", "both[1]", "order"]
    # It sees what the plugins set in the same tick.
    assert [[*map(int, [row[0], *row[2:]])] for row in rows] == [
        [number, number, number, 2 * number, number] for number in range(6)
    ]
    assert [float(row[1]) for row in rows] == sorted(float(row[1]) for row in rows)
    assert logger.stats is not None
    assert (logger.stats.received, logger.stats.delivered) == (6, 6)


def test_a_recording_is_what_a_reader_would_have_been_sent(tmp_path: Path) -> None:
    drive(Logger(tmp_path / "drive.urlog"))
    recording = Recording(tmp_path / "drive.urlog")
    assert recording.is_complete
    assert recording.channels[0]["name"] == "rhd"
    stream = ServerStream()
    for record in recording:
        if record.kind is Kind.BYTES:
            stream.feed(record.payload)
    handshake = stream.take_handshake()
    assert handshake is not None
    assert [row.name for row in (*handshake.read, *handshake.write)] == ["tick", "both", "order"]
    told = []
    while (batch := stream.take_batch()) is not None:
        written, read = batch.data
        told.append([*read.values.tolist(), *written.values.tolist()])
    assert told == [[number, number, 2 * number, number] for number in range(6)]


def test_not_every_tick(tmp_path: Path) -> None:
    drive(Logger(tmp_path / "drive.csv", every=3), 7)
    with (tmp_path / "drive.csv").open(newline="") as file:
        assert [row[0] for row in csv.reader(file)] == ["tick", "0", "3", "6"]


def test_the_file_of_the_host_says_where(tmp_path: Path) -> None:
    logger = Logger()
    logger.init(Element("logger", {"path": str(tmp_path / "x.csv"), "every": "2"}))
    logger.terminate()
    assert (tmp_path / "x.csv").exists()
    with pytest.raises(BadValue, match="path"):
        Logger().init(Element("logger"))


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    for name in ("x.csv", "x.urlog"):
        path = tmp_path / name
        path.write_text("dear")
        logger = Logger(path)
        logger.is_critical = True
        with pytest.raises(PluginFailed, match="exists"):
            Host([logger], port=0).start()
        assert path.read_text() == "dear"


def test_what_cannot_be_a_log(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match=r"\.csv or a \.urlog"):
        Logger(tmp_path / "x.txt")
    with pytest.raises(BadValue, match="every"):
        Logger(tmp_path / "x.csv", every=0)
    logger = Logger(tmp_path / "missing" / "x.csv")
    logger.is_critical = True
    with pytest.raises(PluginFailed, match="cannot write"):
        Host([logger], port=0).start()
