"""Draw docs/images/monitor.svg: the display of `urlink monitor sim://` after a few seconds."""

import argparse
import itertools
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.terminal_theme import TerminalTheme

import urlink
from urlink.cli.monitor import watch
from urlink.cli.monitor_panel import WIDTH, MonitorPanel

T = TypeVar("T")

_THEME = TerminalTheme(
    background=(22, 27, 34),
    foreground=(222, 228, 235),
    normal=[
        (36, 41, 47),
        (248, 81, 73),
        (63, 185, 80),
        (210, 153, 34),
        (88, 166, 255),
        (188, 140, 255),
        (57, 197, 207),
        (222, 228, 235),
    ],
    bright=[(125, 133, 144)] * 8,
)


def main() -> None:
    """Monitor the simulator, and save the last view."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "images" / "monitor.svg")
    parser.add_argument("--address", default="sim://?motion=demo")
    parser.add_argument("--interface", choices=("realtime", "primary"), default="realtime")
    parser.add_argument("--seconds", type=float, default=6.0)
    args = parser.parse_args()
    with urlink.connect(args.address) as robot:
        if robot.controller is not None:
            # Set some inputs, so that the display shows them.
            for number in (0, 2, 9):
                robot.controller.signals.set_digital_input(number, True)
            for number in (1, 16):
                robot.controller.signals.set_digital_output(number, True)
        until = time.monotonic() + args.seconds
        views = watch(robot, args.interface)
        view = next(itertools.dropwhile(lambda _: time.monotonic() < until, _every(views, 0.1)))
        with open("/dev/null", "w") as nowhere:
            console = Console(record=True, width=WIDTH, file=nowhere, force_terminal=True)
            console.print(MonitorPanel(view))
    args.output.parent.mkdir(exist_ok=True)
    svg = console.export_svg(
        title=f"urlink monitor {args.address.removesuffix('?motion=demo')}", theme=_THEME, unique_id="monitor"
    )
    # An image in a document loads no fonts, and should not request any.
    args.output.write_text(re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL))


def _every(items: Iterator[T], seconds: float) -> Iterator[T]:
    for item in items:
        yield item
        time.sleep(seconds)


if __name__ == "__main__":
    main()
