"""Draw docs/images/dissect.svg: the first fields of a packet, byte by byte, as `urlink dissect` prints them."""

import argparse
import contextlib
import io
from pathlib import Path

from _terminal import IMAGES, save, session

import urlink.cli

CAPTURE = Path(__file__).parents[1] / "captures" / "simulator-5.11.urlog"
ARGUMENTS = ("--interface", "realtime", "--count", "1")
#: Number of lines in the figure. The packet has more than 100 fields.
LINES = 20
COMMAND = f"urlink dissect run.urlog {' '.join(ARGUMENTS)} | head -{LINES}"
#: Number of columns, so that no line wraps.
WIDTH = 126


def printed() -> str:
    """Return the first lines of the output of the command."""
    with contextlib.redirect_stdout(io.StringIO()) as output:
        urlink.cli.main(["dissect", str(CAPTURE), *ARGUMENTS])
    return "".join(output.getvalue().splitlines(keepends=True)[:LINES])


def main() -> None:
    """Run the command, and save its output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=IMAGES / "dissect.svg")
    args = parser.parse_args()
    save(session(COMMAND, printed(), WIDTH), args.output, COMMAND)


if __name__ == "__main__":
    main()
