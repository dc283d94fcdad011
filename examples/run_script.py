"""Run a URScript file on a robot, print its messages, and show the line of an error.

python examples/run_script.py                                  # a small program, in the simulator
python examples/run_script.py --file wave.script 192.168.56.101
"""

import argparse
import sys
from pathlib import Path

import urlink

PROGRAM = """\
def wave():
  i = 0
  while i < 2:
    movej([0, -1.57, 1.57, -1.57, -1.57, 0.1], a=3.0, v=1.5)
    movej([0, -1.57, 1.57, -1.57, -1.57, 0], a=3.0, v=1.5)
    i = i + 1
    textmsg("waves: ", i)
  end
end
"""


def main() -> int:
    parser = argparse.ArgumentParser(description="Run a URScript program.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--file", type=Path, help="URScript file (default: a small program)")
    parser.add_argument("--timeout", type=float, default=600.0, help="maximum run time, s (default: 600)")
    args = parser.parse_args()

    source = PROGRAM if args.file is None else args.file.read_text()
    try:
        with urlink.connect(args.address) as robot:
            program = robot.script.run(source)
            try:
                program.wait(args.timeout)
            finally:
                # After Ctrl-C or a timeout, closing the connection alone would leave the program running.
                program.cancel()
                print(*program.texts, sep="\n")
    except urlink.ScriptError as error:
        lines = source.splitlines()
        print(f"line {error.line}: {lines[error.line - 1].strip()}", file=sys.stderr)
        print(error.text, file=sys.stderr)
        return 1
    except urlink.LinkError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    print("finished")
    return 0


if __name__ == "__main__":
    sys.exit(main())
