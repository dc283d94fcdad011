"""Read variables over RTDE into a class that declares them, and share registers with a program on the robot.

    python examples/rtde_cell.py 192.168.56.101
    python examples/rtde_cell.py                  # the simulator

The program on the robot adds one to an integer until it is told to stop. Nothing moves.
"""

import argparse

import urlink
from linkcore.wire.packet import Vector

COUNTER = """
while read_input_integer_register(24) == 1:
    write_output_integer_register(24, read_output_integer_register(24) + 1)
    sync()
end
"""


class Cell(urlink.rtde.Outputs):
    """Variables that this program reads, with the names of the controller."""

    timestamp: float
    actual_TCP_pose: Vector
    output_int_register_24: int
    payload: float | None  # None with controllers before 3.11 and 5.5.1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", nargs="?", default="sim://ur5e?firmware=5.11")
    parser.add_argument("--count", type=int, default=20, help="number of states to print")
    options = parser.parse_args()
    with urlink.connect(options.address) as robot:
        robot.registers.write_integer(24, 1)
        program = robot.script.run(COUNTER)
        with robot.rtde.outputs(Cell, frequency=10) as cells:
            for number, cell in enumerate(cells, 1):
                x, y, z = cell.actual_TCP_pose[:3]
                print(
                    f"{cell.timestamp:8.2f} s  tool at {x:.3f} {y:.3f} {z:.3f} m  counter {cell.output_int_register_24}"
                )
                if number == options.count:
                    break
        robot.registers.write_integer(24, 0)
        program.wait(5)


if __name__ == "__main__":
    main()
