"""Names of URScript, ur_rtde, urx and the other interfaces of a controller, with their equivalents in urlink.

If a program uses a name that a public object does not have, `linkcore.names` looks up the name here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import Elsewhere

if TYPE_CHECKING:
    from linkcore.wire.packet import State

#: Calls of urlink, and the equivalent names of other libraries, in lower case and without underscores.
_NAMES = {
    "robot.motion.move_joints(q)": "movej",
    "robot.motion.move_joints(robot.kinematics.inverse(pose, near))": "movejik",
    "robot.motion.move_linear(pose)": "movel translate",
    "robot.motion.move_linear(robot.kinematics.forward(q))": "movelfk",
    "robot.motion.move_circular(via, to)": "movec",
    "robot.motion.path([Linear(pose, blend=...), ...])": "movep movels",
    "robot.motion.path([...])": "movepath",
    "robot.motion.path([Joint(q, blend=...), ...])": "movejs",
    "robot.motion.until_contact(direction)": "moveuntilcontact toolcontact",
    "with robot.motion.servo() as servo: servo.send(q)": "servoj",
    "with robot.motion.servo() as servo: servo.schedule(Linear(pose), at)": "servol",
    "robot.motion.path([Circular(via, to)])": "servoc",
    "the end of the block: with robot.motion.servo() as servo": "servostop",
    "robot.motion.speed_joints(qd), or robot.motion.jog()": "speedj",
    "robot.motion.speed_linear(xd), or robot.motion.jog('base')": "speedl",
    "robot.motion.stop()": "speedstop stopj stopl stop halt",
    "with robot.motion.jog('base') as jog: jog.move(speeds)": "jogstart",
    "the end of the block: with robot.motion.jog() as jog": "jogstop",
    "with robot.motion.force_mode(frame, selection, wrench, limits)": "forcemode",
    "the end of the block: with robot.motion.force_mode(...)": "endforcemode forcemodestop",
    "with robot.motion.torque() as torque: torque.send(values)": "directtorque",
    "with robot.freedrive()": "freedrivemode teachmode setfreedrive",
    "the end of the block: with robot.freedrive()": "endfreedrivemode endteachmode",
    "robot.realtime.wait().q_actual": "getactualq getactualjointpositions getj",
    "robot.realtime.wait().q_target": "gettargetq gettargetjointpositions",
    "robot.realtime.wait().qd_actual": "getactualqd",
    "robot.realtime.wait().tool_vector_actual": "getl getpose getactualtcppose",
    "robot.realtime.wait().tool_vector_target": "gettargettcppose",
    "robot.realtime.wait().tcp_speed_actual": "getactualtcpspeed",
    "robot.realtime.wait().tcp_force": "getactualtcpforce gettcpforce getforce",
    "robot.safety.robot_mode": "getrobotmode",
    "robot.safety.mode": "getsafetymode",
    "robot.safety.is_enabled": "isrunning",
    "robot.realtime.stats, or urlink.ConnectionEvent": "isconnected",
    "robot.close()": "disconnect",
    "nothing: lost connections reconnect automatically": "reconnect",
    "robot.kinematics.forward(q)": "getforwardkin getforwardkinematics fk",
    "robot.kinematics.inverse(pose, near)": "getinversekin getinversekinematics ik",
    "urlink.arm.poses.compose(p_from, p_from_to)": "posetrans",
    "urlink.arm.poses.invert(pose)": "poseinv",
    "robot.set_tcp(pose)": "settcp",
    "robot.realtime.wait().tool_vector_actual, or robot.set_tcp(pose)": "tcp tcppose",
    "robot.set_payload(mass, cog)": "setpayload payload",
    "robot.set_payload(mass, cog, inertia)": "settargetpayload",
    "robot.set_speed_slider(fraction)": "setspeedslider",
    "robot.set_speed_slider(fraction), or the argument speed of a motion": "speed velocity",
    "the argument acceleration of a motion": "acceleration",
    "robot.zero_force_sensor()": "zeroftsensor",
    "robot.popup(text), or textmsg in a text for robot.script.run": "textmsg",
    "robot.popup(text)": "popup sendmessage",
    "time.sleep(seconds)": "sleep",
    "robot.script.run(text)": "sendprogram sendscript sendcustomscript sendcustomscriptfunction run",
    "robot.io.set_digital_out(number, on)": "setdigitalout setstandarddigitalout",
    "robot.io.set_configurable_digital_out(number, on)": "setconfigurabledigitalout",
    "robot.io.set_tool_digital_out(number, on)": "settooldigitalout",
    "robot.io.set_analog_out(number, fraction)": "setanalogout setstandardanalogout",
    "robot.io.digital_in(number)": "getdigitalin getstandarddigitalin",
    "robot.io.digital_out(number)": "getdigitalout",
    "robot.io.analog_in(number).value": "getanalogin getstandardanalogin",
    "robot.dashboard.power_on(), or robot.dashboard.start()": "poweron",
    "robot.dashboard.power_off()": "poweroff",
    "robot.dashboard.brake_release(), or robot.dashboard.start()": "brakerelease",
    "robot.dashboard.unlock_protective_stop()": "unlockprotectivestop reset",
    "robot.dashboard.play()": "play",
    "robot.motion.move_joints(q), or robot.motion.move_linear(pose)": "moveto move",
    "robot.motion.move_joints(q), with the joint positions of your home posture": "home",
    "robot.gripper.move(position)": "grippermove",
    "robot.gripper.close()": "closegripper grip",
    "robot.gripper.open()": "opengripper",
    "controller.faults.emergency_stop() of a simulated robot": "estop",
    "urlink.connect(address)": "robotinterface rtdecontrolinterface rtdereceiveinterface urrobot",
    "urlink.connect('sim://ur5e')": "simulator simulate ursim",
    "robot.realtime.wait(), or robot.realtime.latest": "state getstate rtdereceive",
    "robot.realtime.wait()": "wait",
}
_OWN = {name: own for own, names in _NAMES.items() for name in names.split()}

#: One row for each quantity: its names on the real-time interface, in RTDE, and on the primary interface.
_QUANTITIES = """
    q_actual                actual_q                    joint_data.q_actual
    q_target                target_q                    joint_data.q_target
    qd_actual               actual_qd                   joint_data.qd_actual
    qd_target               target_qd                   -
    qdd_target              target_qdd                  -
    I_target                target_current              -
    I_actual                actual_current              joint_data.I_actual
    I_control               joint_control_output        -
    M_target                target_moment               -
    V_actual                actual_joint_voltage        joint_data.V_actual
    motor_temperatures      joint_temperatures          joint_data.T_motor
    joint_modes             joint_mode                  joint_data.joint_modes
    tool_vector_actual      actual_TCP_pose             cartesian_info.X
    tool_vector_target      target_TCP_pose             -
    tcp_speed_actual        actual_TCP_speed            -
    tcp_speed_target        target_TCP_speed            -
    tcp_force               actual_TCP_force            force_mode_data.Fx
    tool_accelerometer      actual_tool_accelerometer   -
    time                    timestamp                   robot_mode_data.timestamp
    controller_timer        actual_execution_time       -
    robot_mode              robot_mode                  robot_mode_data.robot_mode
    safety_mode             safety_mode                 masterboard_data.safety_mode
    speed_scaling           speed_scaling               robot_mode_data.speed_scaling
    linear_momentum_norm    actual_momentum             -
    digital_input_bits      actual_digital_input_bits   masterboard_data.digital_input_bits
    digital_output_bits     actual_digital_output_bits  masterboard_data.digital_output_bits
    V_main                  actual_main_voltage         -
    V_robot                 actual_robot_voltage        masterboard_data.robot_voltage_48V
    I_robot                 actual_robot_current        masterboard_data.robot_current
    program_state           runtime_state               -
    payload_mass            payload                     -
    payload_cog             payload_cog                 -
    payload_inertia         payload_inertia             -
    elbow_position          elbow_position              -
    elbow_velocity          elbow_velocity              -
