"""Programs that control the arm by torques, as the vendor's examples for 5.23 and later do.

The first program is a joint impedance along a path of the tool. It uses matrices, the dynamics of the arm and RTDE
values.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import urlink
from urlink.simulator import Controller, Still

# In a shorter time, the torques of the base would exceed the clamps.
SECONDS, RADIUS = 6.0, 0.25

CIRCLE = """
# The stiffness is that of the vendor's example for a UR5e, Nm/rad; the damping is critical for a mass of 1 kg m2.
figures = struct(stiffness=[1000, 1000, 500, 100, 100, 100], largest=[28, 28, 14, 4.5, 4.5, 4.5], slowest=0.0)
def circle():
  def clamped(wanted, limits):
    at = 0
    while at < get_list_length(wanted):
      if wanted[at] > limits[at]:
        wanted[at] = limits[at]
      elif wanted[at] < -limits[at]:
        wanted[at] = -limits[at]
      end
      at = at + 1
    end
    return wanted
  end
  def rooted(values):
    at = 0
    while at < get_list_length(values):
      values[at] = 2 * sqrt(values[at])
      at = at + 1
    end
    return values
  end
  begin = get_target_tcp_pose()
  goal = get_actual_joint_positions()
  damping = rooted(figures.stiffness)
  time = 0.0
  while time < SECONDS:
    u = time / SECONDS
    full = 2 * 3.141592653589793
    angle = full * (10 * pow(u, 3) - 15 * pow(u, 4) + 6 * pow(u, 5))
    rate = full * 30 * pow(u, 2) * pow(1 - u, 2) / SECONDS
    change = full * 60 * u * (1 - u) * (1 - 2 * u) / (SECONDS * SECONDS)
    away = [1 - cos(angle), sin(angle)]
    along = [sin(angle), cos(angle)]
    inward = [cos(angle), -sin(angle)]
    AXES
    goal = get_inverse_kin(pose_add(begin, p[place[0], place[1], place[2], 0, 0, 0]), goal)
    jacobian = get_jacobian(goal)
    goal_speed = inv(jacobian) * speed
    goal_change = inv(jacobian) * (acceleration - get_jacobian_time_derivative(goal, goal_speed) * goal_speed)
    torque = get_mass_matrix(include_rotors_inertia=True) * goal_change + get_coriolis_and_centrifugal_torques()
    torque = torque + figures.stiffness * (goal - get_actual_joint_positions())
    torque = torque + damping * (goal_speed - get_actual_joint_speeds())
    direct_torque(clamped(torque, figures.largest), friction_comp=True)
    if get_rtde_value("actual_execution_time") > figures.slowest:
      figures.slowest = get_rtde_value("actual_execution_time")
    end
    time = time + get_steptime()
  end
  stopj(5)
  textmsg("slowest cycle, ms: ", figures.slowest)
