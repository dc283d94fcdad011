"""Fixtures for tests of programs that use urlink or rhdlink.

The fixtures provide a simulated controller, a robot, a mobile robot, and simulated time. pytest loads this module in
every run in an environment that contains urlink. Therefore the module does not import urlink at the top. Test runs of
other projects then do not load numpy. A coverage measurement of urlink begins before any line of urlink is executed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
    from urlink import Robot, Simulation
    from urlink.simulator import Controller

__all__ = ["rhd_turtle", "simulated_time", "urlink_controller", "urlink_robot"]

_MARKERS = (
    "urlink(model, firmware, faults, connect, ...): configure the simulated controller of this test: its arm and "
    "firmware, faults by name such as 'protective_stop' or 'cut=realtime@2', arguments of urlink.connect, and other "
    "arguments of urlink.simulator.Controller, such as stepped=True",
    "simulated_time(seed, limit, latency, jitter): set the arguments of urlink.simulated_time",
    "rhd_turtle(smr, world, ...): configure the simulated mobile robot of this test: whether it is an SMR, arguments "
    "of rhdlink.host.world.World, and other arguments of rhdlink.Host, such as pacing='lockstep'",
)


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers."""
    for marker in _MARKERS:
        config.addinivalue_line("markers", marker)


def _wanted(request: pytest.FixtureRequest, name: str) -> dict[str, Any]:
    """Return the arguments of all markers with the name `name`.

    Arguments for the test have priority over arguments for its class and module.
    """
    wanted: dict[str, Any] = {}
    for marker in request.node.iter_markers(name):
        if marker.args:
            raise pytest.UsageError(
                f"{request.node.nodeid}: @pytest.mark.{name} has positional arguments; pass arguments by name"
            )
        wanted = {**marker.kwargs, **wanted}
    return wanted


@pytest.fixture
def simulated_time(request: pytest.FixtureRequest) -> Iterator[Simulation]:
    """Simulated time for the test, and for the fixtures that the test names after this one.

    See `urlink.simulated_time`. Use ``@pytest.mark.simulated_time(seed=7)`` to pass arguments.
    """
    import urlink

    with urlink.simulated_time(**_wanted(request, "simulated_time")) as simulation:
        yield simulation


@pytest.fixture
def urlink_controller(request: pytest.FixtureRequest) -> Iterator[Controller]:
    """Simulated controller that serves free ports.

    The controller has the attributes `address`, `faults`, `signals`, `arm` and more. Use
    ``@pytest.mark.urlink(model="UR5e", firmware="5.11", faults=["protective_stop@2"])`` to configure it; see
    `urlink.simulator.Controller`. With ``stepped=True``, the time of the controller passes only in
    ``urlink_controller.step(cycles)`` and in ``with urlink_controller.passing():``.
    """
    wanted = _wanted(request, "urlink")
    wanted.pop("connect", None)
    faults = wanted.pop("faults", ())
    if isinstance(faults, str) or not isinstance(faults, Iterable):
        raise pytest.UsageError(f"{request.node.nodeid}: faults={faults!r}; expected a list of names")

    from urlink.simulator import Controller

    try:
        controller = Controller(**wanted)
        controller.schedule(
            *(fault if not isinstance(fault, str) or "@" in fault else f"{fault}@0" for fault in faults)
        )
    except (TypeError, ValueError) as error:  # BadValue and similar errors are ValueErrors
        raise pytest.UsageError(f"{request.node.nodeid}: @pytest.mark.urlink: {error}") from error
    with controller:
        yield controller


@pytest.fixture
def urlink_robot(request: pytest.FixtureRequest, urlink_controller: Controller) -> Iterator[Robot]:
    """Robot that is connected to `urlink_controller`, and is closed at the end of the test.

    Use the marker's ``connect={"require_enable": "always"}`` to pass arguments of `urlink.connect`. With a stepped
    controller, the inactivity timeout is one hour, because the time of the controller passes only when the test steps
    it.
    """
    import contextlib

    import urlink

    wanted = _wanted(request, "urlink")
    options: dict[str, Any] = {}
    passing: contextlib.AbstractContextManager[object] = contextlib.nullcontext()
    if wanted.get("stepped"):
        options = {"silence": 3600.0, "stale_after": 3600.0}
        passing = urlink_controller.passing()  # the first state contains the identity of the controller
    options |= wanted.get("connect", {})
    with passing:
        robot = urlink.connect(urlink_controller.address, **options)
    with robot:
        yield robot


@pytest.fixture
def rhd_turtle(request: pytest.FixtureRequest) -> Iterator[Turtle | SmrTurtle]:
    """Simulated mobile robot that serves a free port.

    The address is `rhd_turtle.host.address`, and the simulated world is `rhd_turtle.world`. Use
    ``@pytest.mark.rhd_turtle(smr=True, world={"size": 5.0}, period=0.005)`` to configure it; see `rhdlink.Host`. With
    ``pacing="lockstep"``, the time of the robot passes only with each sync of a client.
    """
    from rhdlink import Host
    from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
    from rhdlink.host.world import World

    wanted = {"port": 0, **_wanted(request, "rhd_turtle")}
    kind = SmrTurtle if wanted.pop("smr", False) else Turtle
    try:
        turtle = kind(World(**wanted.pop("world", {})))
        host = Host([turtle], **wanted)
    except (TypeError, ValueError) as error:
        raise pytest.UsageError(f"{request.node.nodeid}: @pytest.mark.rhd_turtle: {error}") from error
    with host:
        yield turtle
