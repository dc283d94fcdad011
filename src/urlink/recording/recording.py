"""`load` and `Recording`: recorded data of a robot as arrays."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from linkcore.errors import BadRecording, LocalError, WrongPeer
from linkcore.names import StrictAttributes
from linkcore.recording.columns import PacketColumns, is_continuous
from linkcore.recording.file import Kind, Progress, described, unseen
from linkcore.recording.index import RecordIndex
from linkcore.recording.mcap_file import Topic, write_stretches
from linkcore.recording.packets import Channel, read_channel
from linkcore.recording.table import ClockColumn, Table
from linkcore.recording.table_files import chosen, export, format_of
from linkcore.streaming.plotting import Curves, Plot
from linkcore.wire.framing import PacketProtocol
from linkcore.wire.packet import State

from ..arm.kinematics import Arm
from ..errors.stop_explanation import StopExplanation
from ..protocol.field_names import name_on
from ..protocol.firmware import Firmware
from ..protocol.primary.protocol import STATE_PERIODS, PrimaryProtocol
from ..protocol.primary.robot_message import RobotMessage
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.packets import RealtimeState
from ..protocol.realtime.protocol import RealtimeProtocol, periods_of
from ..protocol.rtde.protocol import CLOCK, RtdeProtocol, package_periods
from ..protocol.rtde.recipes import Outputs
from ..rtde.outputs import recorded_plan
from ..session.identity import described_firmware, described_frequency, described_identity
from .robot_state_table import RobotStates
from .ros_messages import description_topic, log_topic, topics_of


def load(path: str | os.PathLike[str], *, progress: Progress | None = None) -> Recording:
    """Load a recording as arrays.

    Damaged and unfinished parts are skipped; `Recording.missing` lists them.

    Args:
        path: Path of the file.
        progress: Function that is called with the completed fraction, 0 to 1, while the file is indexed. When a stream
            is first used, its packets are indexed, and the function is called again.

    Raises:
        BadRecording: If the file does not exist, or is not a recording of a robot.
    """
    return Recording(path, progress=progress)


class Recording(StrictAttributes):
    """Recorded data of a robot as arrays. Call `load` to create it.

    Attributes:
        path: Path of the file.
        channels: Descriptions of the streams, as the recorder wrote them. The keys are the names of the streams.
    """

    def __init__(self, path: str | os.PathLike[str], *, progress: Progress | None = None) -> None:
        self.path = Path(path)
        self._progress = progress or unseen
        self._index = index = RecordIndex(path, self._progress)
        self.channels: dict[str, Mapping[str, Any]] = {}
        self._numbers: dict[str, int] = {}
        for record in np.flatnonzero(index.kind == Kind.CHANNEL).tolist():
            info = described(self.path, int(index.channel[record]), index.payload(record), "name")
            self.channels[info["name"]] = info
            self._numbers[info["name"]] = int(index.channel[record])
        # Each stream was written by its own thread, so the first record might not have the earliest stamp.
        times = index.monotonic[index.kind == Kind.BYTES]
        self._start, self._stop = (int(times.min()), int(times.max())) if len(times) else (0, 0)

    # -- the robot and the file --------------------------------------------------------------------

    @property
    def firmware(self) -> Firmware | None:
        """Firmware of the controller at the start of the recording; None if it was not recorded."""
        said = self._said("firmware")
        if said is None:
            return None
        info = next(info for info in self.channels.values() if info.get("firmware") is not None)
        return described_firmware(info, said)

    @property
    def model(self) -> str | None:
        """Name of the arm, such as "UR5e"; None if it was not recorded."""
        return self._said("model")

    def _said(self, key: str) -> str | None:
        said = next((info[key] for info in self.channels.values() if info.get(key) is not None), None)
        if said is not None and not isinstance(said, str):
            raise BadRecording(f"{self.path}: the {key} is {said!r:.80}; expected a string")
        return said

    @property
    def kinematics(self) -> Arm:
        """Kinematics of the recorded arm, calibrated if its DH parameters were recorded; see `Robot.kinematics`.

        Raises:
            LocalError: If the model was not recorded, or is unknown.
            BadRecording: If the firmware was not recorded, or the recorded DH parameters are invalid.
        """
        for info in self.channels.values():
            if "firmware" in info:
                return described_identity(info).kinematics
        raise BadRecording(f"{self.path} does not name the firmware of the controller")

    def _arm(self) -> Arm | None:
        with contextlib.suppress(LocalError, WrongPeer):
            return self.kinematics
        return None

    def _hint(self, name: str) -> str | None:
        field = name if name in RealtimeState.FIELDS else name_on("realtime", name)
        return None if field is None else f"; write recording.realtime[{field!r}]"

    @property
    def duration(self) -> float:
        """Time from the first bytes to the last, in seconds."""
        return (self._stop - self._start) / 1e9

    @property
    def is_complete(self) -> bool:
        """Whether the recorder closed the file properly."""
        return self._index.is_complete

    @property
    def left_out(self) -> int:
        """Number of bytes in unfinished or damaged parts of the file. These parts are skipped."""
        return self._index.left_out

    @property
    def missing(self) -> tuple[str, ...]:
        """Lost and unreadable parts, one string each; empty if nothing is missing. Reads the whole recording."""
        said = [f"{gap.size} bytes at offset {gap.offset} are damaged or unfinished" for gap in self._index.gaps]
        if not self.is_complete:
            said.append("it was not closed properly")
        for name, table in self.tables.items():
            said += [f"{name}: {each}" for each in table.missing]
        return tuple(said)

    # -- streams -----------------------------------------------------------------------------------

    @cached_property
    def realtime(self) -> Table:
        """Table of the real-time states: ``run.realtime["q_actual"]`` has the shape (n, 6).

        Raises:
            BadRecording: If the recording does not contain them.
        """
        channel = self._channel("realtime", RealtimeProtocol, RealtimeState)
        # If the recorder stores fewer packets than the robot sends, it also stores the rate of the stored packets.
        rate = self._info("realtime").get("rate")
        frequency = described_frequency(self._info("realtime"))
        if isinstance(rate, (int, float)) and 0 < rate < float("inf"):
            periods: tuple[float, ...] = (1.0 / rate,)
        elif frequency is not None:
            periods = (1.0 / frequency,)
        else:
            periods = periods_of(channel.parts[0].layout.size if channel.parts else 0)
        return self._table("realtime", channel, ClockColumn("time", 1.0, periods))

    @cached_property
    def primary(self) -> RobotStates:
        """Table of the robot states of the primary interface, with their sub-packages and messages.

        Raises:
            BadRecording: If the recording does not contain them.
        """
        return self._robot_states("primary")

    @cached_property
    def secondary(self) -> RobotStates:
        """Table of the robot states of the secondary interface.

        Raises:
            BadRecording: If the recording does not contain them.
        """
        return self._robot_states("secondary")

    @cached_property
    def rtde(self) -> Table:
        """Table of the variables of an RTDE stream. The variable names are the names of the columns.

        Raises:
            BadRecording: If the recording does not contain them.
        """
        plan = recorded_plan(self._info("rtde"), Outputs)
        channel = self._channel("rtde", lambda: RtdeProtocol(plan), Outputs)
        number = None if plan.recorded is None else plan.recorded.number
        firmware = self.firmware
        periods = package_periods(plan.frequency, None if firmware is None else firmware.rate, number)
        return self._table("rtde", channel, ClockColumn(CLOCK, 1.0, periods))

    @property
    def tables(self) -> dict[str, Table]:
        """Tables of all recorded streams. The keys are the names of the streams."""
        return {
            name: getattr(self, name) for name in ("realtime", "primary", "secondary", "rtde") if name in self.channels
        }

    # -- stops -------------------------------------------------------------------------------------

    def explain(self) -> list[StopExplanation]:
        """Explain all stops in the recording, in order of time.

        Missing streams and fields never raise an error; `StopExplanation.missing` lists them.

        Returns:
            One explanation for each safety stop, and for each program that another client seems to have replaced.
        """
        from ..diagnosis.recorded import record_of  # imported here: few programs need it
        from ..diagnosis.stop_causes import explain

        firmware = self.firmware
        record = record_of(self.tables, self.model, is_cb2=firmware is not None and firmware.is_cb2)
        return explain(record)

    # -- export and plots --------------------------------------------------------------------------

    def export(
        self,
        path: str | os.PathLike[str],
        fields: Sequence[str] | str | None = None,
        rate: float | None = None,
        *,
        progress: Progress | None = None,
    ) -> Path:
        """Export the recording to a file for another program. The complete file replaces a file of the same name.

        Args:
            path: Path of the new file. The suffix selects the format; `urlink export --help` lists the formats.
            fields: Names, such as ``["q_actual", "joint_data.T_motor", "rtde.actual_q"]``, or one name as a string;
                ``"q_actual_3"`` is one joint. None exports all fields; for a .csv or .parquet file, None exports only
                the first recorded table.
            rate: Rate to resample to, in rows per second; None exports the packets as they were received.
            progress: Function that is called with the completed fraction, 0 to 1.

        Returns:
            Path of the file.

        Raises:
            BadValue: If a suffix or field is unknown, or fields of several tables are given for a one-table format.
            BadRecording: If the file cannot be written.
            LocalError: If the package for the format is not installed. The message explains how to install it.
        """
        tables = self.tables
        kind = format_of(path)
        if fields is None and kind is not None and kind.holds_one:
            tables = dict(list(tables.items())[:1])
        writers = {".mcap": self._write_mcap}
        return export(path, chosen(tables, fields, rate), progress, self._about(), writers)

    def plot(self, *fields: str, start: float = 0.0, end: float = float("inf")) -> Plot:
        """Plot fields over time, each in its own panel. A notebook shows the plot; `Plot.save` writes it to a file.

        Args:
            fields: Names of the fields, as for `export`.
            start, end: Time range to plot, in seconds since the start of the recording.

        Raises:
            BadValue: If no field is given, a field is unknown or not numeric, or `end` is before `start`.
        """
        tables = chosen(self.tables, fields) if fields else {}
        curves = []
        for field in fields:
            name, table, key = next(
                (name, table, key)
                for name, table in tables.items()
                for key in (field, field.partition(".")[2])
                if key in table
            )
            part = table.between(start, end)
            label = key if len(tables) == 1 else f"{name}.{key}"
            time, values = part.time, part[key]
            if part.begins and is_continuous(table.fields[key]):
                # A NaN value interrupts the line of the plot while the connection was lost.
                time = np.insert(time, part.begins, time[part.begins])
                values = np.insert(values, part.begins, np.nan, axis=0)
            curves.append(Curves(label, table.fields[key].unit, time, values))
        who = f"{self.model}, firmware {self.firmware}" if self.model else ""
        return Plot(curves, f"{self.path.name}  {who}".strip())

    def _about(self) -> dict[str, str]:
        """Return the metadata for an exported file."""
        said = {"robot": self.model, "firmware": self.firmware, "address": self._said("address")}
        records = np.flatnonzero(self._index.kind == Kind.BYTES)
        if len(records):
            first = records[np.argmin(self._index.monotonic[records])]
            said["start"] = f"{self._index.wall[first].astype('M8[ns]')}Z"
        said["clock"] = (
            "t: s since start, by the monotonic clock of the computer that recorded; wall: its UTC; "
            "time and timestamp: the controller's own clock"
        )
        return {key: str(value) for key, value in said.items() if value is not None}

    def _write_mcap(
        self, path: Path, tables: Mapping[str, Table], about: Mapping[str, str], progress: Progress
    ) -> None:
        tables = {name: table for name, table in tables.items() if len(table)}
        arm = self._arm() if tables else None
        described = [] if arm is None else [description_topic(arm, min(each.wall[0] for each in tables.values()))]

        def topics(start: float, stop: float) -> Iterable[Topic]:
            found: dict[str, Topic] = {}
            for name, table in tables.items():
                for topic in topics_of(name, table.between(start, stop), arm):
                    found.setdefault(topic.name, topic)  # if several streams have this topic, keep the first
                if isinstance(stream := self.tables[name], RobotStates):
                    said = stream.of(RobotMessage)
                    begin, end = np.searchsorted(said.time, [start, stop]).tolist()
                    found.setdefault("/log", log_topic(stream.robot_messages[begin:end], said.wall[begin:end]))
            return found.values()

        write_stretches(path, tables, topics, about, progress, described)

    def _info(self, name: str) -> Mapping[str, Any]:
        if name not in self.channels:
            there = ", ".join(self.channels) or "nothing"
            raise BadRecording(f"{self.path} has no channel {name!r}; its channels are: {there}")
        return self.channels[name]

    def _channel(
        self, name: str, protocol: Callable[[], PacketProtocol], kind: type[State], *, is_uniform: bool = True
    ) -> Channel:
        self._info(name)
        return read_channel(
            self._index, self._numbers[name], protocol, kind, is_uniform=is_uniform, progress=self._progress
        )

    def _robot_states(self, name: str) -> RobotStates:
        channel = self._channel(name, PrimaryProtocol, RobotState, is_uniform=False)
        is_known = self.firmware is not None and not self.firmware.is_cb2
        clock = ClockColumn("robot_mode_data.timestamp", 1e-6, STATE_PERIODS) if is_known else None
        return RobotStates(name, channel.others, self._timed, channel.begins, self._missing(name, channel), clock)

    def _table(self, name: str, channel: Channel, clock: ClockColumn) -> Table:
        records = np.concatenate([part.record for part in channel.parts]) if channel.parts else np.empty(0, np.int64)
        time, wall = self._timed(records)
        begins = np.searchsorted(records, channel.begins).tolist()
        missing = self._missing(name, channel)
        columns = PacketColumns(channel.parts)
        if columns.partial:
            missing.append(f"recorded only in part, because the firmware changed: {', '.join(columns.partial)}")
        return Table(f"{self.path.name} ({name})", columns, time, wall, begins, missing, clock)

    def _timed(self, records: Any) -> tuple[Any, Any]:
        """Return two times for each record number: seconds since the start of the recording, and wall time."""
        index = self._index
        return (index.monotonic[records] - self._start) / 1e9, index.wall[records].astype("M8[ns]")

    def _missing(self, name: str, channel: Channel) -> list[str]:
        said = [f"reconnected {len(channel.begins)} times"] if channel.begins else []
        if channel.skipped:
            said.append(f"{channel.skipped} bytes do not belong to a complete packet")
        if channel.failed:
            said.append(f"{len(channel.failed)} packets could not be read; the first: {channel.failed[0]}")
        return said

    # -- representation ---------------------------------------------------------------------------

    def __repr__(self) -> str:
        streams = ", ".join(self.channels) or "nothing"
        who = f"{self.model or 'robot'} firmware {self.firmware or 'unknown'}"
        return f"<Recording {self.path}: {streams} of {who}, {self.duration:.3f} s>"

    def _repr_html_(self) -> str:
        from linkcore.text import html_table  # imported here to keep the import of the package fast

        rows = [
            (
                name,
                len(table),
                len(table.fields),
                "" if not len(table) else f"{table.time[0]:.3f} to {table.time[-1]:.3f} s",
            )
            for name, table in self.tables.items()
        ]
        return html_table(repr(self), ("stream", "rows", "fields", "time"), rows, self.missing)
