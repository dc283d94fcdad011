"""Names of URScript, ur_rtde and urx, and what they are called here, for those who try them on a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.text import similar

#: name, in small letters and without underscores -> what does it here
_OWN = {
    "movej": "robot.motion.move_joints(q)",
    "movejik": "robot.motion.move_joints(robot.kinematics.inverse(pose, near))",
    "movel": "robot.motion.move_linear(pose)",
    "movelfk": "robot.motion.move_linear(robot.kinematics.forward(q))",
    "movec": "robot.motion.move_circular(via, to)",
    "movep": "robot.motion.path([Linear(pose, blend=...), ...])",
    "movepath": "robot.motion.path([...])",
    "movels": "robot.motion.path([Linear(pose, blend=...), ...])",
    "movejs": "robot.motion.path([Joint(q, blend=...), ...])",
    "translate": "robot.motion.move_linear(pose)",
    "moveuntilcontact": "robot.motion.until_contact(direction)",
    "toolcontact": "robot.motion.until_contact(direction)",
    "servoj": "with robot.motion.servo() as servo: servo.send(q)",
    "servol": "with robot.motion.servo() as servo: servo.schedule(Linear(pose), at)",
    "servoc": "robot.motion.path([Circular(via, to)])",
    "servostop": "the end of the block: with robot.motion.servo() as servo",
    "speedj": "robot.motion.speed_joints(qd), or robot.motion.jog()",
    "speedl": "robot.motion.speed_linear(xd), or robot.motion.jog('base')",
    "speedstop": "robot.motion.stop()",
    "jogstart": "with robot.motion.jog('base') as jog: jog.move(speeds)",
    "jogstop": "the end of the block: with robot.motion.jog() as jog",
    "stopj": "robot.motion.stop()",
    "stopl": "robot.motion.stop()",
    "stop": "robot.motion.stop()",
    "halt": "robot.motion.stop()",
    "forcemode": "with robot.motion.force_mode(frame, selection, wrench, limits)",
    "endforcemode": "the end of the block: with robot.motion.force_mode(...)",
    "forcemodestop": "the end of the block: with robot.motion.force_mode(...)",
    "directtorque": "with robot.motion.torque() as torque: torque.send(values)",
    "freedrivemode": "with robot.freedrive()",
    "endfreedrivemode": "the end of the block: with robot.freedrive()",
    "teachmode": "with robot.freedrive()",
    "endteachmode": "the end of the block: with robot.freedrive()",
    "setfreedrive": "with robot.freedrive()",
    "getactualq": "robot.realtime.wait().q_actual",
    "gettargetq": "robot.realtime.wait().q_target",
    "getactualqd": "robot.realtime.wait().qd_actual",
    "getactualjointpositions": "robot.realtime.wait().q_actual",
    "gettargetjointpositions": "robot.realtime.wait().q_target",
    "getj": "robot.realtime.wait().q_actual",
    "getl": "robot.realtime.wait().tool_vector_actual",
    "getpose": "robot.realtime.wait().tool_vector_actual",
    "getactualtcppose": "robot.realtime.wait().tool_vector_actual",
    "gettargettcppose": "robot.realtime.wait().tool_vector_target",
    "getactualtcpspeed": "robot.realtime.wait().tcp_speed_actual",
    "getactualtcpforce": "robot.realtime.wait().tcp_force",
    "gettcpforce": "robot.realtime.wait().tcp_force",
    "getforce": "robot.realtime.wait().tcp_force",
    "getrobotmode": "robot.safety.robot_mode",
    "getsafetymode": "robot.safety.mode",
    "isrunning": "robot.safety.is_enabled",
    "isconnected": "robot.realtime.stats, or urlink.ConnectionEvent",
    "disconnect": "robot.close()",
    "reconnect": "nothing: connections that were lost come back by themselves",
    "getforwardkin": "robot.kinematics.forward(q)",
    "getforwardkinematics": "robot.kinematics.forward(q)",
    "getinversekin": "robot.kinematics.inverse(pose, near)",
    "getinversekinematics": "robot.kinematics.inverse(pose, near)",
    "posetrans": "urlink.poses.compose(p_from, p_from_to)",
    "poseinv": "urlink.poses.invert(pose)",
    "settcp": "robot.set_tcp(pose)",
    "setpayload": "robot.set_payload(mass, cog)",
    "settargetpayload": "robot.set_payload(mass, cog, inertia)",
    "setspeedslider": "robot.set_speed_slider(fraction)",
    "zeroftsensor": "robot.zero_force_sensor()",
    "textmsg": "robot.popup(text), or textmsg in a text for robot.script.run",
    "popup": "robot.popup(text)",
    "sleep": "time.sleep(seconds)",
    "sendprogram": "robot.script.run(text)",
    "sendmessage": "robot.popup(text)",
    "sendcustomscript": "robot.script.run(text)",
    "sendcustomscriptfunction": "robot.script.run(text)",
    "run": "robot.script.run(text)",
    "setdigitalout": "robot.io.set_digital_out(number, on)",
    "setstandarddigitalout": "robot.io.set_digital_out(number, on)",
    "setconfigurabledigitalout": "robot.io.set_configurable_digital_out(number, on)",
    "settooldigitalout": "robot.io.set_tool_digital_out(number, on)",
    "setanalogout": "robot.io.set_analog_out(number, fraction)",
    "setstandardanalogout": "robot.io.set_analog_out(number, fraction)",
    "getdigitalin": "robot.io.digital_in(number)",
    "getstandarddigitalin": "robot.io.digital_in(number)",
    "getdigitalout": "robot.io.digital_out(number)",
    "getanalogin": "robot.io.analog_in(number).value",
    "getstandardanalogin": "robot.io.analog_in(number).value",
    "poweron": "robot.dashboard.power_on(), or robot.dashboard.start()",
    "poweroff": "robot.dashboard.power_off()",
    "brakerelease": "robot.dashboard.brake_release(), or robot.dashboard.start()",
    "unlockprotectivestop": "robot.dashboard.unlock_protective_stop()",
    "play": "robot.dashboard.play()",
    "moveto": "robot.motion.move_joints(q), or robot.motion.move_linear(pose)",
    "move": "robot.motion.move_joints(q), or robot.motion.move_linear(pose)",
    "home": "robot.motion.move_joints(q), with the joint positions that are home to you",
    "grippermove": "robot.gripper.move(position)",
    "closegripper": "robot.gripper.close()",
    "opengripper": "robot.gripper.open()",
}


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