end
"""
# The circle begins sideways, at the side of its centre, and is either horizontal or upright.
HORIZONTAL, UPRIGHT = (1, 0), (1, 2)


def program(axes: tuple[int, int]) -> str:
    """Return the program for a circle that begins along the second of these axes of the base frame."""

    def vector(name: str, first: str, second: str, length: int) -> str:
        parts = ["0"] * length
        parts[axes[0]], parts[axes[1]] = first, second
        return f"    {name} = {RADIUS} * [{', '.join(parts)}]\n"

    lines = vector("place", "away[0]", "away[1]", 3) + vector("speed", "rate * along[0]", "rate * along[1]", 6)
    first, second = (f"change * along[{at}] + rate * rate * inward[{at}]" for at in (0, 1))
    lines += vector("acceleration", first, second, 6)
    return CIRCLE.replace("    AXES\n", lines).replace("SECONDS", str(SECONDS))


@pytest.mark.slow
@pytest.mark.parametrize("axes", [HORIZONTAL, UPRIGHT])
def test_impedance_follows_a_large_circle_from_home(axes: tuple[int, int]) -> None:
    controller = Controller("UR5e", "5.25", motion=Still(), seed=1, files={"circle.urp": program(axes)})
    controller.step(10)
    begin = np.array(controller.arm.sample.pose_target)
    assert controller.dashboard.reply("load circle.urp") == "Loading program: circle.urp"
    assert controller.dashboard.reply("play") == "Starting program"
    path = []
    for _ in range(round((SECONDS + 0.5) * 500)):
        controller.step()
        path.append(controller.arm.sample.pose_actual[:3])
    messages = urlink.decode(b"".join(controller.take_messages()), "primary", "5.25")
    texts = [message.text for message in messages if isinstance(message, urlink.packets.TextMessage)]
    assert texts == ["slowest cycle, ms: 0.859"], messages
    assert controller.modes.safety_mode.name == "NORMAL"
    way = np.array(path) - begin[:3]
    assert np.ptp(way[:, axes[0]]) == pytest.approx(2 * RADIUS, abs=0.004)
    off = np.hypot(way[:, axes[0]] - RADIUS, way[:, axes[1]]) - RADIUS
    across = np.delete(way, axes, axis=1)[:, 0]
    assert np.hypot(off, across).max() < 0.002
    assert math.dist(path[-1], begin[:3]) < 0.002


ADMITTANCE = """
def yields():
  mass = [[8, 0, 0], [0, 8, 0], [0, 0, 8]]
  damping = 12.5 * transpose(mass)
  speed = [0, 0, 0]
  zero_ftsensor()
  step = 0
  while step < 500:
    felt = get_tcp_force()
    speed = speed + get_steptime() * (inv(mass) * ([felt[0], felt[1], felt[2]] - damping * speed))
    speedl([speed[0], speed[1], speed[2], 0, 0, 0], 5, get_steptime())
    step = step + 1
  end
  stopl(5)
end
"""


@pytest.mark.slow
@pytest.mark.parametrize("firmware", ["5.11", "5.25"])
def test_admittance_yields_to_the_force_at_the_tool(firmware: str) -> None:
    controller = Controller("UR5e", firmware, motion=Still(), noise=False)
    controller.step(10)
    begin = np.array(controller.arm.sample.pose_target[:3])
    controller.take(ADMITTANCE)
    controller.step(20)
    controller.push([0, 20, 0, 0, 0, 0])
    controller.step(800)
    assert controller.program_name is None
    assert controller.modes.safety_mode.name == "NORMAL"
    # 20 N against 100 Ns/m result in 0.2 m/s, of which the first 0.08 s are lost to the mass.
    moved = np.array(controller.arm.sample.pose_target[:3]) - begin
    assert moved[1] == pytest.approx(0.2 * (0.96 - 0.08), abs=0.02)
    assert np.abs(moved[[0, 2]]).max() < 0.01


SINE = """
def sine():
  begin = get_actual_joint_positions()
  size = d2r(10)
  rate = 2 * 3.141592653589793 * 0.5
  time = 0.0
  while time < 4.0:
    q = get_actual_joint_positions()
    qd = get_actual_joint_speeds()
    wanted = begin[5] + size * sin(rate * time)
    torque = 100 * (wanted - q[5]) + 20 * (size * rate * cos(rate * time) - qd[5])
    direct_torque([0, 0, 0, 0, 0, torque], friction_comp=True)
    time = time + get_steptime()
  end
  stopj(5)
end
"""


@pytest.mark.slow
def test_torque_sine_of_wrist_3_ends_without_a_stop() -> None:
    controller = Controller("UR5e", "5.25.1", motion=Still(), seed=1)
    controller.step(10)
    begin = controller.arm.setpoint.q
    controller.take(SINE)
    way = []
    for _ in range(2300):
        controller.step()
        way.append(controller.arm.setpoint.q[5] - begin[5])
    assert controller.program_name is None
    assert controller.modes.safety_mode.name == "NORMAL"
    assert math.degrees(max(way)) == pytest.approx(10.0, abs=1.0)
    assert math.degrees(min(way)) == pytest.approx(-10.0, abs=1.0)
    assert math.dist(controller.arm.setpoint.q[:5], begin[:5]) < 0.02
