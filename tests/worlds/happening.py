"""Events of a world that are not caused by its clients: to the arm, its pendant, cables and computers."""

from __future__ import annotations

import time
from collections.abc import Callable

from linkcore.simulated import Computer
from linkcore.simulated.network import Listener, Network
from urlink.simulator import Controller, Demonstration, Still

from .asked import PENDANT_PROGRAM
from .watch import Watch
from .world import Event

__all__ = ["at_the_robot", "elsewhere"]

_PORTS = (None, "realtime", "primary", "secondary", "rtde")


def at_the_robot(event: Event, controller: Controller, watch: Watch, number: int) -> None:
    """Perform an event of a person, the arm or the controller; return when it is undone. Runs in its own thread."""
    faults, pendant, call = controller.faults, controller.pendant, controller.call
    port = _PORTS[int(event.size * len(_PORTS)) % len(_PORTS)]
    what = event.what
    if what in ("protective_stop", "emergency_stop", "power_off"):
        getattr(faults, what)()
        time.sleep(event.lasts)
        _clear(controller, watch)
        if what != "protective_stop":
            faults.power_on()
    elif what == "safeguard_stop":
        faults.safeguard_stop(event.size > 0.5)
        time.sleep(event.lasts)
        _clear(controller, watch)
    elif what == "reboot":
        faults.reboot(downtime=event.lasts)
    elif what == "pendant_stop":
        call(pendant.stop)
    elif what == "pendant_pause":
        call(pendant.pause)
        time.sleep(event.lasts)
        call(pendant.play)
    elif what == "pendant_play":
        call(lambda: (pendant.load(PENDANT_PROGRAM), pendant.play()))
    elif what == "pendant_jog":
        watch.begin(number)
        watch.is_led = True
        controller.follow(Demonstration())
        time.sleep(event.lasts)
        controller.follow(Still())
        watch.is_led = False
        watch.end(number, None)
    elif what == "slider":
        # At a lower speed, a motion of a few seconds would exceed the time limit of a client.
        call(lambda: setattr(controller, "speed_fraction", max(event.size, 0.02)))
    elif what in ("local_control", "teach_button"):
        name, value = ("remote_control", False) if what == "local_control" else ("teach_button", True)
        call(lambda: setattr(controller, name, value))
        time.sleep(event.lasts)
        call(lambda: setattr(controller, name, not value))
    elif what == "push":
        controller.push([40.0 * event.size, 0, -20.0 * event.size, 0, 0, 0])
        time.sleep(event.lasts)
        controller.push([0.0] * 6)
    elif what == "stall":
        faults.stall(event.lasts, port)
    elif what == "cut_port":
        faults.cut(port)
    elif what == "garbage":
        faults.garbage(1 + int(2000 * event.size), port, inside=event.lasts > 1.0)
    else:
        if what == "split":
            faults.split([1, 7, 1 + int(1500 * event.size)], port)
        elif what == "rtde_late":
            faults.rtde_late_data(0.3 * event.size)
        else:
            faults.rtde_stale_inputs(event.lasts)
        time.sleep(event.lasts)
        faults.heal()


def _clear(controller: Controller, watch: Watch) -> None:
    """End all stops, including a safeguard stop, after which the program may resume automatically."""
    resumes = controller._state.resumes
    controller.faults.clear()
    if resumes:
        watch.resumes()


def elsewhere(event: Event, network: Network, client: Computer, robot: Computer) -> Callable[[], object] | None:
    """Perform an event of a computer or of the network; return a function that undoes it, or None."""
    there, back = network.route(client, robot), network.route(robot, client)
    what = event.what
    if what == "cut":
        network.cut(client, robot)
    elif what == "deaf":
        back.is_silent = True
    elif what == "mute":
        there.is_silent = True
    elif what == "reset":
        network.reset(client, robot)
        return None
    elif what == "refused":
        return _refused(robot)
    elif what == "slow":
        return _slow(event, network, client, robot)
    elif what in ("suspend_client", "hold_client"):
        client.suspend()
        return client.resume
    elif what == "suspend_robot":
        robot.suspend()
        return robot.resume
    elif what == "no_threads":
        client.starts_threads = False
        return lambda: setattr(client, "starts_threads", True)
    elif what == "clock_jumps":
        client.jumped += 7200.0 * (event.size - 0.5)
        return None
    elif what == "kill_client":
        client.kill()
        return None
    elif what == "power_client":
        client.power_off()
        return None
    return lambda: network.mend(client, robot)


def _refused(robot: Computer) -> Callable[[], object]:
    """Make the ports of the robot refuse connections; return a function that undoes it."""
    kept: dict[int, Listener] = dict(robot.listeners)
    robot.listeners.clear()

    def undo() -> None:
        for port, listener in kept.items():
            if getattr(listener.owner, "_listener", None) is listener:
                robot.listeners.setdefault(port, listener)

    return undo


def _slow(event: Event, network: Network, client: Computer, robot: Computer) -> Callable[[], object]:
    """Give the network a low bandwidth and a higher latency; return a function that undoes it."""
    routes = network.route(client, robot), network.route(robot, client)
    before = [(route.latency, route.bandwidth) for route in routes]
    for route in routes:
        route.latency += 0.1 * event.size
        route.bandwidth = 5e3 + 5e4 * event.size

    def undo() -> None:
        for route, (latency, bandwidth) in zip(routes, before, strict=True):
            route.latency, route.bandwidth = latency, bandwidth

    return undo
