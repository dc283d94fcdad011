"""Draw the figures of the how-to pages: docs/images/how-to-*.svg, each one row of boxes.

The same code gives the same bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from _drawing import drawing
from make_diagrams import FOLDER, STYLE, arrow, box, label

WIDTH, HEIGHT, MARGIN = 800.0, 112.0, 8.0


class Box(NamedTuple):
    """A box of a row: its kind, its name and lines, and the text over the arrow to the next box."""

    kind: str
    name: str
    notes: tuple[str, ...] = ()
    then: str = ""
    both_ways: bool = False


class Picture(NamedTuple):
    """Description of a figure for readers who do not see it, and its boxes from left to right."""

    title: str
    boxes: tuple[Box, ...]


PICTURES = {
    "move-and-wait": Picture(
        "A handle: sent, running, and then done, cancelled or failed; an interrupted wait cancels it",
        (
            Box("yours", "move_joints", ("returns a handle",)),
            Box("ours", "SENT", ("not moved yet",)),
            Box("robot", "RUNNING", ("the arm moves",)),
            Box("ours", "one end", ("DONE, CANCELLED", "or FAILED")),
            Box("yours", "wait()", ("returns or raises",)),
        ),
    ),
    "wait-for-something": Picture(
        "The robot's states arrive every 2 or 8 ms; each state is checked until the condition holds",
        (
            Box("robot", "robot", ("input, mode, speed",), "2 or 8 ms"),
            Box("ours", "every state", ("none is skipped",)),
            Box("ours", "condition", ("holds?",), "yes"),
            Box("yours", "the next line", ("or LinkTimeout",)),
        ),
    ),
    "several-robots": Picture(
        "Two robots in one program: each has its own streams, threads and interlock",
        (
            Box("robot", "left", ("192.168.56.101",), both_ways=True),
            Box("ours", "connect", ("streams, interlock",), both_ways=True),
            Box("yours", "your program", ("one, or many tasks",), both_ways=True),
            Box("ours", "connect", ("streams, interlock",), both_ways=True),
            Box("robot", "right", ("192.168.56.102",)),
        ),
    ),
    "share-numbers": Picture(
        "Input registers carry numbers from your program to the program on the controller, output registers back",
        (
            Box("yours", "your program", ("write_float(24)",), "input 24"),
            Box("robot", "registers", ("24 to 47 are", "for clients")),
            Box("robot", "URScript", ("read_input_...", "write_output_...")),
            Box("robot", "registers", ("kept until they", "are written"), "output 25"),
            Box("yours", "your program", ("an RTDE stream",)),
        ),
    ),
    "confirm-a-setting": Picture(
        "A setting is sent, the robot's states show it, and the call returns; otherwise it raises NotConfirmed",
        (
            Box("yours", "set_digital_out", ("1, True",), "RTDE, script"),
            Box("robot", "controller", ("local control:", "ignored silently"), "states"),
            Box("ours", "shown?", ("within 1 s",), "yes"),
            Box("yours", "returns", ("or NotConfirmed",)),
        ),
    ),
    "container": Picture(
        "From a container: connections to the robot work; connections from the robot need registers or a port",
        (
            Box("yours", "container", ("your program",), "link=rtde", both_ways=True),
            Box("box", "host, NAT", ("port 50001", "published"), both_ways=True),
            Box("robot", "robot", ("registers, or", "connects back")),
        ),
    ),
    "log-states": Picture(
        "A recording keeps the bytes unchanged; it is exported to files, and shows that no packet is missing",
        (
            Box("robot", "robot", ("500 states per s",)),
            Box("ours", "record", ("unchanged bytes",)),
            Box("box", "run.urlog", ("with checksums",)),
            Box("ours", "load, export", ("missing: ()",)),
            Box("box", "run.csv", ("or Parquet, MCAP",)),
        ),
    ),
    "without-a-robot": Picture(
        "The same program with a robot or a simulated controller with faults: only the address differs",
        (
            Box("yours", "your program", ("connect(address)",), both_ways=True),
            Box("ours", "sim://ur5", ("real wire format", "in the test"), both_ways=True),
            Box("shut", "faults", ("stops, cut cables,", "reboots")),
        ),
    ),
    "what-is-wrong": Picture(
        "urlink doctor checks, in this order: computer, ports, controller, inputs, data",
        (
            Box("yours", "computer", ("wakes up late?",)),
            Box("box", "ports", ("30001 to 30004", "29999")),
            Box("robot", "controller", ("modes, program", "remote control")),
            Box("robot", "inputs", ("who holds them",)),
            Box("ours", "data", ("rate, gaps, jitter",)),
        ),
    ),
    "steer-by-a-camera": Picture(
        "Targets arrive at any time; the filter makes a set-point for each cycle, within limits",
        (
            Box("yours", "camera, policy", ("late, with jumps",), "targets"),
            Box("ours", "target filter", ("limits of speed,", "acceleration, jerk"), "125, 500 Hz"),
            Box("robot", "arm", ("servoj",), "states"),
            Box("yours", "history", ("earlier states",)),
        ),
    ),
}


def drawn(name: str, picture: Picture) -> str:
    """Return the text of one figure."""
    count = len(picture.boxes)
    gap = 40.0 if not any(each.then for each in picture.boxes) else 92.0 if count < 5 else 60.0
    width = (WIDTH - 2 * MARGIN - gap * (count - 1)) / count
    body: list[str] = []
    for number, each in enumerate(picture.boxes):
        x = MARGIN + number * (width + gap)
        body += box(each.kind, x, 24, width, 72, each.name, *each.notes)
        if number + 1 < count:
            begin, end, y = x + width, x + width + gap, 60.0
            body += arrow((begin, y), (end, y))
            if each.both_ways:
                body += arrow((end, y), (begin, y))
            body += label((begin + end) / 2, y - 10, each.then, "middle") if each.then else []
    return drawing(f"how-to-{name}", WIDTH, HEIGHT, picture.title, STYLE, body)


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw all figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=FOLDER)
    folder = parser.parse_args(arguments).folder
    for name, picture in PICTURES.items():
        (folder / f"how-to-{name}.svg").write_text(drawn(name, picture), encoding="utf-8")


if __name__ == "__main__":
    main()
