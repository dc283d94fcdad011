"""A spring and a damper for one joint, made of torques: the motion of the joint with three dampers."""

from __future__ import annotations

from matplotlib.figure import Figure

from urlink.simulator import Controller, Still

SIZE = (7.0, 4.2)
#: Stiffness, in Nm/rad; damping of each run, in Nms/rad; start of the joint, in rad; duration of the plot, in s.
STIFFNESS, DAMPINGS, AWAY, DURATION = 5.0, (0.1, 0.5, 2.0), 0.3, 2.0
PROGRAM = """
def spring():
  goal = get_actual_joint_positions()
  while True:
    q = get_actual_joint_positions()
    qd = get_actual_joint_speeds()
    torque = {stiffness} * (goal[5] + {away} - q[5]) - {damping} * qd[5]
    direct_torque([0, 0, 0, 0, 0, torque], friction_comp=True)
    write_output_float_register(0, torque)
  end
end
"""


def response(damping: float) -> tuple[list[float], list[float], list[float]]:
    """Return times (s), angle of the joint (rad), and torque of the loop (Nm)."""
    controller = Controller("UR5e", "5.25", motion=Still())
    controller.step()
    start = controller.arm.setpoint.q[5]
    controller.take(PROGRAM.format(stiffness=STIFFNESS, away=AWAY, damping=damping))
    times, angles, torques = [], [], []
    for cycle in range(round(DURATION * controller.firmware.rate)):
        controller.step()
        times.append(cycle / controller.firmware.rate)
        angles.append(controller.arm.setpoint.q[5] - start)
        torques.append(controller.registers.outputs.floats[0])
    return times, angles, torques


def draw(figure: Figure) -> str:
    """Plot angle and torque, one line for each damper."""
    angle, torque = figure.subplots(2, 1, sharex=True)
    angle.axhline(AWAY, color="0.8")
    for damping, colour in zip(DAMPINGS, ("#c05621", "#2b6cb0", "#2f855a"), strict=True):
        times, angles, torques = response(damping)
        angle.plot(times, angles, color=colour, label=f"{damping:g} Nm s/rad")
        torque.plot(times, torques, color=colour)
    angle.set_ylabel("wrist 3, rad")
    torque.set(ylabel="torque of the loop, Nm", xlabel="controller time, s")
    angle.legend()
    return (
        f"A spring of {STIFFNESS:g} Nm/rad pulls wrist 3 of a simulated UR5e to a position that is {AWAY:g} rad away, "
        "with three dampers. The friction of the arm is compensated."
    )
