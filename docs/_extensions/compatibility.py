"""The directives `releases` and `recordings`: the firmware table, and the recordings in the repository."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from _tables import spans, table
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from linkcore.recording.file import RecordingFile
from urlink.protocol.firmware import RELEASES

#: Matches the evidence of a row that is confirmed by bytes of a controller: "real bytes", but not "real-time".
_REAL = re.compile(r"\breal (?=bytes|connection)")

_CAPTURES = Path(__file__).parents[2] / "captures"


class ReleasesDirective(SphinxDirective):
    """The firmware table."""

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each release that changed a size."""
        return tables()


def tables() -> list[nodes.Node]:
    """Return the firmware table."""
    head = ("firmware", "controller", "real-time", "first state", "later states", "real bytes", "evidence")
    return [table(head, [_row(number) for number in range(len(RELEASES))])]


def _row(number: int) -> tuple[str, ...]:
    row = RELEASES[number]
    controller = {1: "CB2", 3: "CB3", 5: "e-Series", 10: "PolyScope X"}[row.since.major]
    return (
        spans([number]),
        controller,
        f"{row.realtime} B, {row.since.rate} Hz",
        f"{row.first_state_size} B",
        f"{row.state_size} B",
        "some" if _REAL.search(row.evidence) else "none",
        row.evidence,
    )


class RecordingsDirective(SphinxDirective):
    """The recordings in the repository's captures/."""

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each recording, which is read from the file."""
        rows = []
        for path in sorted(_CAPTURES.rglob("*.urlog")):
            self.env.note_dependency(str(path))
            channels = RecordingFile(path).channels.values()
            firmware = next((str(info["firmware"]) for info in channels if "firmware" in info), "")
            model = next((str(info["model"]) for info in channels if info.get("model")), "")
            names = ", ".join(info["name"] for info in channels)
            rows.append((str(path.relative_to(_CAPTURES.parent)), firmware, model, names))
        if not rows:
            return [nodes.paragraph("", "This checkout does not contain recordings.")]
        return [table(("file", "firmware", "arm", "interfaces"), rows, code=(0,))]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives."""
    app.add_directive("releases", ReleasesDirective)
    app.add_directive("recordings", RecordingsDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
