"""The force sensor, and the settings of force control.

The simulated arm touches nothing: its sensor shows noise, unless an RTDE client sends forces and a program has them
used. So there is no offset to be removed and no contact to be found. Force control itself is not modelled; its settings
are taken, since drivers make them before they know whether it will be used.
"""

from __future__ import annotations

from typing import Any

from ..errors import Fault
from ..machine import ScriptThread
from .declaration import Family, boolean, number, six, vector

__all__ = ["FAMILY"]

FAMILY = Family()

_NOWHERE = (0.0, 0.0, 0.0)


@FAMILY.declare(since="3.0")
def zero_ftsensor(thread: ScriptThread) -> None:
    """The offset of the sensor, which is zero here, is removed."""


@FAMILY.declare(since="5.4")
def tool_contact(thread: ScriptThread, direction: Any = (0, 0, 0, 0, 0, 0)) -> int:
    """Cycles since a contact in that direction began: 0, since there is none."""
    six(direction, "tool_contact: direction")
    return 0


@FAMILY.declare(since="3.5")
def force_mode_set_damping(thread: ScriptThread, damping: Any) -> None:
    _between(damping, "force_mode_set_damping: damping", 1.0)


@FAMILY.declare(since="5.0")
def force_mode_set_gain_scaling(thread: ScriptThread, scaling: Any) -> None:
    _between(scaling, "force_mode_set_gain_scaling: scaling", 2.0)


def _between(value: Any, what: str, highest: float) -> None:
    """That a value out of range is an error is a guess; the manual gives the ranges."""
    given = number(value, what)
    if not 0 <= given <= highest:
        raise Fault(f"{what} is from 0 to {highest:g}, not {given:g}")


# The older of the two names is said to have a defect in its signs on real controllers, which is not here.
@FAMILY.declare(name="enable_external_ft_sensor", since="3.0")
@FAMILY.declare(since="3.14/5.9")
def ft_rtde_input_enable(
    thread: ScriptThread,
    enable: Any,
    sensor_mass: Any = 0.0,
    sensor_measuring_offset: Any = _NOWHERE,
    sensor_cog: Any = _NOWHERE,
) -> None:
    """The force at the TCP is what RTDE clients send as `external_force_torque`; mass and places are not looked at."""
    number(sensor_mass, "ft_rtde_input_enable: sensor_mass")
    vector(sensor_measuring_offset, "ft_rtde_input_enable: sensor_measuring_offset", 3)
    vector(sensor_cog, "ft_rtde_input_enable: sensor_cog", 3)
    thread.world.use_external_force(boolean(enable, "ft_rtde_input_enable: enable"))
