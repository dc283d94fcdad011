"""ROS 2 services for the dashboard, the interlock and outputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from std_srvs.srv import SetBool, Trigger

from urlink import Expiry, LinkError, Robot

__all__ = ["create_services"]

#: Dashboard services that the vendor's ROS 2 driver has too. Services that start an installed program are left out,
#: because no handle would exist for its motion.
_DASHBOARD = (
    "power_on",
    "power_off",
    "brake_release",
    "unlock_protective_stop",
    "restart_safety",
    "close_popup",
    "close_safety_popup",
    "clear_operational_mode",
    "pause",
    "quit",
    "shutdown",
    "stop",
)
#: Dashboard services that are executed even if a call is late.
_ALWAYS = ("power_off", "pause", "stop", "shutdown")


def create_services(node: Any, robot: Robot, halt: Callable[[], object], expiry: Expiry) -> None:
    """Create the services of one robot; each answers when the robot has executed the command, or has failed.

    Args:
        node: Node that serves them.
        robot: Robot to command.
        halt: Function that brakes the arm and ends its motion.
        expiry: Check for calls that their client might have abandoned. `halt` and services that only stop the robot are
            executed even if they are late.
    """
    # Separate groups, so that a service that waits for the dashboard does not delay `halt`.
    slow, quick = MutuallyExclusiveCallbackGroup(), ReentrantCallbackGroup()

    def triggered(name: str, call: Callable[[], object], group: Any, *, expires: bool = True) -> None:
        def answer(request: Any, response: Any) -> Any:
            response.success, response.message = _outcome(call, expiry if expires else None)
            return response

        node.create_service(Trigger, name, answer, callback_group=group)

    def switched(name: str, call: Callable[[bool], object]) -> None:
        def answer(request: Any, response: Any) -> Any:
            response.success, response.message = _outcome(lambda: call(request.data), expiry)
            return response

        node.create_service(SetBool, name, answer, callback_group=slow)

    for name in _DASHBOARD:
        triggered(f"dashboard_client/{name}", getattr(robot.dashboard, name), slow, expires=name not in _ALWAYS)
    triggered("io_and_status_controller/zero_ftsensor", robot.zero_force_sensor, slow)
    triggered("enable", robot.safety.enable, quick)
    triggered("halt", halt, quick, expires=False)
    banks = (("digital_out", 8), ("configurable_digital_out", 8), ("tool_digital_out", 2))
    for bank, count in banks:
        setter = getattr(robot.io, f"set_{bank}")
        for number in range(count):
            switched(f"io_and_status_controller/set_{bank}_{number}", _setting(setter, number))


def _setting(setter: Callable[[int, bool], object], number: int) -> Callable[[bool], object]:
    return lambda on: setter(number, on)


def _outcome(call: Callable[[], object], expiry: Expiry | None) -> tuple[bool, str]:
    try:
        if expiry is not None:
            expiry.check()
        call()
    except LinkError as error:
        return False, f"{type(error).__name__}: {error}"
    return True, ""