"""
INTERFACES = ("realtime", "rtde", "primary")
_ROWS = tuple(tuple(line.split()) for line in _QUANTITIES.strip().splitlines())
#: Short names of real-time quantities that other libraries and programs use.
_SHORT = {"q": "q_actual", "qd": "qd_actual", "tcp": "tool_vector_actual", "pose": "tool_vector_actual"}


def own_name(name: str) -> str | None:
    """Return the urlink equivalent of a name of URScript, ur_rtde, urx or an interface; None if it is unknown.

    >>> own_name("moveJ"), own_name("get_actual_q"), own_name("spin")
    ('robot.motion.move_joints(q)', 'robot.realtime.wait().q_actual', None)
    >>> own_name("actual_q")
    "robot.realtime.wait().q_actual, or robot.rtde.outputs('actual_q')"
    """
    own = _OWN.get(name.replace("_", "").lower())
    return own or next((_places(row) for row in _ROWS if name in (*row[:2], row[2].rpartition(".")[2])), None)


def _places(row: tuple[str, ...]) -> str:
    """Return the calls that read one quantity."""
    return f"robot.realtime.wait().{row[0]}, or robot.rtde.outputs({row[1]!r})"


def name_on(interface: str, name: str) -> str | None:
    """Return the name of a quantity on one interface, given its name on any interface; None if it is unknown.

    >>> name_on("realtime", "actual_q"), name_on("rtde", "q_actual")
    ('q_actual', 'actual_q')
    >>> name_on("primary", "actual_q")
    'joint_data.q_actual'

    Args:
        interface: Interface of the returned name: one of `INTERFACES`.
        name: Name of the quantity on any interface.
    """
    at = INTERFACES.index(interface)
    for row in _ROWS:
        if name in (*row, row[2].rpartition(".")[2]) or _SHORT.get(name) == row[0]:
            return None if row[at] == "-" else row[at]
    return None


def hint_other_interfaces(kind: type[State], interface: str) -> None:
    """Let a packet class raise an error with the correct name, for each name of a field on another interface."""
    for name in {*_SHORT, *(part for row in _ROWS for part in (*row[:2], row[2].rpartition(".")[2]))}:
        own = name_on(interface, name)
        field = None if own is None else own.rpartition(".")[2] if kind.FIELDS else own
        is_there = not kind.FIELDS or interface == "rtde" or field in kind.FIELDS
        if field not in (None, name) and is_there and not hasattr(kind, name):
            setattr(kind, name, Elsewhere(name, str(field)))
