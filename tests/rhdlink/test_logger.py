"""The logger: every tick is in the file, and no tick waits for the logger."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from linkcore.errors import BadValue
from linkcore.recording.file import Kind, RecordingFile
from rhdlink.host.config import Element
from rhdlink.host.host import Host, PluginFailed
from rhdlink.host.plugin import Plugin
from rhdlink.host.plugins.logger import Logger
from rhdlink.variables.declarations import Read, Write
from rhdlink.variables.value_types import Float32, Float64, Int32, Scaled, Structure, Text
from rhdlink.wire.decoder import ServerDecoder
from tests.rhdlink.raw_client import RawClient

pytestmark = pytest.mark.simulated_time


class Double(Plugin):
    order = Write(Int32)
    both = Read(Int32, 2)

    def periodic(self, tick: int) -> None:
        self.both = [self.order, 2 * self.order]


def drive(logger: Logger, ticks: int = 5) -> None:
    with Host([logger, Double()], port=0, pacing="lockstep") as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        for number in range(1, ticks + 1):
            master.sync({"order": number})


def read_table(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    return head, rows


def test_logger_table_has_every_tick_and_every_value(tmp_path: Path) -> None:
    logger = Logger(tmp_path / "drive.csv")
    drive(logger)
    head, rows = read_table(tmp_path / "drive.csv")
    assert head == ["time", "tick", "both[0]", "both[1]", "order"]
    # The logger sees the values that the plugins set in the same tick.
    assert [[*map(int, row[1:])] for row in rows] == [[number, number, 2 * number, number] for number in range(6)]
    assert [float(row[0]) for row in rows] == sorted(float(row[0]) for row in rows)
    assert logger.stats is not None
    assert (logger.stats.offered, logger.stats.delivered) == (6, 6)


class Typed(Plugin, order="big"):
    time = Read(Float64, unit="s")
    pose = Read(Float32, 2)
    speed = Read(Scaled(0.01, unit="m/s"))
    label = Read(Text(8))
    fix = Read(Structure([("quality", "u1"), ("age", "f4")]), 2)
    order = Write(Float64, order="little")

    def periodic(self, tick: int) -> None: ...

    def init(self, config: Element) -> None:
        self.host.database.read.add("raw", 2)
        self.host.database.write.add("speed")
        self.time, self.pose, self.speed, self.label = 1e-300, [0.5, -2.0], 0.25, 'a,"b'
        self.fix, self.order = [(3, 0.5), (4, 1.5)], -0.1


def test_table_has_typed_values_and_unique_columns(tmp_path: Path) -> None:
    with (
        Host([Logger(tmp_path / "drive.csv"), Typed()], port=0, pacing="lockstep") as host,
        RawClient(host.port) as reader,
    ):
        reader.greeting()
        reader.sync()
    head, rows = read_table(tmp_path / "drive.csv")
    row = dict(zip(head, rows[0], strict=True))
    assert len(row) == len(head)
    del row["time"]
    assert row == {
        "tick": "0",
        "time (read)": "1e-300",
        "pose[0]": "0.5",
        "pose[1]": "-2.0",
        "speed": "0.25",
        "label": 'a,"b',
        "fix[0].quality": "3",
        "fix[0].age": "0.5",
        "fix[1].quality": "4",
        "fix[1].age": "1.5",
        "raw[0]": "0",
        "raw[1]": "0",
        "order": "-0.1",
        "speed (write)": "0",
    }


def test_recording_contains_the_bytes_of_a_reader(tmp_path: Path) -> None:
    drive(Logger(tmp_path / "drive.urlog"))
    recording = RecordingFile(tmp_path / "drive.urlog")
    assert recording.is_complete
    assert recording.channels[0]["name"] == "rhd"
    stream = ServerDecoder()
    for record in recording:
        if record.kind is Kind.BYTES:
            stream.feed(record.payload)
    handshake = stream.take_handshake()
    assert handshake is not None
    assert [row.name for row in (*handshake.read, *handshake.write)] == ["tick", "both", "order"]
    batches = []
    while (batch := stream.take_batch()) is not None:
        written, read = batch.data
        batches.append([*read.values.tolist(), *written.values.tolist()])
    assert batches == [[number, number, 2 * number, number] for number in range(6)]


def test_logger_with_every_3_writes_every_third_tick(tmp_path: Path) -> None:
    drive(Logger(tmp_path / "drive.csv", every=3), 7)
    assert [row[1] for row in read_table(tmp_path / "drive.csv")[1]] == ["0", "3", "6"]


def test_path_and_interval_come_from_the_host_configuration(tmp_path: Path) -> None:
    logger = Logger()
    logger.init(Element("logger", {"path": str(tmp_path / "x.csv"), "every": "2"}))
    logger.terminate()
    assert (tmp_path / "x.csv").exists()
    with pytest.raises(BadValue, match="path"):
        Logger().init(Element("logger"))


@pytest.mark.parametrize("suffix", [".csv", ".urlog"])
def test_each_start_writes_a_new_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"day{suffix}"
    path.write_text("dear")
    sizes = []
    for number in (1, 2):
        logger = Logger(path)
        drive(logger)
        assert logger.path == tmp_path / f"day-{number}{suffix}"
        sizes.append(logger.path.stat().st_size)
    assert path.read_text() == "dear"
    assert all(size > 100 for size in sizes)


def test_logger_rejects_invalid_arguments(tmp_path: Path) -> None:
    with pytest.raises(BadValue, match=r"\.csv or \.urlog"):
        Logger(tmp_path / "x.txt")
    with pytest.raises(BadValue, match="path=3; expected the path of a"):
        Logger(3)  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="every"):
        Logger(tmp_path / "x.csv", every=0)
    logger = Logger(tmp_path / "missing" / "x.csv")
    logger.is_critical = True
    with pytest.raises(PluginFailed, match="cannot write"):
        Host([logger], port=0).start()
