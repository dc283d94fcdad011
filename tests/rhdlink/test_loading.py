"""`rhdlink.load`: a column for each variable, with its declared type."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rhdlink
from rhdlink import Bool, Float64, Host, Int32, Plugin, Read, Scaled, Text, Variables, Write


class Counting(Plugin):
    count = Read(Int32)
    sizes = Read(Int32, 3)
    length = Read(Float64, unit="m")
    step = Read(Scaled(0.5))
    on = Read(Bool)
    said = Read(Text(8))
    speed = Write(Int32)

    def periodic(self, tick: int) -> None:
        self.count += 1
        self.sizes = [self.count, 2, 3]
        self.length = self.count / 4
        self.step = self.count * 0.5
        self.on = self.count % 2 == 0
        self.said = f"tick {self.count}"


class Robot(Variables):
    how_many = Read(Int32, name="count", doc="ticks so far")
    sizes = Read(Int32, 3)
    length = Read(Float64, unit="m")
    step = Read(Scaled(0.5))
    on = Read(Bool)
    said = Read(Text(8))


class Otherwise(Variables):
    count = Read(Int32, 2)


@pytest.mark.simulated_time
def test_load_returns_columns_as_words_or_as_declared_types(tmp_path: Path) -> None:
    path = tmp_path / "drive.urlog"
    with (
        Host([Counting()], port=0, pacing="lockstep") as host,
        rhdlink.connect(host.address, record=path) as robot,
    ):
        for _ in range(20):
            robot.sync()
    words = rhdlink.load(path)
    counts = words["count"].tolist()
    assert counts[1:] == list(range(counts[0], counts[0] + len(counts) - 1))  # the handshake repeats the first count
    assert len(counts) >= 20
    assert words["sizes"].shape == (len(counts), 3)
    assert words["length"].shape == (len(counts), 2)
    assert words["speed"].tolist() == [0] * len(counts)
    assert words.missing == ()
    typed = rhdlink.load(path, variables=Robot)
    assert typed["how_many"].tolist() == counts
    assert typed.fields["how_many"].doc == "ticks so far"
    assert typed.fields["length"].unit == "m"
    np.testing.assert_array_equal(typed["length"], np.array(counts) / 4)
    np.testing.assert_array_equal(typed["step"], np.array(counts) / 2)
    assert typed["on"].tolist() == [count % 2 == 0 for count in counts]
    assert typed["sizes"][5].tolist() == [counts[5], 2, 3]
    assert typed["said"][7] == f"tick {counts[7]}"[:8]
    assert typed.time[0] == 0
    assert len(typed.between(0, typed.time[5])) <= 6
    with pytest.raises(rhdlink.BadRecording, match="count has 1 words in the recording, declared as 2"):
        rhdlink.load(path, Otherwise)

    data = path.read_bytes()
    path.write_bytes(data[:-40])
    cut = rhdlink.load(path)
    assert any("damaged or unfinished" in each for each in cut.missing)
    assert cut["count"].tolist() == counts[: len(cut)]
    with pytest.raises(rhdlink.BadRecording):
        rhdlink.load(tmp_path / "none")
