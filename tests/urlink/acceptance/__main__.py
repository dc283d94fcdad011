"""`urlink accept` many times: ``python -m tests.urlink.acceptance sound --runs 200``, and ``faults --faults 10000``.

``sound`` runs every stage against sound controllers, one firmware row after the other with an arm that is drawn: what
is not held, and what contradicts a parameter, is a false alarm. In simulated time, or with ``--real`` in real time
beside a process that computes without end. ``faults`` runs stage 2 while faults are injected, and looks how far any
joint leaves its start.

``--first`` and ``--runs 1`` repeat one run; the same seed is the same run in simulated time.
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
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import urlink
from linkcore.errors import BadValue
from urlink.acceptance.evidence import Evidence
from urlink.acceptance.report import State, judge
from urlink.acceptance.requirements import requirements
from urlink.acceptance.stages import STAGES, run
from urlink.firmware import RELEASES
from urlink.models import MODELS
from urlink.simulator.state import firmware_for

from .test_moving import LIMIT, consent, farthest

#: Faults that are drawn for a run of stage 2; those after its end do not count.
_FAULTS = 12


def address(seed: int) -> str:
    """A sound controller: of each firmware row in turn, with an arm on which it runs."""
    firmware = RELEASES[seed % len(RELEASES)].since
    models = []
    for name, arm in MODELS.items():
        with contextlib.suppress(BadValue):
            firmware_for(arm, firmware)
            models.append(name.lower().replace(" ", ""))
    return f"sim://{random.Random(seed).choice(models)}?firmware={firmware}"


def verdicts(seed: int, is_real: bool) -> tuple[Counter[State], list[str]]:
    """How many verdicts of which kind a run has, and the false alarms."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "run.urlog")
        with contextlib.nullcontext() if is_real else urlink.simulated_time(seed=seed):
            run(address(seed), path, tuple(STAGES), consent, seconds=3.0)
        evidence = Evidence(path)
        found = judge(evidence, requirements())
    alarms = [f"{each.requirement.name}: {each.seen}" for each in found if each.state == "not held"]
    alarms += [f"{each.requirement.name} contradicts {said}" for each in found for said in each.contradicts]
    alarms += [
        f"stage {note.said['number']} ended early: {note.said['error']}" for note in evidence.said("stage-ended")
    ]
    return Counter(each.state for each in found), alarms


@contextlib.contextmanager
def busy() -> Iterator[None]:
    """A process beside this one that computes without end."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def sound(first: int, runs: int, is_real: bool) -> int:
    wrong, states = 0, Counter[State]()
    with busy() if is_real else contextlib.nullcontext():
        for seed in range(first, first + runs):
            counted, alarms = verdicts(seed, is_real)
            states += counted
            wrong += bool(alarms)
            print(
                f"seed {seed}, {address(seed)}: {dict(counted)}",
                *map("FALSE ALARM: {}".format, alarms),
                sep="\n  ",
                flush=True,
            )
    said = ", ".join(f"{count} {state}" for state, count in states.items())
    print(f"{runs} runs from seed {first}: {wrong} with false alarms; {said}")
    return int(wrong > 0)


def faulted(first: int, faults: int) -> int:
    worst, wrong, seed, happened = 0.0, 0, first, 0
    with tempfile.TemporaryDirectory() as folder:
        while happened < faults:
            path = Path(folder, f"{seed}.urlog")
            away, drawn = farthest(seed, _FAULTS, path)
            path.unlink(missing_ok=True)
            worst, happened, seed = max(worst, away), happened + len(drawn), seed + 1
            if away > LIMIT:
                wrong += 1
                print(f"OUT OF THE BOX, seed {seed - 1}, {math.degrees(away):.2f} degrees: {', '.join(drawn)}")
            if seed % 100 == 0 or happened >= faults:
                said = f"{happened} faults in {seed - first} runs from seed {first}: {wrong} runs left the box"
                print(f"{said}; the farthest was {math.degrees(worst):.2f} of {math.degrees(LIMIT):g}°", flush=True)
    return int(wrong > 0)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.urlink.acceptance", description=__doc__)
    kinds = parser.add_subparsers(dest="kind", required=True)
    for kind in ("sound", "faults"):
        kinds.add_parser(kind).add_argument("--first", type=int, default=0, help="seed of the first run")
    kinds.choices["sound"].add_argument("--runs", type=int, default=20)
    kinds.choices["sound"].add_argument("--real", action="store_true", help="in real time, beside a busy process")
    kinds.choices["faults"].add_argument("--faults", type=int, default=600, help="at least so many")
    given = parser.parse_args()
    logging.disable()  # each fault is told of
    began = time.monotonic()
    status = sound(given.first, given.runs, given.real) if given.kind == "sound" else faulted(given.first, given.faults)
    print(f"{time.monotonic() - began:.0f} s")
    return status


if __name__ == "__main__":
    sys.exit(main())
