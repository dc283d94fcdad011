"""The recorded runs of the original MRC, and a controller of rhdlink that takes the place of MRC.

A run is a table with a row for each tick: the values that MRC wrote in its request, and the answer of the robot. The
answers are fed to a `MissionController`, and its requests are compared with those of MRC.
"""

from __future__ import annotations

import csv
import gzip
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rhdlink.smrcl.controller import MissionController
from rhdlink.smrcl.profile import MRC
from rhdlink.smrcl.recipients import SaidKind
from rhdlink.smrcl.robot_conf import SMR, VELOMEGA, RobotConf

Row = dict[str, str]


def drives() -> Path | None:
    """Return the folder of the recorded drives, next to the repository, or None if it does not exist."""
    folder = Path(__file__).resolve().parents[4] / "shared" / "captures" / "mrc"
    return folder if folder.is_dir() else None


@dataclass(frozen=True)
class Recorded:
    """A recorded run.

    Attributes:
        script: Name of the script, or of the dialogue (``.ses``).
        robot: Drive of the robot, "velomega" or "differential".
        variables: Additional variables of the robot; see the README of the recordings.
        folder: Folder of the recordings.
        recording, stdout, transcript, logs: Names of files in this folder.
        source: Text of the script.
    """

    script: str
    robot: str
    variables: str
    folder: Path
    recording: str
    source: str
    stdout: str = ""
    transcript: str = ""
    logs: tuple[str, ...] = ()

    @property
    def conf(self) -> RobotConf:
        return VELOMEGA if self.robot == "velomega" else SMR

    def rows(self) -> list[Row]:
        path = self.folder / self.recording
        with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
            columns, *rows = csv.reader(file)
        # Some recordings have `tick` twice.
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def tables(self) -> tuple[dict[str, int], dict[str, list[int]]]:
        """Return the lengths of the read variables, and the values of the write variables."""
        if self.robot == "velomega":
            read = {"tick": 1, "transpos": 1, "rotpos": 1}
            write = {"cmdtransvel": [0], "cmdrotvel": [0]}
        else:
            read = {"tick": 1, "encl": 1, "encr": 1, "linesensor": 8, "irsensor": 6}
            write = {"speedl": [0], "speedr": [0], "resetmotorl": [0], "resetmotorr": [0]}
        if "extra" in self.variables:
            read |= {"button": 1, "adc": 4}
            write |= {"lamp": [0], "servo": [0, 0, 0]}
        return read, write

    def answer(self, row: Row) -> dict[str, list[int]]:
        """Return the answer of the robot in a tick."""
        tick = int(row["tick"])
        raw = {"tick": [tick]}
        if self.robot == "velomega":
            raw |= {"transpos": [int(row["transpos"])], "rotpos": [int(row["rotpos"])]}
        else:
            raw |= {"encl": [int(row["encl"])], "encr": [int(row["encr"])], "linesensor": [128] * 8}
            raw["irsensor"] = [140 if "ir 140" in self.variables else 0] * 6
        if "extra" in self.variables:
            raw["button"] = [int(150 <= tick < 200)]
            raw["adc"] = [10, -20, 30 + tick, 7 * (tick // 100)]
        return raw

    def file(self, name: str) -> str:
        path = self.folder / name
        if path.suffix == ".gz":
            return gzip.decompress(path.read_bytes()).decode("latin-1")
        return path.read_text(encoding="latin-1")


def manifest(folder: Path) -> list[Recorded]:
    """Return the runs of the manifest."""
    oracle = folder / "oracle"
    with (oracle / "MANIFEST.csv").open() as file:
        return [
            Recorded(
                script=row["script"],
                robot=row["robot"],
                variables=row["variables"],
                folder=oracle / "recordings",
                recording=row["recording"],
                source=(oracle / row["script"]).read_text(encoding="latin-1"),
                stdout=row["stdout"],
                transcript=row["transcript"],
                logs=tuple(row["logs"].split()),
            )
            for row in csv.DictReader(file)
        ]


def older_drives(folder: Path) -> list[Recorded]:
    """Return the drives that are older than the manifest; they contain the motion only."""
    arc, spiral = ((folder / name).read_text() for name in ("arc.smr", "spiral.smr"))
    then = "turnr 0.5 90\n{}\nwait {}\n"
    scripts = {
        "arc_lockstep": arc,
        "spiral_lockstep": spiral,
        "arc_then_wait": "turnr 0.5 90\nwait 20\n",
        "arc_then_stop": then.format("stop", 10),
    }
    return [
        Recorded(name, robot, "plain", folder, f"{kind}_{name}.csv", source)
        for kind, robot in (("vw", "velomega"), ("smr", "differential"))
        for name, source in scripts.items()
    ]


@dataclass
class Replayed:
    """Output of a controller of rhdlink for the answers of a run.

    Attributes:
        ticks: Number of requests until the controller finished.
        is_finished: Whether the controller finished.
        differences: Differences between the requests: (tick, variable, value of MRC, value of rhdlink).
        printed: Printed text.
        transcript: Lines of the dialogue.
        logs: Logs by name.
    """

    ticks: int = 0
    is_finished: bool = False
    differences: list[tuple[int, str, int, int]] = field(default_factory=list)
    printed: str = ""
    transcript: list[str] = field(default_factory=list)
    logs: dict[str, str] = field(default_factory=dict)


def replay(recorded: Recorded) -> Replayed:
    """Run a controller in the place of MRC."""
    read, write = recorded.tables()
    controller = MissionController(recorded.conf, read, write, profile=MRC)
    sent: dict[int, list[str]] = {}
    session = None
    if recorded.script.endswith(".ses"):
        session = controller.serve().connect()
        for line in recorded.source.splitlines():
            if line and not line.startswith("#"):
                tick, text = line.split(" ", 1)
                sent.setdefault(int(tick), []).append(text)
    else:
        controller.load(recorded.source)
    found = Replayed()
    written = {name: list(words) for name, words in write.items()}
    request = controller.first_request()
    unfinished = b""
    for row in recorded.rows():
        found.ticks += 1
        written.update(request)
        found.differences += _differences(found.ticks, row, written)
        if controller.is_finished:
            break
        for text in sent.get(found.ticks, ()):
            found.transcript.append(f"{found.ticks} > {text}")
            assert session is not None
            session.receive(f"{text}\n".encode("latin-1"))
        request = controller.step(recorded.answer(row))
        for said in controller.take_said():
            found.printed += said.printed
            if said.kind is SaidKind.LOG:
                name, _, text = said.text.partition("\n")
                found.logs[name] = text
        if session is not None:
            *lines, unfinished = (unfinished + session.take()).split(b"\n")
            found.transcript += [f"{found.ticks} < {line.decode('latin-1')}" for line in lines]
    found.is_finished = controller.is_finished
    if session is not None:
        found.transcript.append(f"{found.ticks} - closed by the server")
    found.logs["log"] = controller.effects.log.text
    return found


def _differences(tick: int, row: Row, written: dict[str, list[int]]) -> Sequence[tuple[int, str, int, int]]:
    differences = []
    for name, words in written.items():
        for index, word in enumerate(words):
            column = name if len(words) == 1 else f"{name}{index}"
            if int(row[column]) != word:
                differences.append((tick, column, int(row[column]), word))
    return differences


def normal(text: str) -> str:
    """Return the text without meaningless details: the sign of nan, addresses, and the kind of line ends."""
    text = text.replace("-nan", "nan").replace("\r", "").replace("\0", " ")
    return re.sub(r"\b(start|end|label) ([0-9a-f]+|<address>)(?= )", r"\1 <address>", text)
