from __future__ import annotations

import json
import tracemalloc
import zipfile
from pathlib import Path

import pytest

import urlink.cli
import urlink_accept.acceptance.bundle as bundle_module
from captures.from_bundle import capture, row
from captures.make import golden
from linkcore.clock import Stamp
from linkcore.errors import BadRecording
from linkcore.recording.file import Kind, RecordingFile, RecordingWriter
from linkcore.text import strict_json
from urlink_accept.acceptance.bundle import opened, pack
from urlink_accept.acceptance.evidence import Evidence
from urlink_accept.acceptance.logbook import NOTES
from urlink_accept.acceptance.report import as_text, judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import run

#: A name that starts in one chunk and ends in the next, and a serial number.
CHUNKS = (
    b"Connected: Universal Robots Dashboard Server\n",
    b"Loaded program: /programs/secr",
    b"et.urp\n20205300123\n",
)


@pytest.fixture
def logbook(tmp_path: Path) -> Path:
    """Logbook of a dashboard connection that contains the name of a program."""
    path = tmp_path / "logbook.urlog"
    writer = RecordingWriter(path)
    notes, dashboard = writer.add_channel({"name": NOTES}), writer.add_channel({"name": "dashboard"})
    stamp = Stamp(1.0, 1.7e9)
    writer.write(Kind.EVENT, dashboard, stamp, b'{"state": "connected", "error": null}')
    for chunk in CHUNKS:
        writer.write(Kind.BYTES, dashboard, stamp, chunk)
    writer.write(Kind.EVENT, dashboard, stamp, b'{"state": "lost", "error": "10.0.0.7:29999 closed the connection"}')
    reply = "Loaded program: /programs/secret.urp"
    said = {"step": "dashboard", "asked": "get loaded program", "reply": reply, "error": None}
    writer.write(Kind.BYTES, notes, stamp, strict_json(said).encode())
    writer.close()
    return path


def test_pack_overwrites_names_serial_numbers_and_addresses(logbook: Path, tmp_path: Path) -> None:
    pack(logbook, tmp_path / "run.zip", requirements(), {"owner": "us"}, ("10.0.0.7",))
    with opened(tmp_path / "run.zip") as bundle:
        (wire,) = bundle.evidence.received("dashboard")
        assert [len(data) for _, data in wire.chunks] == list(map(len, CHUNKS))
        assert wire.data == CHUNKS[0] + b"Loaded program: xxxxxxxxxxxxxxxxxxxx\nxxxxxxxxxxx\n"
        (lost,) = (
            json.loads(record.payload)
            for record in RecordingFile(bundle.recording)
            if record.kind is Kind.EVENT and b"lost" in record.payload
        )
        assert lost["error"] == "xxxxxxxx:29999 closed the connection"
        assert bundle.evidence.said("dashboard")[0].said["reply"] == "Loaded program: xxxxxxxxxxxxxxxxxxxx"
        assert (bundle.requirements, bundle.site) == (requirements(), {"owner": "us"})


def test_pack_writes_recording_requirements_and_manifest(logbook: Path, tmp_path: Path) -> None:
    pack(logbook, tmp_path / "run.zip", requirements(), {})
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        assert archive.namelist() == ["bytes.urlog", "requirements.toml", "MANIFEST.json"]


@pytest.mark.parametrize("part", ["bytes.urlog", "requirements.toml", "MANIFEST.json"])
def test_opened_rejects_changed_bundle(logbook: Path, tmp_path: Path, part: str) -> None:
    pack(logbook, tmp_path / "run.zip", requirements(), {})
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    parts[part] = parts[part].replace(b"0", b"1", 1)
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    with pytest.raises(BadRecording), opened(tmp_path / "other.zip"):
        pass


def test_opened_rejects_other_files(tmp_path: Path) -> None:
    (tmp_path / "run.zip").write_bytes(b"PK")
    for name in ("run.zip", "none.zip"):
        with pytest.raises(BadRecording, match="is not a bundle"), opened(tmp_path / name):
            pass


@pytest.mark.parametrize(
    ("manifest", "problem"),
    [
        (b"{}", "is not a bundle"),
        (b"[" * 50_000, "is not a bundle"),
        (b'{"format": 1, "files": {"bytes.urlog": "0", "requirements.toml": "0"}}', "larger than 5000000 bytes"),
        (b" " * 100_000, "MANIFEST.json is larger than 65536 bytes"),
    ],
)
def test_opened_rejects_zip_bomb(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, manifest: bytes, problem: str
) -> None:
    """Only the necessary parts are unpacked, and never a whole part in memory."""
    monkeypatch.setitem(bundle_module._LARGEST, "bytes.urlog", 5_000_000)
    path = tmp_path / "run.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("MANIFEST.json", manifest)
        archive.writestr("requirements.toml", b"")
        archive.writestr("bytes.urlog", bytes(20_000_000))
    assert path.stat().st_size < 100_000
    tracemalloc.start()
    try:
        with pytest.raises(BadRecording, match=problem), opened(path):
            pass
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_opened_rejects_other_compressions(tmp_path: Path) -> None:
    path = tmp_path / "run.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("MANIFEST.json", b"{}")
    with pytest.raises(BadRecording, match="other than deflate"), opened(path):
        pass


def test_evidence_rejects_deep_json(tmp_path: Path) -> None:
    path = tmp_path / "logbook.urlog"
    writer = RecordingWriter(path)
    notes = writer.add_channel({"name": NOTES})
    writer.write(Kind.BYTES, notes, Stamp(1.0, 1.7e9), b"[" * 100_000)
    writer.close()
    with pytest.raises(BadRecording, match="is not valid JSON"):
        Evidence(path)


@pytest.mark.simulated_time
def test_replay_prints_identical_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logbook, path = tmp_path / "logbook.urlog", tmp_path / "run.zip"
    secrets = run("sim://?firmware=1.6", logbook, (0,), lambda number, does: "", seconds=1.5)
    pack(logbook, path, requirements(), {}, secrets)
    with opened(path) as bundle:
        verdicts = judge(bundle.evidence, bundle.requirements)
        page = as_text(bundle.evidence, verdicts, bundle.site, bundle.digest)
        line = row(bundle)
        capture(bundle, tmp_path / "robot-1.6.urlog")
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert (cells[0], cells[2], cells[4], cells[5]) == ("not named, 1.6", "764 B", "-", bundle.digest[:12])
    assert golden(tmp_path / "robot-1.6.urlog")["packets"]["realtime"]["RealtimeState"]["count"] > 10
    plain = judge(Evidence(logbook), requirements())
    assert [(each.state, each.value) for each in plain] == [(each.state, each.value) for each in verdicts]
    assert urlink.cli.main(["accept", "--replay", str(path)]) == 0
    assert capsys.readouterr().out == page + "\n"


@pytest.mark.parametrize("arguments", [[], ["sim://", "--replay", "run.zip"], ["sim://", "--yes"]])
def test_accept_rejects_wrong_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert urlink.cli.main(["accept", *arguments]) == 2
    assert "expected" in (said := capsys.readouterr().err) or "--stage" in said
