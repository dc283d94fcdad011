"""Commands `urlink exercise`, `identify` and `compare`: record a motion, identify the arm, and check the simulator."""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from urlink.tools import (
    ADDRESS,
    LIMITS,
    ProgressBar,
    agrees,
    argument,
    command,
    connected,
    positive_number,
    seconds,
    tell,
)

if TYPE_CHECKING:
    from urlink import Robot
    from urlink.tools import ArmFile, Estimate

    from ..identification.exercise import Exercise, Guard
    from ..identification.samples import Samples


def _degrees(text: str) -> float:
    if not 6.0 <= seconds(text) <= 45.0:
        raise argparse.ArgumentTypeError(f"{text} is out of range; expected 6 to 45 degrees")
    return seconds(text)


def _mapping(text: str) -> tuple[str, str]:
    ours, _, theirs = text.partition("=")
    if not ours or not theirs:
        raise argparse.ArgumentTypeError(f"{text!r} is not a mapping; expected for example target_q=joint_positions")
    return ours, theirs


#: Arguments for tables.
_TABLE = (
    argument(
        "--map",
        type=_mapping,
        action="append",
        default=[],
        metavar="NAME=COLUMN",
        help="RTDE name and its column in a table; for a vector, the name without number, or all columns with commas",
    ),
    argument("--rate", type=positive_number, metavar="HZ", help="rows per second of a table without timestamp"),
)


@command(
    "exercise",
    "move each joint slowly, for a recording",
    *ADDRESS,
    LIMITS,
    argument("--out", metavar="FILE", help="record the motion in this new file, for `urlink identify`"),
    argument(
        "--swing", type=_degrees, default=17.0, metavar="DEG", help="degrees to either side, 6 to 45 (default: 17)"
    ),
    argument("--dead-man", type=int, choices=range(8), metavar="N", help="move only while digital input N is on"),
    argument("--yes", action="store_true", help="confirm that the box is free; not needed for a simulated arm"),
)
def _exercise(args: argparse.Namespace) -> int:
    """Move each joint slowly about its current position, and then all joints together, for `urlink identify`.
    THE ARM MOVES, for a minute or two. The box of the motion is printed first, and nothing moves before you confirm
    that this box is free. No part of the arm is faster than 0.25 m/s. A speed slider below 100 % slows the arm down
    further. Try the motion with a low slider first, and record it at 100 %.

    Stand at the emergency stop. --dead-man names a digital input that must be on while the arm moves. Ctrl-C stops the
    arm. The motion ends at its start position.

    examples:
      urlink exercise 192.168.56.101
      urlink exercise 192.168.56.101 --out run.urlog --dead-man 0
      urlink exercise 'sim://ur5e?like=arm.json' --out run.urlog --swing 20
    """
    from ..identification.exercise import BESIDE, Guard, input_is_on, plan_from_here, slider_of

    with connected(args) as robot:
        planned = plan_from_here(robot, math.radians(args.swing))
        slider = slider_of(robot)
        print(_box_text(str(robot.model), planned, slider), flush=True)
        if not (args.yes or args.address.strip().startswith("sim:")):
            if not sys.stdin.isatty():
                tell("no terminal to ask whether this box is free; confirm it with --yes")
                return 1
            if not agrees("Is this box free, and is a person at the emergency stop?"):
                return 1
        guard = Guard(robot, planned.swing + BESIDE, *(() if args.dead_man is None else (input_is_on(args.dead_man),)))
        with contextlib.nullcontext() if args.out is None else robot.record(args.out, ["realtime"]):
            _move(robot, planned, guard, args.quiet)
    if args.out is not None:
        tell(f"to identify the arm: urlink identify {args.out} --out arm.json")
    return 0


def _move(robot: Robot, planned: Exercise, guard: Guard, quiet: bool) -> None:
    """Move the arm, and show the progress."""
    from ..identification.exercise import exercise

    with ProgressBar("exercise", quiet) as progress:

        def began(number: int) -> None:
            done = sum(leg.seconds + leg.rest for leg in planned.legs[:number])
            progress(done / planned.seconds, f"movement {number + 1} of {len(planned.legs)}")

        exercise(robot, planned, guard, began)


