"""Draw docs/images/doctor.svg: `urlink doctor` for a simulated controller in local mode, with inputs in use.

The controller, the network and the time are simulated, so the same code gives the same image.
"""

import argparse
import contextlib
import io
from pathlib import Path

from _terminal import IMAGES, save, session

import urlink
import urlink.cli
from urlink.simulator import Controller

ADDRESS = "192.168.56.101"
COMMAND = f"urlink doctor {ADDRESS}"


def report() -> str:
    """Return the output of the command."""
    with urlink.simulated_time(seed=1) as sim:
        cell = sim.computer("cell", ADDRESS)
        with sim.on(cell):
            controller = Controller("UR5e", "5.25", host=ADDRESS, ports="standard").start()
        controller.remote_control = False
        with (
            controller,
            urlink.connect(ADDRESS) as other,
            other.rtde.inputs("speed_slider_fraction", "speed_slider_mask"),
            contextlib.redirect_stdout(io.StringIO()) as output,
        ):
            urlink.cli.main(["doctor", ADDRESS, "--quiet"])
    return output.getvalue()


def main() -> None:
    """Run the command, and save its output."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=IMAGES / "doctor.svg")
    args = parser.parse_args()
    save(session(COMMAND, report()), args.output, COMMAND)


if __name__ == "__main__":
    main()
