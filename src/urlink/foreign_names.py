"""Names of URScript, ur_rtde and urx, and what they are called here, for those who try them on a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.text import similar

#: what does it here -> the names of it there, in small letters and without underscores
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
    "nothing: connections that were lost come back by themselves": "reconnect",
    "robot.kinematics.forward(q)": "getforwardkin getforwardkinematics",
    "robot.kinematics.inverse(pose, near)": "getinversekin getinversekinematics",
    "urlink.poses.compose(p_from, p_from_to)": "posetrans",
    "urlink.poses.invert(pose)": "poseinv",
    "robot.set_tcp(pose)": "settcp",
    "robot.set_payload(mass, cog)": "setpayload",
    "robot.set_payload(mass, cog, inertia)": "settargetpayload",
    "robot.set_speed_slider(fraction)": "setspeedslider",
    "robot.zero_force_sensor()": "zeroftsensor",
    "robot.popup(text), or textmsg in a text for robot.script.run": "textmsg",
    "robot.popup(text)": "popup sendmessage",
    "time.sleep(seconds)": "sleep",
    "robot.script.run(text)": "sendprogram sendcustomscript sendcustomscriptfunction run",
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
    "robot.dashboard.unlock_protective_stop()": "unlockprotectivestop",
    "robot.dashboard.play()": "play",
    "robot.motion.move_joints(q), or robot.motion.move_linear(pose)": "moveto move",
    "robot.motion.move_joints(q), with the joint positions that are home to you": "home",
    "robot.gripper.move(position)": "grippermove",
    "robot.gripper.close()": "closegripper",
    "robot.gripper.open()": "opengripper",
}
_OWN = {name: own for own, names in _NAMES.items() for name in names.split()}


def own_name(name: str) -> str | None:
    """What does here what a name of URScript, ur_rtde or urx does there; None if it is none of these.

    >>> own_name("moveJ"), own_name("get_actual_q"), own_name("spin")
    ('robot.motion.move_joints(q)', 'robot.realtime.wait().q_actual', None)
    """
    return _OWN.get(name.replace("_", "").lower())


class AnswersForeignNames:
    """What a user holds: an attribute that it does not have is an error that names what does it here."""

    __slots__ = ()

    if not TYPE_CHECKING:  # type checkers must not take it for an object with any attribute

        def __getattr__(self, name: str) -> object:
            kind = type(self).__name__
            known = None if name.startswith("_") else own_name(name)
            if known is not None:
                what = f"{name!r}; here it is: {known}"
            else:
                hint = "" if name.startswith("_") else similar(name, (each for each in dir(self) if each[0] != "_"))
                what = f"attribute {name!r}{hint}"
            # Of no object, or Python adds a suggestion of its own to a traceback.
            raise AttributeError(f"{kind} has no {what}", name=name, obj=None)
