"""Cost of the inverse kinematics, compared with ur-analytic-ik and ikpy.

Converts one pose to the closest joint positions, and a thousand poses at once, for the published arm and a calibrated
arm. The poses belong to random joint positions whose elbow and wrist are bent by at least 6 degrees. The search starts
up to 0.01 rad away from these positions, as for the next set-point of a path. Closer to a singularity, a calibrated arm
needs a separate search, which has its own row. Each figure is processor time, the best of many short runs. The last
column is the largest error of the flange pose.

ur-analytic-ik is the closed form in C++. ikpy optimises numerically along a chain that it reads from the URDF that
urlink writes. They are compared if they are installed (as in `nox -f nightly.py -s kinematics`), and are not required.

    python benchmarks/kinematics.py                # UR5e
    python benchmarks/kinematics.py --quick
    python benchmarks/kinematics.py --json         # prints one JSON object
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urlink.arm.kinematics import Arm
from urlink.arm.poses import compose, invert, to_matrix
from urlink.arm.urdf import to_urdf

ROWS = 1000
#: Goals in µs: for one pose, and for each of a thousand poses.
GOALS = {"one": 60.0, "row": 3.0}
#: Axes tilted by some mrad, and lengths that differ by a millimetre, like a reported arm (issue 457 of the vendor's ROS
#: driver), for a UR5e: theta, a, d and alpha of each joint.
CALIBRATION = {
    "dh_theta": [-9.6e-06, -1.437070, 2.025431, -0.588255, 4.1e-05, 8.2e-06],
    "dh_a": [0.000279, -0.05668535, -0.32641694, 1.49e-05, 2.2e-07, 0.0],
    "dh_d": [0.1622205, 574.241384579456, -507.363402098168, -66.7435339353205, 0.1000235, 0.0998625],
    "dh_alpha": [1.570338588, -0.000733893428160216, 0.00325607356326439, 1.570400052, -1.571010003, 0.0],
}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """DH table in the form in which a controller sends it."""

    dh_theta: list[float]
    dh_a: list[float]
    dh_d: list[float]
    dh_alpha: list[float]


def seconds(work: Callable[[], object], rounds: int, number: int) -> float:
    """Return the processor time of a call in s, of the best of some rounds of many calls."""
    best = float("inf")
    for _ in range(rounds):
        began = time.process_time()
        for _ in range(number):
            work()
        best = min(best, (time.process_time() - began) / number)
    return best


def missed(arm: Arm, q: Array, poses: Array) -> float:
    """Return the largest error of the poses, in m or rad."""
    return float(np.abs(compose(invert(arm.forward(q)), poses)).max())


def measure(rounds: int) -> dict[str, dict[str, float]]:
    rng = np.random.default_rng(1)
    published, calibrated = Arm("UR5e"), Arm.calibrated("UR5e", Table(**CALIBRATION))
    random = rng.uniform(-np.pi, np.pi, (20 * ROWS, 6))
    bent = np.abs(np.sin(random[:, [2, 4]])).min(axis=1) > 0.1
    straight = random[:ROWS].copy()
    straight[:, 4] = rng.uniform(-1e-3, 1e-3, ROWS)
    figures: dict[str, dict[str, float]] = {}
    cases = (
        ("urlink", published, random[bent][:ROWS]),
        ("urlink, calibrated", calibrated, random[bent][:ROWS]),
        ("the same, singular", calibrated, straight[:100]),
    )
    for name, arm, q in cases:
        near = q + rng.uniform(-0.01, 0.01, q.shape)
        poses = arm.forward(q)
        each = list(zip(poses.tolist(), near.tolist(), strict=True))[:100]

        def one(arm: Arm = arm, each: list[tuple[list[float], list[float]]] = each) -> None:
            for pose, close in each:
                arm.inverse(pose, close)

        def rows(arm: Arm = arm, poses: Array = poses, near: Array = near) -> None:
            arm.inverse(poses, near)

        figures[name] = {
            "one": 1e6 * seconds(one, 3 * rounds, 1) / len(each),
            "row": 1e6 * seconds(rows, 3 * rounds, 1) / len(q),
            "missed": missed(arm, arm.inverse(poses, near), poses),
        }
    q = random[bent][:ROWS]
    near, poses = q + 0.01, published.forward(q)
    if find_spec("ur_analytic_ik"):
        figures["ur-analytic-ik"] = analytic(published, poses[:100], near[:100], rounds)
    if find_spec("ikpy"):
        figures["ikpy"] = ikpy(published, poses[:5], near[:5])
    return figures


def analytic(arm: Arm, poses: Array, near: Array, rounds: int) -> dict[str, float]:
    """Measure ur-analytic-ik, which receives matrices and has no call for many poses."""
    module: Any = importlib.import_module("ur_analytic_ik")
    matrices = [np.ascontiguousarray(matrix) for matrix in to_matrix(poses)]
    close = near.tolist()

    def all_of_them() -> list[Any]:
        pairs = zip(matrices, close, strict=True)
        return [module.ur5e.inverse_kinematics_closest(matrix, *each)[0] for matrix, each in pairs]

    figures = {"one": 1e6 * seconds(all_of_them, 3 * rounds, 1) / len(matrices)}
    # Its answers are within one turn. It leaves out poses in and close to singularities.
    return {**figures, "missed": missed(arm, np.array(all_of_them()).reshape(-1, 6), poses)}


def ikpy(arm: Arm, poses: Array, near: Array) -> dict[str, float]:
    """Measure ikpy, which reads the arm from a file, and counts fixed links among the joints."""
    module: Any = importlib.import_module("ikpy.chain")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(to_urdf(arm), encoding="utf-8")
        mask = [False] + [True] * 6 + [False]
        chain = module.Chain.from_urdf_file(str(path), active_links_mask=mask)
    matrices = to_matrix(poses)

    def all_of_them() -> Array:
        found = [
            chain.inverse_kinematics_frame(matrix, initial_position=[0.0, *close, 0.0], orientation_mode="all")
            for matrix, close in zip(matrices, near, strict=True)
        ]
        return np.array(found)[:, 1:7]

    took = 1e6 * seconds(all_of_them, 1, 1) / len(matrices)
    return {"one": took, "missed": missed(arm, all_of_them(), poses)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="three rounds instead of ten")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    figures = measure(3 if options.quick else 10)
    if options.json:
        print(json.dumps(figures))
        return
    print(f"Inverse kinematics of a UR5e: µs for one pose, µs for each of {ROWS}, and largest error (m, rad)")
    print(f"  {'goal: at most':22} {GOALS['one']:10.1f} {GOALS['row']:8.2f}")
    for name, row in figures.items():
        many = f"{row['row']:8.2f}" if "row" in row else f"{'-':>8}"
        print(f"  {name:22} {row['one']:10.1f} {many} {row['missed']:10.1e}")


if __name__ == "__main__":
    main()
