"""Turn a bundle of `urlink accept` into what the repository keeps of it.

    python captures/from_bundle.py run.zip                              # a row for docs/compatibility.md, on stdout
    python captures/from_bundle.py run.zip --capture robot-5.11.urlog   # and a recording for the tests

The recording has the first half second of the real-time and primary interfaces. Its sender has to agree to it: the
calibration of the arm is in it. Its golden file is then made by captures/make.py.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from linkcore.recording.file import Kind, RecordingWriter
from urlink_accept.acceptance.bundle import Bundle, opened
from urlink_accept.acceptance.report import judge

#: Seconds that a capture holds.
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
    """Write the beginning of the longest connection to each of the two interfaces into a new recording.

    Raises:
        BadRecording: the file exists, or cannot be written.
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
    """Do what the arguments say."""
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
