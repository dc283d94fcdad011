"""Names of URScript, ur_rtde, urx and the other interfaces of a controller, with their equivalents in urlink.

If a program uses a name that a public object does not have, `linkcore.names` looks up the name here.
"""

from __future__ import annotations

from ..protocol.field_names import QUANTITIES

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


def own_name(name: str) -> str | None:
    """Return the urlink equivalent of a name of URScript, ur_rtde, urx or an interface; None if it is unknown.

    >>> own_name("moveJ"), own_name("get_actual_q"), own_name("spin")
    ('robot.motion.move_joints(q)', 'robot.realtime.wait().q_actual', None)
    >>> own_name("actual_q")
    "robot.realtime.wait().q_actual, or robot.rtde.outputs('actual_q')"
    """
    own = _OWN.get(name.replace("_", "").lower())
    return own or next((_places(row) for row in QUANTITIES if name in (*row[:2], row[2].rpartition(".")[2])), None)


def _places(row: tuple[str, ...]) -> str:
    """Return the calls that read one quantity."""
    return f"robot.realtime.wait().{row[0]}, or robot.rtde.outputs({row[1]!r})"