def _box_text(model: str, planned: Exercise, slider: float) -> str:
    degrees = f"{math.degrees(planned.swing):.0f} degrees"
    lines = [
        f"{model}: {len(planned.legs)} movements in {planned.seconds / max(slider, 0.01):.0f} s",
        f"each joint turns by {degrees} to either side of its position, alone and then with the others",
        "joints, the lines between them and the TCP stay within this box, in the base frame:",
    ]
    pairs = zip("xyz", planned.low.tolist(), planned.high.tolist(), strict=True)
    lines += [f"  {axis} {low:7.3f} to {high:.3f} m" for axis, low, high in pairs]
    lines.append("the arm is thicker than these lines; check the tool, the cables and what they may catch yourself")
    if slider < 1.0:
        lines.append(f"the speed slider is at {slider:.0%}; a recording shows less than at 100 %")
    return "\n".join(lines)


@command(
    "compare",
    "compare a recording with the simulator",
    argument("recording", type=Path, metavar="RECORDING", help="a .urlog, a .csv or a bundle"),
    argument("--like", metavar="FILE", help="use the arm in FILE, written by urlink identify"),
    argument("--model", metavar="NAME", help="arm, if neither --like nor the recording names it"),
    *_TABLE,
    argument(
        "--tolerance", type=seconds, default=0.01, metavar="S", help="allowed time difference in s (default: 0.01)"
    ),
)
def _compare(args: argparse.Namespace) -> int:
    """Run the motions of a recording on the simulator, and print the differences: the additional time of the
    simulator for each movement between two rests, and the root mean square by joint for each quantity. The exit status
    is 1 if a movement differs by more than --tolerance seconds, so the command can serve as a regression test of a
    cell. It is 2 if no movement could be compared.

    A recording does not contain commands. Therefore each movement is run as a movej or movel that fits the recorded
    targets.

    examples:
      urlink compare run.urlog --like arm.json
      urlink compare run.csv --model UR3e
      urlink compare run.urlog --like arm.json --tolerance 0.005
    """
    from urlink.tools import ArmFile, read_arm_file

    from ..identification import identify
    from ..identification.comparison import QUANTITIES, compare

    with ProgressBar(f"reading {args.recording}", args.quiet) as progress:
        samples = _samples(args, progress)
        if args.like is not None:
            like = read_arm_file(args.like)
        else:
            # Identify only the geometry, and use the values of the model for everything else.
            progress.next("identifying the geometry")
            found = identify(samples, args.model)
            like = ArmFile(found.model, {}, found.calibration, found.tcp)
        progress.next("simulating the movements")
        difference = compare(samples, like, progress)
    if not difference.rms:
        tell(
            f"nothing to compare: {args.recording} has {len(difference.movements)} complete movements between two "
            "rests, and no movej or movel fits any of them"
        )
        return 2
    begin, worst = float(samples["timestamp"][0]), 0.0
    for each in difference.movements:
        at = f"{float(samples['timestamp'][each.begin]) - begin:8.2f} s"
        if not each.command:
            print(f"{at}  no movej or movel fits")
            continue
        print(f"{at}  {each.command.partition('(')[0]}  the simulator takes {1e3 * each.late:+.2f} ms")
        worst = max(worst, abs(each.late))
    for name, values in difference.rms.items():
        print(f"{name:16} {' '.join(f'{value:.4g}' for value in values)} {QUANTITIES[name]} rms")
    return int(worst > args.tolerance)


@command(
    "identify",
    "estimate the parameters of an arm from a recording",
    argument("recording", type=Path, metavar="RECORDING", help="a .urlog, a .csv or a bundle"),
    argument("--model", metavar="NAME", help="arm, if the recording does not name it"),
    *_TABLE,
    argument(
        "--calibration", action="store_true", help="fit only the kinematics, to the poses measured_pose_0 to 2 or 5"
    ),
    argument("--out", metavar="FILE", help="write the result, for sim://...?like=FILE"),
    argument("--json", action="store_true", help="print one object per line: name, joint, value, low, high, needs"),
)
def _identify(args: argparse.Namespace) -> int:
    """Identify an arm from a recording of its motion: calibration, payload, rotor inertias, torque constants,
    friction, lag, the ramp of programs, and noise. Each number is printed with its 95 % confidence interval. If a
    number cannot be found from the recording, the motion that is needed to find it is named. With the file that --out
    writes, the simulator behaves like that arm: sim://ur5e?like=arm.json.

    RECORDING is a file of `urlink record` (the real-time interface, or RTDE with the targets of the joints), a table
    of RTDE variables as `urlink rtde --csv` prints it, or a bundle of `urlink accept` (.zip) with its stage 3.

    examples:
      urlink identify run.urlog --out arm.json
      urlink identify run.csv --model UR3e
      urlink identify run.urlog --json
    """
    from ..identification import identify

    with ProgressBar(f"reading {args.recording}", args.quiet) as progress:
        if args.calibration:
            return _calibrate(args)
        samples = _samples(args, progress)
        progress.next("identifying the arm")
        found = identify(samples, args.model)
    if args.out is not None:
        found.write(args.out)
        tell(f"to simulate this arm: sim://{found.model.lower().replace(' ', '')}?like={args.out}")
    for line in _objects(found) if args.json else _lines(found):
        print(line)
    return 0


