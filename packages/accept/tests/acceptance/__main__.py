"""Run `urlink accept` many times: ``python -m packages.accept.tests.acceptance sound --runs 200``, or ``faults``.

``sound`` runs stages with sound controllers, one firmware row after the other with a random arm. A requirement that is
not held, or a result that contradicts a parameter, is a false alarm. In stage 3 one joint swings, and the next joint in
each round of the rows. The runs are in simulated time, or with ``--busy N`` in real time next to N busy
processes.

``drawn`` plants defects that a seed draws in the bytes of sound runs (`drawn`), and prints which are found.

``faults`` repeats stage 2 for half a minute while faults are injected (`faulted`), and measures how far any joint
leaves its start. A run has about 45 faults.

With ``--state FILE`` the next call continues with the remaining runs. ``--first 17 --runs 1`` is a single run. In
simulated time, it can differ from the same run after other runs in its process.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import math
import random
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import urlink
from linkcore.errors import BadValue
from tests import trials
from urlink.arm.models import MODELS
from urlink.arm.vectors import JOINTS
from urlink.protocol.firmware import RELEASES
from urlink.simulator.state import firmware_for
from urlink_accept.acceptance.causes import likely_causes
from urlink_accept.acceptance.evidence import Evidence
from urlink_accept.acceptance.report import judge
from urlink_accept.acceptance.requirements import requirements
from urlink_accept.acceptance.stages import STAGES, run

from .drawn import FIRMWARES, SEED, drawn, is_found, is_named, verdicts_with
from .drawn import sound as sound_evidence
from .faulted import faulted

LIMIT = requirements()["box"].limit
#: Duration of a run with faults, in s of simulated time.
_FAULTED = 30.0


def address(seed: int) -> str:
    """Return the address of a sound controller: each firmware row in turn, with a random arm."""
    firmware = RELEASES[seed % len(RELEASES)].since
    models = []
    for name, arm in MODELS.items():
        with contextlib.suppress(BadValue):
            firmware_for(arm, firmware)
            models.append(name.lower().replace(" ", ""))
    return f"sim://{random.Random(seed).choice(models)}?firmware={firmware}"


def sound(stages: Sequence[int], is_real: bool, seed: int) -> dict[str, Any]:
    """Return how many verdicts of each kind a run has, and the false alarms."""
    joint = JOINTS[seed // len(RELEASES) % len(JOINTS)]

    def consent(number: int, does: str) -> str:
        return (
            "" if number < 3 or does == STAGES[3] or f"moves the {joint} alone" in does else "another joint was drawn"
        )

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "run.urlog")
        with contextlib.nullcontext() if is_real else urlink.simulated_time(seed=seed):
            run(address(seed), path, tuple(stages), consent, seconds=3.0)
        evidence = Evidence(path)
        found = judge(evidence, requirements())
    alarms = [f"{each.requirement.name}: {each.seen}" for each in found if each.state == "not held"]
    alarms += [f"{each.requirement.name} contradicts {said}" for each in found for said in each.contradicts]
    ended = [f"stage {note.said['number']} ended early: {note.said['error']}" for note in evidence.said("stage-ended")]
    if not is_real:  # in real time, this computer may be delayed so long that the state of the arm is unknown
        alarms, ended = alarms + ended, []
    states = dict(Counter(each.state for each in found if each.requirement.stage in stages))
    said = [*map("FALSE ALARM: {}".format, alarms), *ended]
    print(f"seed {seed}, {address(seed)}: {states}", *said, sep="\n  ", flush=True)
    return {"states": states, "alarms": alarms, "ended": ended}


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Run other processes that compute all the time."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def all_sound(args: argparse.Namespace) -> int:
    with busy(args.busy or 0):
        runs = list(trials.tried(args, partial(sound, args.stages, args.busy is not None)))
    states = sum((Counter(each["states"]) for each in runs), Counter[str]())
    wrong = sum(bool(each["alarms"]) for each in runs)
    rows = len({each["seed"] % len(RELEASES) for each in runs})
    said = ", ".join(f"{count} {state}" for state, count in states.items())
    ended = sum(bool(each.get("ended")) for each in runs)
    print(
        f"{len(runs)} runs of {rows} of {len(RELEASES)} firmware rows: {wrong} with false alarms, {ended} ended early; "
        f"{said}"
    )
    return _ended(runs, wrong)


def with_faults(seed: int) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        ran = faulted(seed, _FAULTED, Path(folder))
    if ran.away > LIMIT:
        print(f"OUT OF THE BOX, seed {seed}: {math.degrees(ran.away):.2f} degrees", flush=True)
    return {"away": ran.away, "stages": ran.stages, "happened": ran.happened, "steps": ran.steps}


def all_with_faults(args: argparse.Namespace) -> int:
    runs = list(trials.tried(args, with_faults))
    happened, steps = (sum((Counter(each[of]) for each in runs), Counter[str]()) for of in ("happened", "steps"))
    wrong = sum(each["away"] > LIMIT for each in runs)
    print("faults:", ", ".join(f"{count} {name}" for name, count in sorted(happened.items())))
    print("steps that began:", ", ".join(f"{count} {name}" for name, count in sorted(steps.items())))
    worst = math.degrees(max(each["away"] for each in runs))
    print(
        f"{happened.total()} faults in {sum(each['stages'] for each in runs)} stages of {len(runs)} runs: {wrong} runs "
        f"left the box; the largest distance was {worst:.2f} of {math.degrees(LIMIT):g}°"
    )
    return _ended(runs, wrong)


def all_drawn(seed: int, count: int) -> int:
    """Print a table of drawn defects; return 0 if 90 % of them are found, and 80 % with their cause."""
    found = named = 0
    with tempfile.TemporaryDirectory() as folder:
        bases = {each: sound_evidence(each, Path(folder, f"{each}.urlog")) for each in FIRMWARES}
        for base in bases.values():
            judge(base, requirements())  # decodes the packets of all interfaces once
        for firmware, defect in drawn(seed, count, bases):
            verdicts = verdicts_with(bases[firmware], defect)
            is_one, has_cause = is_found(verdicts), is_named(verdicts, defect)
            found, named = found + is_one, named + (is_one and has_cause)
            said = "cause named" if is_one and has_cause else "found" if is_one else "MISSED"
            first = next(iter(likely_causes(verdicts)), "")
            print(f"{firmware:6} {defect!s:60} {said:12} {first[:110]}", flush=True)
    print(f"seed {seed}: {found} of {count} found, {named} with their cause")
    return int(found < 0.9 * count or named < 0.8 * count)


def _ended(runs: Sequence[dict[str, Any]], wrong: int) -> int:
    print(f"{sum(each['processor'] for each in runs):.0f} s of processor time")
    return int(wrong > 0)


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m packages.accept.tests.acceptance",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    kinds = parser.add_subparsers(dest="kind", required=True)
    of_sound, of_faults = kinds.add_parser("sound"), kinds.add_parser("faults")
    trials.add_arguments(of_sound, runs=len(RELEASES))
    of_sound.add_argument("--stages", type=int, nargs="+", choices=tuple(STAGES), default=tuple(STAGES))
    of_sound.add_argument("--busy", type=int, help="run in real time, beside this number of busy processes")
    trials.add_arguments(of_faults, runs=12)
    of_drawn = kinds.add_parser("drawn")
    of_drawn.add_argument("--seed", type=int, default=SEED)
    of_drawn.add_argument("--runs", type=int, default=102)
    given = parser.parse_args()
    logging.disable()  # each fault would cause log messages
    if given.kind == "drawn":
        return all_drawn(given.seed, given.runs)
    return all_sound(given) if given.kind == "sound" else all_with_faults(given)


if __name__ == "__main__":
    sys.exit(main())
