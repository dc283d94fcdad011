"""`urlink.load`: the columns contain the same values as the stream, even for damaged recordings."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import urlink
from linkcore.recording.file import Kind, RecordingWriter, pack
from tests import platforms
from urlink.packets import RealtimeState, Stamp
from urlink.protocol.primary.robot_message import TextMessage, VersionMessage
from urlink.protocol.primary.robot_state import JointData, RobotModeData, RobotState
from urlink.protocol.realtime.protocol import RealtimeProtocol
from urlink.protocol.rtde.packets import OutputsReply
from urlink.protocol.rtde.recipes import Recipe

KEYS = ("name", "state", "error", "firmware", "model", "dh_table", "serial", "recipe", "a", "d", "address")
CAPTURES = Path(__file__).resolve().parents[3] / "captures"


def packet(number: int, version: str = "5.11") -> bytes:
    return bytes(
        RealtimeState(
            version,
            time=number * 0.002,
            q_actual=np.arange(6) + number,
            tcp_force=[number, 0, 0, 0, 0, -1],
            robot_mode=number % 9,
            joint_modes=[253] * 6,
            digital_input_bits=1 << (number % 40),
        )
    )


def write(path: Path, chunks: Sequence[bytes | str], name: str = "realtime", **info: Any) -> Path:
    """Write a recording of chunks 2 ms apart; a string is a connection event."""
    writer = RecordingWriter(path)
    channel = writer.add_channel({"name": name, "firmware": "5.11", "model": "UR5e", **info})
    for number, chunk in enumerate(chunks):
        stamp = Stamp(100 + number * 0.002, 50 + number * 0.002)
        if isinstance(chunk, str):
            writer.write(Kind.EVENT, channel, stamp, json.dumps({"state": chunk, "error": None}).encode())
        else:
            writer.write(Kind.BYTES, channel, stamp, chunk)
    writer.close()
    return path


def load(chunks: Sequence[bytes | str], **info: Any) -> urlink.Recording:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=platforms.IS_WINDOWS) as folder:
        run = urlink.load(write(Path(folder) / "run.urlog", chunks, **info))
        for table in run.tables.values():
            table.arrays()
        return run


def test_table_has_columns_times_and_units() -> None:
    run = load([packet(number) for number in range(50)])
    assert (run.model, str(run.firmware), run.is_complete, run.missing) == ("UR5e", "5.11", True, ())
    table = run.realtime
    assert len(table) == 50
    assert table["q_actual"].shape == (50, 6)
    assert table["q_actual"].dtype == np.dtype("=f8")
    assert table["q_actual"].dtype.isnative
    assert table["q_actual"].tolist() == [[n, n + 1, n + 2, n + 3, n + 4, n + 5] for n in range(50)]
    assert not table["q_actual"].flags.writeable
    assert table["q_actual"] is table["q_actual"]
    np.testing.assert_allclose(table.time, np.arange(50) * 0.002, atol=1e-9)
    assert table.wall[1] - table.wall[0] == np.timedelta64(2, "ms")
    assert table["robot_mode"].tolist() == [number % 9 for number in range(50)]
    assert table["digital_input_bits"].tolist() == [1 << (number % 40) for number in range(50)]
    assert table.fields["robot_mode"].meaning is urlink.packets.RobotMode
    assert (table.fields["tcp_force"].unit, table.fields["tcp_force"].width) == ("N, Nm", 6)
    assert "tcp_force" in table
    with pytest.raises(
        urlink.BadValue, match=r"no field 'q_actuel'; did you mean q_actual.*its fields are: time, q_target"
    ):
        table["q_actuel"]
    with pytest.raises(urlink.BadRecording, match="has no channel 'primary'; its channels are: realtime"):
        run.primary  # noqa: B018  # reading it raises
    assert "50 rows" in repr(table)
    assert "tcp_force" in table._repr_html_()
    assert "realtime" in run._repr_html_()


@pytest.mark.property
@given(st.lists(st.integers(1, 3000), max_size=40), st.integers(0, 2), st.binary(max_size=30))
def test_columns_do_not_depend_on_chunking(cuts: list[int], size: int, noise: bytes) -> None:
    version = ("1.8", "3.4", "5.11")[size]
    packets = [packet(number, version) for number in range(30)]
    data = b"".join(packets[:10]) + noise + b"".join(packets[10:])
    chunks, at = [], 0
    for cut in cuts:
        chunks.append(data[at : at + cut])
        at += cut
    # Usually packets arrive one by one.
    chunks += [data[begin : begin + len(packets[0])] for begin in range(at, len(data), len(packets[0]))]
    protocol = RealtimeProtocol()
    expected = [protocol.decode(frame) for chunk in chunks for frame in protocol.framer.feed(chunk)]
    table = load([chunk for chunk in chunks if chunk]).realtime
    assert table["time"].tolist() == [state.time for state in expected]
    assert table["q_actual"].tolist() == [state.q_actual.tolist() for state in expected]
    assert np.all(np.diff(table.time) >= 0)


@pytest.mark.property
@given(st.sampled_from(["1.8", "3.4", "5.11"]), st.binary(min_size=1216, max_size=1216))
def test_columns_equal_values_of_the_state(version: str, content: bytes) -> None:
    size = len(packet(0, version))
    data = size.to_bytes(4, "big") + content[: size - 4]
    state = urlink.decode(data, "realtime", version)[0]
    table = load([data, data]).realtime
    for name in table.fields:
        value = getattr(state, name)
        expected = np.array([int(each) for each in value] if isinstance(value, tuple) else value)
        np.testing.assert_array_equal(table[name][1], expected, err_msg=name)


def test_damage_is_reported_and_loses_only_affected_packets(tmp_path: Path) -> None:
    chunks = [packet(number) for number in range(40)]
    path = write(tmp_path / "run.urlog", [*chunks[:20], b"\0\1\2", "lost", "connected", *chunks[20:]])
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0xFF  # in the middle of the tenth packet
    path.write_bytes(bytes(data[:-300]))  # and the last one is cut off
    run = urlink.load(path)
    table = run.realtime
    numbers = table["tcp_force"][:, 0].astype(int).tolist()
    assert len(numbers) == 38
    assert set(range(39)) - set(numbers) == {9}
    assert [numbers[row] for row in table.begins] == [10, 20]
    assert not run.is_complete
    assert run.left_out > 300
    said = "\n".join(run.missing)
    assert "damaged or unfinished" in said
    assert "realtime: 3 bytes do not belong to a complete packet" in said
    assert "not closed properly" in said
    gap = table.resampled(1000)
    lost = (gap.time > table.time[18]) & (gap.time < table.time[19])
    assert np.isnan(gap["q_actual"][lost]).all()
    assert np.isfinite(gap["q_actual"][~lost][:15]).all()


def test_file_with_two_firmwares_has_two_parts() -> None:
    old, new = [packet(n, "3.4") for n in range(5)], [packet(n, "5.11") for n in range(5, 12)]
    run = load([*old, "lost", "connected", *new])
    table = run.realtime
    assert table["q_actual"][:, 0].tolist() == list(range(12))
    with pytest.raises(urlink.BadValue, match="'payload_mass' only in some of its parts"):
        table["payload_mass"]
    first, second = table.parts
    assert ("payload_mass" in first, "payload_mass" in second) == (False, True)
    assert second["payload_mass"].shape == (7,)
    assert second.time.tolist() == table.time[5:].tolist()
    assert any("payload_mass" in each for each in run.missing)
    later = table.between(table.time[3], table.time[8])
    assert [len(part) for part in later.parts] == [2, 3]
    assert later.parts[1]["q_actual"][:, 0].tolist() == [5, 6, 7]


def test_between_and_resampled_select_rows() -> None:
    states = []
    for number in range(101):
        angle = math.pi - 0.05 + number * 0.001  # passes half a turn, so the vector changes its direction
        vector = angle if angle <= math.pi else angle - 2 * math.pi
        states.append(bytes(RealtimeState("5.11", time=number, tool_vector_actual=[number, 0, 0, 0, 0, vector])))
    table = load(states).realtime
    part = table.between(0.02, 0.1)
    assert part["time"].tolist() == list(range(10, 50))
    assert part.between(0.03, 0.04)["time"].tolist() == [15, 16, 17, 18, 19]
    even = table.resampled(2000)
    assert len(even) == 401
    np.testing.assert_allclose(even["time"], np.arange(401) / 4, atol=1e-5)
    np.testing.assert_allclose(np.diff(even.time), 0.0005)
    turned = even["tool_vector_actual"][:, 5] % (2 * math.pi)
    np.testing.assert_allclose(turned, math.pi - 0.05 + np.arange(401) * 0.00025, atol=1e-5)
    assert even["robot_mode"].shape == (401,)
    assert even.wall[2] - even.wall[0] == np.timedelta64(1, "ms")
    for t0, t1 in ((2, 1), (math.nan, 1)):
        with pytest.raises(urlink.BadValue, match="expected two times with t0 <= t1"):
            table.between(t0, t1)
    for rate in (0, -1, math.inf, math.nan):
        with pytest.raises(urlink.BadValue, match="positive number of rows per second"):
            table.resampled(rate)
    with pytest.raises(urlink.BadValue, match="no rows to resample"):
        table.between(50, 60).resampled(10)


def test_robot_states_have_sub_packages_and_messages() -> None:
    def state(number: int) -> bytes:
        joints = JointData("5.11", q_actual=[number] * 6, joint_modes=[253] * 6)
        return bytes(RobotState(RobotModeData("5.11", robot_mode=7, is_power_on=True), joints))

    text = bytes(TextMessage("5.11", text="hello"))
    version = bytes(VersionMessage(major=5, minor=11, project_name="URControl", build_date="01-01-2024, 00:00:00"))
    run = load([version, state(0), state(1) + text, state(2)[:30], state(2)[30:]], name="primary")
    states = run.primary
    assert states["joint_data.q_actual"].tolist() == [[0] * 6, [1] * 6, [2] * 6]
    assert states["robot_mode_data.is_power_on"].tolist() == [True] * 3
    assert states.fields["joint_data.q_actual"].unit == "rad"
    assert states.joint_data["q_actual"].tolist() == states["joint_data.q_actual"].tolist()
    assert states.of(RobotModeData)["robot_mode"].tolist() == [7, 7, 7]
    assert states.of(urlink.packets.TextMessage)["text"].tolist() == ["hello"]
    assert states.of(urlink.packets.TextMessage).time.tolist() == [states.time[1]]
    assert [type(each).__name__ for each in states.messages] == ["VersionMessage", "TextMessage"]
    assert len(states.kinematics_info) == 0
    assert states.between(0.003, 1)["joint_data.q_actual"][:, 0].tolist() == [1, 2]
    with pytest.raises(urlink.BadValue, match="expected a class of sub-packages"):
        states.of(RealtimeState)
    with pytest.raises(AttributeError):
        states.nothing  # noqa: B018  # reading it raises


def test_rtde_table_follows_recipe() -> None:
    recipe = Recipe(["timestamp", "actual_q", "robot_mode"], ["DOUBLE", "VECTOR6D", "INT32"], 1)
    packages = [recipe.encode({"timestamp": number, "actual_q": [number] * 6, "robot_mode": 7}) for number in range(20)]
    info = {"asked": list(recipe.names), "names": list(recipe.names), "types": list(recipe.types), "number": 1}
    asked = bytes(OutputsReply("2.0", recipe=1, types=",".join(recipe.types)))
    chunks: list[bytes | str] = [
        *packages[:5],
        packages[5] + packages[6][:9],
        packages[6][9:],
        "lost",
        "connected",
        asked,
        *packages[7:],
    ]
    run = load(chunks, name="rtde", frequency=500.0, **info)
    assert run.rtde["timestamp"].tolist() == list(range(20))
    assert run.rtde["actual_q"].shape == (20, 6)
    assert run.rtde.fields["actual_q"].unit == "rad"
    assert run.rtde["robot_mode"].tolist() == [7] * 20
    assert run.rtde.begins == [7]


def test_to_frame_returns_pandas_or_explains_how_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    table = load([packet(number) for number in range(5)]).realtime
    for library, extra in (("pandas", "pandas"), ("polars", "polars")):
        with monkeypatch.context() as patched:
            patched.setitem(sys.modules, "pandas", None)
            patched.setitem(sys.modules, "polars", None)
            with pytest.raises(urlink.LocalError, match=rf"needs {extra}.*pip install 'urlink-robot\[{extra}\]'"):
                table.to_frame(library=library)
            with pytest.raises(urlink.LocalError, match="is not installed"):
                table.to_frame()
    with pytest.raises(urlink.BadValue, match="expected 'pandas' or 'polars'"):
        table.to_frame(library="excel")
    pandas = pytest.importorskip("pandas", reason="pandas is not installed; nox -f nightly.py -s data installs it")
    frame = table.to_frame("q_actual", "robot_mode")
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == ["wall", *(f"q_actual_{number}" for number in range(6)), "robot_mode"]
    assert frame["q_actual_3"].tolist() == [3, 4, 5, 6, 7]
    assert frame.index.name == "t"


def test_to_frame_returns_polars() -> None:
    table = load([packet(number) for number in range(5)]).realtime
    polars = pytest.importorskip("polars", reason="polars is not installed; nox -f nightly.py -s data installs it")
    frame = table.to_frame("q_actual", "robot_mode", library="polars")
    assert isinstance(frame, polars.DataFrame)
    assert frame.columns == ["t", "wall", *(f"q_actual_{number}" for number in range(6)), "robot_mode"]
    assert frame["q_actual_3"].to_list() == [3, 4, 5, 6, 7]
    assert frame["t"].to_list() == table.time.tolist()
    assert frame["wall"].dtype == polars.Datetime("ns")
    assert frame["robot_mode"].dtype == polars.Int64
    whole = table.to_frame(library="polars")
    assert whole.height == 5
    assert whole.width == 2 + sum(column.width or 1 for column in table.fields.values())
    assert whole["digital_input_bits"].dtype == polars.UInt64


@pytest.mark.parametrize("path", [CAPTURES / f"simulator-{version}.urlog" for version in ("1.8", "3.15", "5.25")])
@pytest.mark.simulated_time
def test_loaded_recording_equals_its_replay(path: Path) -> None:
    run = urlink.load(path)
    with urlink.connect(f"replay://{path}?rate=max") as robot:
        states = list(robot.realtime)
    assert run.realtime["time"].tolist() == [state.time for state in states]
    np.testing.assert_array_equal(run.realtime["q_actual"], [state.q_actual for state in states])
    assert len(run.primary) > 0


def test_channel_without_name_is_rejected(tmp_path: Path) -> None:
    path = write(tmp_path / "run.urlog", [])
    data = path.read_bytes()
    assert len(urlink.load(path).realtime) == 0
    assert urlink.load(path).duration == 0
    path.write_bytes(data[:8] + pack(Kind.CHANNEL, 0, Stamp(0, 0), b"[]"))
    with pytest.raises(urlink.BadRecording, match="channel 0 has no name"):
        urlink.load(path)


# -- hostile records ---------------------------------------------------------------------------------------

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["lost", "5.11", "UR5e", "realtime", ""]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=4),
    max_leaves=8,
)
payloads = st.one_of(
    json_values.map(lambda value: json.dumps(value).encode()),
    st.dictionaries(st.sampled_from(KEYS), json_values).map(
        lambda value: json.dumps({"name": "realtime", **value}).encode()
    ),
    st.binary(max_size=40),
    st.sampled_from([b"\xff\xfe{", b"[" * 100_000, b"1" * 5000, b'{"state": 1}', b"{}", b'{"name":"realtime"}']),
)


@pytest.mark.simulated_time
@pytest.mark.property
@example([(Kind.CHANNEL, b'{"name":"realtime","firmware":"5.11"}')])  # can be played, unlike most drawn examples
@example([(Kind.EVENT, b'{"state":"connected"}')])
@given(st.lists(st.tuples(st.sampled_from([Kind.CHANNEL, Kind.EVENT]), payloads), min_size=1, max_size=3))
def test_any_record_is_read_or_raises_link_error(records: list[tuple[Kind, bytes]]) -> None:
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=platforms.IS_WINDOWS) as folder:
        path = Path(folder) / "run.urlog"
        writer = RecordingWriter(path)
        channel = writer.add_channel({"name": "realtime", "firmware": "5.11", "model": "UR5e"})
        writer.write(Kind.BYTES, channel, Stamp(1.0, 1.0), packet(0))
        for kind, payload in records:
            writer.write(kind, channel, Stamp(2.0, 2.0), payload)
        writer.write(Kind.BYTES, channel, Stamp(3.0, 3.0), packet(1))
        writer.close()
        with contextlib.suppress(urlink.LinkError):
            run = urlink.load(path)
            for read in (
                lambda: run.realtime["q_actual"],
                lambda: run.missing,
                lambda: run.firmware,
                lambda: run.model,
                lambda: run.kinematics,
                lambda: repr(run),
                lambda: run._repr_html_(),
            ):
                with contextlib.suppress(urlink.LinkError):
                    read()
        with contextlib.suppress(urlink.LinkError), urlink.connect(path) as robot:
            robot.realtime.wait(timeout=5.0)


@pytest.mark.parametrize(
    "payload", [b"\xff\xfe{", b"{", b"[]", b"{}", b'{"state": 1}', b"[" * 100_000, b"1" * 5000], ids=range(7)
)
def test_invalid_event_raises_bad_recording(tmp_path: Path, payload: bytes) -> None:
    path = tmp_path / "run.urlog"
    writer = RecordingWriter(path)
    channel = writer.add_channel({"name": "realtime", "firmware": "5.11"})
    writer.write(Kind.BYTES, channel, Stamp(1.0, 1.0), packet(0))
    writer.write(Kind.EVENT, channel, Stamp(2.0, 2.0), payload)
    writer.close()
    found = r"run.urlog: (the description of channel 0 is not valid JSON|channel 0 has no state)"
    with pytest.raises(urlink.BadRecording, match=found):
        _ = urlink.load(path).realtime
