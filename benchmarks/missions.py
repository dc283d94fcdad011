"""Cost of a mission: interpreter, odometry and motion control, with ticks of 10 ms and in lockstep.

In lockstep: the time for the square spiral with which the original MRC was recorded, 35 s of driving. The turtle is
driven in the same process, or left out. The figure is processor time, the best of several runs. Without the turtle, its
earlier answers are used, so only the interpreter and its motion control are measured.

In real time: the fraction of a processor that this process uses while it drives a turtle, which a host in another
process serves with ticks of 10 ms. For comparison, a loop only writes two values and syncs at each tick. The important
figure is the difference of both. Both are several times as large as in lockstep, because a process that is woken a
hundred times per second finds neither its code nor its data in the processor's caches.

    python benchmarks/missions.py            # about 40 s
    python benchmarks/missions.py --quick    # about 12 s
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import time
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection

from rhdlink import Cancelled, Host, Mission, connect
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.world import World
from rhdlink.smrcl.controller import MissionController
from rhdlink.smrcl.profile import find_profile
from rhdlink.smrcl.robot_conf import SMR, VELOMEGA
from rhdlink.smrcl.robot_link import PluginLink

#: Eight legs of 0.2 to 0.9 m, each followed by a turn, and the diagonal.
SPIRAL = "".join(f"fwd {0.2 + 0.1 * leg:.1f}\nturn 90\n" for leg in range(8)) + "turn 45\nfwd 0.5\nstop\n"
#: Runs until the measurement ends, with a stop condition that is evaluated in each cycle.
ENDLESS = 'label "on"\nfwd 0.5 : ($drivendist > 0.4) | ($odovelocity > 3)\nturn 90\nn = n + 1\nif (1) "on"\n'

#: Maximum time, in s, and maximum fraction of a processor.
MOST_SECONDS, MOST_SHARE = 0.5, 0.05
ROBOTS = {"velocity-omega": Turtle, "SMR": SmrTurtle}

Answers = list[dict[str, Sequence[int]]]


def driven(robot: type[Turtle | SmrTurtle], profile: str) -> tuple[float, int]:
    """Return the time, in s, and the ticks of the spiral with a turtle in this process."""
    mission = Mission(SPIRAL, robot(World(1000.0)), compat=profile)
    began = time.process_time()
    run = mission.run()
    return time.process_time() - began, run.cycles


def answers_of(robot: type[Turtle | SmrTurtle], profile: str) -> tuple[MissionController, Answers]:
    """Return a controller that has not started, and a turtle's answers to an equal controller."""
    link = PluginLink([robot(World(1000.0))])
    conf = VELOMEGA if robot is Turtle else SMR
    first, second = (MissionController(conf, link.read, link.write, profile=find_profile(profile)) for _ in range(2))
    first.load(SPIRAL)
    second.load(SPIRAL)
    request: Mapping[str, Sequence[int]] = first.first_request()
    answers: Answers = []
    while not first.is_finished:
        answer = link.exchange(request)
        answers.append({name: answer[name] for name in link.read})
        request = first.step(answers[-1])
    second.first_request()
    return second, answers


def computed(robot: type[Turtle | SmrTurtle], profile: str) -> float:
    """Return the time of the spiral without the turtle, in s."""
    controller, answers = answers_of(robot, profile)
    began = time.process_time()
    for answer in answers:
        controller.step(answer)
    assert controller.is_finished
    return time.process_time() - began


def serve(ports: Connection, robot: type[Turtle | SmrTurtle]) -> None:
    with Host([robot(World(1000.0))], port=0, period=0.01) as host:
        ports.send(host.address)
        ports.recv()


def shares(robot: type[Turtle | SmrTurtle], seconds: float) -> tuple[float, float]:
    """Return the fractions of a processor that a mission and a loop of syncs use in real time."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    host = spawn.Process(target=serve, args=(theirs, robot))
    host.start()
    with connect(ours.recv(), access="w") as client:
        with Mission(ENDLESS, client, variables={"n": 0.0}).start() as run:
            time.sleep(0.5)  # until it drives
            driving = used(lambda: time.sleep(seconds))
            assert not run.done, run.error
        with contextlib.suppress(Cancelled):
            run.wait(10.0)
        names = [variable.name for variable in client.variables if variable.direction == "w"][:2]

        def synced() -> None:
            until = time.perf_counter() + seconds
            while time.perf_counter() < until:
                for name in names:
                    client[name] = 0
                client.sync()

        bare = used(synced)
    ours.send(None)
    host.join(10)
    return driving, bare


def used(wait: Callable[[], object]) -> float:
    """Return the fraction of a processor that this process uses during `wait`."""
    began, before = time.perf_counter(), time.process_time()
    wait()
    return (time.process_time() - before) / (time.perf_counter() - began)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer and shorter runs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    runs, seconds = (3, 3.0) if args.quick else (10, 12.0)
    results = {}
    for name, robot in ROBOTS.items():
        both = [driven(robot, "sound") for _ in range(runs)]
        alone = min(computed(robot, "sound") for _ in range(runs))
        ticks = both[0][1]
        driving, bare = shares(robot, seconds)
        results[name] = {
            "ticks": ticks,
            "lockstep_s": round(min(took for took, _ in both), 3),
            "computed_s": round(alone, 3),
            "tick_us": round(alone / ticks * 1e6, 1),
            "share": round(driving, 4),
            "share_of_syncs": round(bare, 4),
        }
    if args.json:
        print(json.dumps(results))
        return
    for name, found in results.items():
        print(f"{name}: {found['ticks']} ticks of 10 ms")
        print(f"  in lockstep with the turtle   {found['lockstep_s']:.2f} s   (at most {MOST_SECONDS:g} s)")
        print(f"  without it                    {found['computed_s']:.2f} s   {found['tick_us']:.0f} us per tick")
        more = found["share"] - found["share_of_syncs"]
        print(f"  in real time                  {more:.1%} of a processor   (at most {MOST_SHARE:.0%})")
        print(f"    more than the syncs, with       {found['share_of_syncs']:.1%}")


if __name__ == "__main__":
    main()
