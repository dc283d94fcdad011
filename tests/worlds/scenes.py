"""Small worlds, each of which has shown a defect: the actions of programs, and the events at certain moments.

`drawn` varies them, and `planted` injects their defects again.
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


#: Worlds by the names of their defects. Defects that `planted` injects again have an entry in DEFECTS.
SCENES: Mapping[str, World] = {
    # The text of the program is lost in the network and sent again, after a stop has come and has ended.
    "held-program-goes-on": _world(
        Client((_ask("speed_joints", size=0.1), _ask("script", after=0.2)), 0.0),
        events=(Event("mute", 0.0, 0.5, 0, 1.0, 1), Event("protective_stop", 0.05, 0.2, 0, 1.0, 1)),
    ),
    # The block is left at the moment at which a state is answered.
    "message-after-the-last": _world(Client((_ask("jog", "leave", size=0.6),), 0.0)),
    "up-before-its-ports": _world(
        Client((_ask("wait_state", after=0.5, patience=1.0),), 0.0), events=(Event("reboot", 0.01, 0.3, 0, 1.0),)
    ),
    "speed-outlives-its-program": _world(
        Client((_ask("speed_held"),), 0.0), events=(Event("kill_client", 0.02, 0.3, 0, 1.0, 0),)
    ),
    # The task is cancelled between two steps of the loop, while a thread prepares the motion.
    "cancelled-task-moves-the-arm": _world(Client((_ask("move_joints", "cancel", size=0.5),), 0.0, "asyncio")),
    "cancel-brakes-not": _world(Client((_ask("move_joints", "cancel", size=0.9, patience=0.1),), 0.0)),
    "interlock-forgets-the-stop": _world(
        Client((_ask("wait_state", after=0.1), _ask("move_joints", after=0.2)), 0.0),
        events=(Event("protective_stop", 0.0, 0.5, 0, 1.0, 0),),
    ),
    # The program of the second client has started when the permission for the first client's program arrives.
    "one-permission-for-all": _world(
        Client((_ask("move_joints", size=0.4, at=0.2),), 0.0),
        Client((_ask("move_joints", size=0.3, at=0.2, after=0.008),), 0.0),
        latency=5e-3,
    ),
    # Two threads send the first command, before the first state has arrived.
    "first-message-of-two-threads": _world(Client((_ask("output", size=0.4), _ask("output", size=0.4, thread=1)), 0.0)),
    # Both threads were suspended longer than the maximum age of a state, and wait for a new state.
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
    # One of the threads yields after it has read the attribute, and before it sets it.
    "two-connections-claim-the-same": _world(
        Client((_ask("registers", size=0.4, at=0.1), _ask("registers", size=0.4, thread=1, at=0.1)), 0.0),
        lines=0.3,
    ),
    # The data delayed by the cut cable arrives together: a stop, its end, and the start of the program.
    "let-go-before-the-stop-is-read": _world(
        Client((_ask("speed_joints"), _ask("script", size=0.5)), 0.0),
        events=(Event("cut", 0.0, 0.5, 0, 1.0, 1), Event("protective_stop", 0.0, 0.2, 0, 1.0, 1)),
    ),
    # The controller has paused the motion when it refuses the script, and then a person presses play.
    "refused-script-forgets-the-program": _world(
        Client((_ask("move_joints"), _ask("misspelt_script", after=0.35), _ask("wait_state", after=3.0)), 0.0),
        Client((_ask("play", at=2.0),), 0.0, "dashboard"),
        events=(Event("protective_stop", 0.2, 0.3, 0, 1.0, 0),),
    ),
    # The second stop begins before the second state without the first stop.
    "next-stop-forgets-the-program": _world(
        Client((_ask("move_joints"), _ask("wait_state", after=4.0)), 0.0),
        Client((_ask("play", at=2.0),), 0.0, "dashboard"),
        events=(Event("protective_stop", 0.2, 0.3, 0, 1.0, 0), Event("protective_stop", 0.55, 0.3, 0, 1.0, 0)),
    ),
    # The motion is cancelled while the next program is in transit, which the controller refuses.
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
