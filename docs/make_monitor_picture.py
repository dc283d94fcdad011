"""Draw docs/images/monitor.svg: the display of `urlink monitor sim://` after a few seconds."""

import argparse
import itertools
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from _terminal import IMAGES, recorder, save

import urlink
from urlink.cli.monitor import watch
from urlink.cli.monitor_panel import WIDTH, MonitorPanel

T = TypeVar("T")


def main() -> None:
    """Monitor the simulator, and save the last view."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=IMAGES / "monitor.svg")
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
        console = recorder(WIDTH)
        console.print(MonitorPanel(view))
    save(console, args.output, f"urlink monitor {args.address.removesuffix('?motion=demo')}")


def _every(items: Iterator[T], seconds: float) -> Iterator[T]:
    for item in items:
        yield item
        time.sleep(seconds)


if __name__ == "__main__":
    main()
