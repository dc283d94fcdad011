"""Convert a bundle of `urlink accept` to a table row and a recording for the repository.

    python captures/from_bundle.py run.zip                              # a row for docs/compatibility.md, on stdout
    python captures/from_bundle.py run.zip --capture robot-5.11.urlog   # and a recording for the tests

The recording contains the first half second of the real-time and primary interfaces. Its sender must agree to the
publication, because it contains the calibration of the arm. captures/make.py then makes its golden file.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from linkcore.recording.file import Kind, RecordingWriter
from urlink_accept.acceptance.bundle import Bundle, opened
from urlink_accept.acceptance.report import judge

#: Length of a capture, in s.
SECONDS = 0.5


def row(bundle: Bundle) -> str:
    """Return a row of the table in docs/compatibility.md, "Accepted controllers"."""
    evidence, verdicts = bundle.evidence, judge(bundle.evidence, bundle.requirements)
    known, about = evidence.identity, evidence.last("about") or {}
    wrong = ", ".join(each.requirement.name for each in verdicts if each.state == "not held")
    states = [each.state for each in verdicts]
    sizes = ", ".join(f"{size} B" for size in sorted(evidence.realtime.sizes))
    arm = "not known" if known is None else f"{known.model or 'not named'}, {known.firmware}"
    counts = f"{states.count('held')} held, {states.count('not held')} not, {states.count('not tried')} not tried"
    return f"| {arm} | {about.get('urlink')} | {sizes} | {counts} | {wrong or '-'} | {bundle.digest[:12]} |"


def capture(bundle: Bundle, path: Path) -> None:
    """Write the start of the longest connection to each interface to a new recording.

    Raises:
        BadRecording: If the file exists, or cannot be written.
    """
    writer = RecordingWriter(path)
    identity = bundle.evidence.identity
    said = {} if identity is None else identity.description()
    for name in ("realtime", "primary"):
        wire = max(bundle.evidence.received(name), key=lambda each: len(each.chunks))
        address = f"a robot: bundle {bundle.digest[:12]}"
        channel = writer.add_channel({"name": name, "address": address, **said})
        first = wire.chunks[0][0].monotonic
        for stamp, data in wire.chunks:
            if stamp.monotonic <= first + SECONDS:
                writer.write(Kind.BYTES, channel, stamp, data)
    writer.close()


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the row, and write the capture if requested."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--capture", type=Path, metavar="FILE")
    args = parser.parse_args(arguments)
    with opened(args.bundle) as bundle:
        print(row(bundle))
        if args.capture is not None:
            capture(bundle, args.capture)


if __name__ == "__main__":
    main()