def _calibrate(args: argparse.Namespace) -> int:
    """Fit the kinematics to measured poses, and print the accuracy in rows that were left out."""
    from urlink import BadValue
    from urlink.arm import models
    from urlink.tools import ArmFile, Estimate

    from ..identification.calibration import fit_measured
    from ..identification.samples import read_columns

    columns = read_columns(args.recording, dict(args.map))
    q, poses = columns.get("actual_q", columns.get("target_q")), columns.get("measured_pose")
    if args.model is None or q is None or poses is None or poses.shape[1:] not in ((3,), (6,)):
        raise BadValue(
            f"{args.recording} has the columns {', '.join(columns) or 'none'}; --calibration needs --model, actual_q "
            "or target_q, and measured_pose_0 to measured_pose_2 (position in m) or to measured_pose_5 (with a "
            "rotation vector in rad), for example --map measured_pose=x,y,z"
        )
    model = models.model(args.model)
    found = fit_measured(model, q, poses)
    print(f"{model.name}: {len(q)} measured poses, every fourth of them left out of the fit")
    print(f"  distance of the published arm   {1e3 * found.published:.4g} mm rms in the rows that were left out")
    print(f"  distance of the fitted arm      {1e3 * found.rms:.4g} mm rms")
    for name, pose in (("base", found.base), ("tcp", found.tcp)):
        print(f"  {name:24} {' '.join(f'{value:.6g}' for value in pose.tolist())}  m and rad")
    for name, values in zip(("dh_theta", "dh_a", "dh_d", "dh_alpha"), found.table, strict=True):
        print(f"  {name:24} {' '.join(f'{value:.7g}' for value in values)}")
    if found.rms >= found.published:
        tell("the fitted arm is not better than the published arm; measure more poses, in more directions")
        return 1
    if args.out is not None:
        estimates = {"calibration": (Estimate(found.rms, 0.0, found.rms),)}
        ArmFile(model.name, estimates, found.table, tuple(found.tcp.tolist())).write(args.out)
    return 0


def _samples(args: argparse.Namespace, progress: ProgressBar) -> Samples:
    """Read a recording, a table, or the recording in a bundle; print what it lacks."""
    from ..acceptance.bundle import recording_in
    from ..identification.samples import read_samples

    with recording_in(args.recording) as recording:
        samples = read_samples(recording, progress, names=dict(args.map), rate=args.rate)
    if samples.missing:
        tell(f"{args.recording} lacks {len(samples.missing)} columns:")
        for name, effect in samples.missing.items():
            tell(f"  without {name}: {effect}")
    for remark in samples.remarks:
        tell(f"warning: {remark}")
    return samples


def _objects(found: ArmFile) -> Sequence[str]:
    lines = []
    for name, each in found.estimates.items():
        for number, estimate in enumerate(each):
            about = {"name": name, "joint": number if len(each) > 1 else None}
            said = {"value": None, "needs": estimate.needs}
            if estimate.is_known:
                said = {"value": estimate.value, "low": estimate.low, "high": estimate.high}  # type: ignore[dict-item]
            lines.append(json.dumps(about | said))
    return lines


def _lines(found: ArmFile) -> Sequence[str]:
    from urlink.tools import parameters

    units = {name: row.unit for (name, _), row in parameters().items()}
    units |= {"payload": "kg", "payload_cog": "m", "calibration": "m rms", "clock_drift": ""}
    units |= {"force_offset": "N or Nm", "unset_payload": "kg"}
    lines = [found.model]
    for name, each in found.estimates.items():
        for number, estimate in enumerate(each):
            label = f"{name} {number}" if len(each) > 1 else name
            lines.append(f"  {label:24} {_text(estimate, units.get(name, ''))}")
    for what, values in (("moments", found.torque_r2), ("currents", found.current_r2)):
        if values:
            shown = " ".join("-" if math.isnan(value) else f"{value:.5f}" for value in values)
            lines.append(f"  {f'R2 of {what}':24} {shown}")
    return lines


def _text(estimate: Estimate, unit: str) -> str:
    if not estimate.is_known:
        return f"unknown; needs {estimate.needs}"
    return f"{estimate.value:.5g} {unit}".rstrip() + f"  ({estimate.low:.5g} to {estimate.high:.5g})"
