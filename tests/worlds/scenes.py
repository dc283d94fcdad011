"""Small worlds, in each of which a defect has shown: what programs do, and what happens to them in which moment.

`drawn` varies them, and `planted` puts their defects back.
"""

from __future__ import annotations

from collections.abc import Mapping

from .world import Ask, Client, Event, World

__all__ = ["SCENES"]


def _ask(
    what: str,
    then: str = "wait",
    *,
    after: float = 0.0,
    size: float = 1.0,
    patience: float = 0.0,
    thread: int = 0,
    at: float = 0.0,
) -> Ask:
    return Ask(what, then, after, size, patience, thread, at)


def _world(*clients: Client, events: tuple[Event, ...] = (), latency: float = 1e-4, lines: float = 0.0) -> World:
    return World(0, "5.11", latency, 0.0, clients, events, lines)


#: By the names of their defects; those of them that `planted` puts back have an entry in DEFECTS.
SCENES: Mapping[str, World] = {
    # The program's text is lost on the way and sent again, when a stop has come and is over.
    "held-program-goes-on": _world(
        Client((_ask("speed_joints", size=0.1), _ask("script", after=0.2)), 0.0),
        events=(Event("mute", 0.0, 0.5, 0, 1.0, 1), Event("protective_stop", 0.05, 0.2, 0, 1.0, 1)),
    ),
    # The block is left in the moment in which a state is answered.
    "message-after-the-last": _world(Client((_ask("jog", "leave", size=0.6),), 0.0)),
    "up-before-its-ports": _world(
        Client((_ask("wait_state", after=0.5, patience=1.0),), 0.0), events=(Event("reboot", 0.01, 0.3, 0, 1.0),)
    ),
    "speed-outlives-its-program": _world(
        Client((_ask("speed_held"),), 0.0), events=(Event("kill_client", 0.02, 0.3, 0, 1.0, 0),)
    ),
    # The task is cancelled between two turns of the loop, while a thread prepares the motion.
    "cancelled-task-moves-the-arm": _world(Client((_ask("move_joints", "cancel", size=0.5),), 0.0, "asyncio")),
    "cancel-brakes-not": _world(Client((_ask("move_joints", "cancel", size=0.9, patience=0.1),), 0.0)),
    "interlock-forgets-the-stop": _world(
        Client((_ask("wait_state", after=0.1), _ask("move_joints", after=0.2)), 0.0),
        events=(Event("protective_stop", 0.0, 0.5, 0, 1.0, 0),),
    ),
    # The program of the second client has begun when the permission of the first one's comes.
    "one-permission-for-all": _world(
        Client((_ask("move_joints", size=0.4, at=0.2),), 0.0),
        Client((_ask("move_joints", size=0.3, at=0.2, after=0.008),), 0.0),
        latency=5e-3,
    ),
    # Both are the first to command, before the first state has come.
    "first-message-of-two-threads": _world(Client((_ask("output", size=0.4), _ask("output", size=0.4, thread=1)), 0.0)),
    # Both have slept longer than a state may be old, and wait for news.
    "stop-after-the-next": _world(
        Client(
            (
                _ask("move_joints", "cancel", size=0.4, patience=0.5, at=0.2),
                _ask("move_joints", size=0.3, thread=1, at=0.9),
            ),
            0.0,
        ),
        events=(Event("hold_client", 0.3, 1.3, 0, 1.0),),
    ),
    # One of them yields after it has looked, and before it sets.
    "two-connections-claim-the-same": _world(
        Client((_ask("registers", size=0.4, at=0.1), _ask("registers", size=0.4, thread=1, at=0.1)), 0.0),
        lines=0.3,
    ),
    # What the cable has kept back comes in one piece: a stop, its end, and the beginning of the program.
    "let-go-before-the-stop-is-read": _world(
        Client((_ask("speed_joints"), _ask("script", size=0.5)), 0.0),
        events=(Event("cut", 0.0, 0.5, 0, 1.0, 1), Event("protective_stop", 0.0, 0.2, 0, 1.0, 1)),
    ),
    # The controller has it paused when it refuses the script, and a person presses play.
    "refused-script-forgets-the-program": _world(
        Client((_ask("move_joints"), _ask("misspelt_script", after=0.35), _ask("wait_state", after=3.0)), 0.0),
        Client((_ask("play", at=2.0),), 0.0, "dashboard"),
        events=(Event("protective_stop", 0.2, 0.3, 0, 1.0, 0),),
    ),
    # It begins before the second state without the first one.
    "next-stop-forgets-the-program": _world(
        Client((_ask("move_joints"), _ask("wait_state", after=4.0)), 0.0),
        Client((_ask("play", at=2.0),), 0.0, "dashboard"),
        events=(Event("protective_stop", 0.2, 0.3, 0, 1.0, 0), Event("protective_stop", 0.55, 0.3, 0, 1.0, 0)),
    ),
    # It is cancelled while the next one is on its way, which the controller refuses.
    "motion-left-to-a-refused-script": _world(
        Client(
            (
                _ask("move_joints", "cancel", size=0.5, patience=0.196),
                _ask("misspelt_script", thread=1, after=0.2),
                _ask("wait_state", thread=1, after=1.0),
            ),
            0.0,
        ),
        latency=5e-3,
    ),
}
