"""Robot Raconteur's standard service `com.robotraconteur.robotics.robot.Robot` for one arm."""

from __future__ import annotations

import contextlib
import itertools
import logging
import math
import threading
from typing import Any

import numpy as np
import RobotRaconteur as RR
from RobotRaconteurCompanion.Util.DateTimeUtil import DateTimeUtil

from linkcore import clock
from urlink import BadValue, Expiry, LocalError, Motion, Robot, drop_oldest
from urlink.arm import poses
from urlink.packets import RealtimeState, RobotModeData, SafetyMode

from .commander import Commander
from .description import HOME, robot_info
from .errors import translated
from .signals import read_signal, write_signal
from .states import Commanded, States, controller_state_of
from .trajectories import MotionGenerator, read_trajectory

__all__ = ["RATE", "SETTLING", "RobotService"]

_log = logging.getLogger("urlink.rr")

#: Default number of states per second.
RATE = 125.0
#: Time, in s, for which commands are refused after this process was interrupted. The commands that waited in the
#: buffers of TCP are delivered within this time.
SETTLING = 2.0
#: Interval, in s, at which a silent robot is reported as lost.
_RETOLD = 0.1
#: Maximum age, in s, of the state to which a command by wire refers.
_LARGEST_AGE = 1.0
#: Time, in s, in which the arm must come to rest after a jog with `wait`.
_BRAKE = 2.0


class RobotService:
    """Service object of one robot; `node.register` registers it in a node.

    The members have the names of the service definition, and mostly its order. Errors of urlink reach the client as
    errors of Robot Raconteur, with the same message.

    Args:
        node: Robot Raconteur node.
        name: Name of the robot.
        robot: Robot to serve. It is not closed with the service.
        rate: Maximum number of states to send per second. A state occupies Robot Raconteur's Python code for about a
            millisecond, during which no other thread of this process runs. Sending all 500 states per second of an
            e-Series would therefore disturb trajectories.
        watchdog: Watchdog of trajectories, in s: without a set-point for this time, the arm brakes on its own.

    Raises:
        BadValue: If `rate` is not positive.
        LinkError: If the robot cannot be reached, or its model is unknown.
    """

    def __init__(self, node: Any, name: str, robot: Robot, rate: float = RATE, watchdog: float = 0.1) -> None:
        if not 0.0 < rate <= 1000.0:
            raise BadValue(f"rate={rate}; expected more than 0 and at most 1000 states per second")
        self._node = node
        self._robot = robot
        self._is_commanded = _takes_commands(robot)
        self._info = robot_info(node, name, robot, self._is_commanded)
        self._states = States(node, self._info.device_info)
        self._epoch = DateTimeUtil(node).TimeSpec2Now()
        self._actions = node.GetConstants("com.robotraconteur.action")["ActionStatusCode"]
        self._status = node.GetStructureType("com.robotraconteur.robotics.trajectory.TrajectoryStatus")
        #: one of this number of states is sent
        self._every = max(round(robot.firmware.rate / rate), 1)
        self._came = itertools.count()
        self._speed_ratio = 1.0
        self._trajectory: tuple[Any, Motion] | None = None
        self._tools: dict[int, str] = {}
        self._downsampler: Any = None
        self._watchdog = watchdog
        self._expiry = Expiry(SETTLING)
        self._commander = Commander(robot, self._wire_value, self._expiry) if self._is_commanded else None
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._subscription: Any = None
        self._thread = threading.Thread(target=self._retell, name="urlink-rr lost", daemon=True)
        # events of the service definition, as Robot Raconteur's own hooks
        self.tool_changed = RR.EventHook()
        self.payload_changed = RR.EventHook()
        self.param_changed = RR.EventHook()

    # -- start and end ---------------------------------------------------------------------------------

    def RRServiceObjectInit(self, context: Any, path: str) -> None:  # noqa: N802
        """Start serving; Robot Raconteur calls this when wires and pipes exist."""
        self.robot_state_sensor_data.MaxBacklog = 3  # type: ignore[attr-defined]
        self._downsampler = RR.BroadcastDownsampler(context, 0)
        for wire in ("robot_state", "advanced_robot_state", "device_clock_now"):
            self._downsampler.AddWireBroadcaster(getattr(self, wire))
        self._downsampler.AddPipeBroadcaster(self.robot_state_sensor_data)  # type: ignore[attr-defined]
        context.AddServerServiceListener(self._heard)
        self._subscription = self._robot.realtime.subscribe(self._taken, policy=drop_oldest(2 * self._every))
        self._expiry.tick()
        self._thread.start()

    def close(self) -> None:
        """Halt the arm if a client moves it, and stop sending; idempotent."""
        self._ended.set()
        if self._subscription is not None:
            self._subscription.close()
            self._thread.join(2.0)
        if self._commander is not None:
            self._commander.close()

    def _heard(self, context: Any, event: int, endpoint: Any) -> None:
        if event == RR.ServerServiceListenerEventType_ClientDisconnected and self._commander is not None:
            self._commander.lost(int(endpoint))

    # -- states ----------------------------------------------------------------------------------------

    def _taken(self, state: RealtimeState) -> None:
        if next(self._came) % self._every == 0:
            self._tell(state)

    def _tell(self, state: RealtimeState) -> None:
        with self._lock:
            simple, advanced, sensor, clock = self._states.make(state, self._commanded())
            try:
                self._downsampler.BeginStep()
                try:
                    self.robot_state.OutValue = simple  # type: ignore[attr-defined]
                    self.advanced_robot_state.OutValue = advanced  # type: ignore[attr-defined]
                    self.device_clock_now.OutValue = clock  # type: ignore[attr-defined]
                    self.robot_state_sensor_data.AsyncSendPacket(sensor, lambda: None)  # type: ignore[attr-defined]
                finally:
                    self._downsampler.EndStep()
            except RR.InvalidOperationException:
                if not self._ended.is_set():
                    raise

    def _retell(self) -> None:
        """Send the last state again while the robot is silent, with the flag of a lost connection.

        It also checks whether this process was interrupted: then clients have to set the command mode again.
        """
        while not clock.wait(self._ended.wait, _RETOLD):
            if self._expiry.tick() and self._commander is not None:
                _log.warning(
                    "%s: halted: this process was interrupted; set the command mode again", self._robot.address
                )
                self._commander.halt()
            state = self._robot.realtime.latest
            if state is not None and state.received is not None and state.received.age > 5 * _RETOLD:
                with contextlib.suppress(RR.RobotRaconteurException):
                    self._tell(state)

    def _commanded(self) -> Commanded:
        commander = self._commander
        if commander is None:
            return Commanded("halt", None)
        trajectory = None
        running = self._trajectory
        if running is not None and not running[1].done:
            whole = running[0]
            now = running[1].progress * whole.duration
            trajectory = (now, whole.duration, _waypoint(whole, now))
        by_wire = commander.is_commanded_by_wire
        return Commanded(
            commander.mode,
            self._robot.safety.refusal,
            by_wire and commander.mode == "position_command",
            by_wire and commander.mode == "velocity_command",
            trajectory,
        )

    @property
    def device_info(self) -> Any:
        """`DeviceInfo` of the robot."""
        return self._info.device_info

    @property
    def robot_info(self) -> Any:
        """`RobotInfo` of the robot."""
        return self._info

    @property
    def operational_mode(self) -> int:
        """`RobotOperationalMode`; always "cobot", because an arm of this kind works next to people."""
        return self._states.operational["cobot"]

    @property
    def controller_state(self) -> int:
        """`RobotControllerState`, derived from robot mode and safety mode."""
        return self._states.controllers[controller_state_of(self._robot.realtime.latest)]

    @property
    def current_errors(self) -> list[Any]:
        """Reason why motions are refused, as an `EventLogMessage`; empty if there is none."""
        refusal = None if self._commander is None else self._robot.safety.refusal
        if refusal is None:
            return []
        message = self._node.NewStructure("com.robotraconteur.eventlog.EventLogMessage")
        header = self._node.NewStructure("com.robotraconteur.eventlog.EventLogMessageHeader")
        header.level = self._node.GetConstants("com.robotraconteur.eventlog")["EventLogLevel"]["error"]
        header.source_device = self._info.device_info.device
        message.header = header
        message.title = type(refusal).__name__
        message.message = str(refusal)
        return [message]

    @property
    def isoch_info(self) -> Any:
        """`IsochInfo` with the rate of the states."""
        info = self._node.NewStructure("com.robotraconteur.device.isoch.IsochInfo")
        info.update_rate = self._robot.firmware.rate / self._every
        info.isoch_epoch = self._epoch
        info.max_downsample = 1000
        return info

    @property
    def isoch_downsample(self) -> int:
        """Number of states that are left out between two states sent to this client."""
        return int(self._downsampler.GetClientDownsample(_endpoint()))

    @isoch_downsample.setter
    def isoch_downsample(self, value: int) -> None:
        self._downsampler.SetClientDownsample(_endpoint(), value)

    # -- modes -----------------------------------------------------------------------------------------

    @property
    def command_mode(self) -> int:
        """`RobotCommandMode`: the kind of commands that are accepted."""
        return self._states.modes["halt" if self._commander is None else self._commander.mode]

    @command_mode.setter
    @translated
    def command_mode(self, value: int) -> None:
        names = {code: name for name, code in self._states.modes.items() if code >= 0}
        if value not in names:
            raise BadValue(f"command_mode={value}; expected one of {names}")
        self._commander_of().choose(names[value], _endpoint())

    @translated
    def halt(self) -> None:
        """Brake, and accept no commands until another mode is chosen."""
        self._commander_of().halt()

    @translated
    def enable(self) -> None:
        """Power the arm on, release its brakes, and permit motions.

        **The arm might move** when the brakes open.
        """
        commands = self._commands
        commands.halt()
        self._robot.dashboard.start()
        if self._robot.safety.cause is None:
            self._robot.safety.wait_until_clear(5.0)
            self._robot.safety.enable()

    @translated
    def disable(self) -> None:
        """Power the arm off."""
        self._commander_of().halt()
        self._robot.dashboard.power_off()

    @translated
    def reset_errors(self) -> None:
        """Unlock a protective stop, or restart the safety system after a violation or fault.

        The controller refuses to unlock within five seconds of the stop. Other stops cannot be reset from here.
        """
        self._commands.halt()
        mode = self._robot.safety.mode
        if mode in (SafetyMode.VIOLATION, SafetyMode.FAULT):
            self._robot.dashboard.restart_safety()
        elif mode == SafetyMode.PROTECTIVE_STOP:
            self._robot.dashboard.unlock_protective_stop()
        elif self._robot.safety.cause is not None:
            raise LocalError(f"cannot reset {self._robot.safety.cause}; a person must do it at the robot")

    @property
    def speed_ratio(self) -> float:
        """Fraction of the speed slider, 0 to 1."""
        newest = self._robot.primary.of(RobotModeData).latest
        return self._speed_ratio if newest is None else newest.target_speed_fraction

    @speed_ratio.setter
    @translated
    def speed_ratio(self, value: float) -> None:
        self._check_commanded()
        self._robot.set_speed_slider(value)
        self._speed_ratio = value

    # -- jog -------------------------------------------------------------------------------------------

    @translated
    def jog_freespace(self, joint_position: Any, max_velocity: Any, wait: bool) -> None:
        """Move the joints to a position, each joint no faster than its `max_velocity`."""
        goal, limits = np.asarray(joint_position, float), np.asarray(max_velocity, float)
        if goal.shape != (6,) or limits.shape != (6,) or not (limits > 0.0).all():
            raise BadValue(
                "jog_freespace: invalid positions or velocities; expected six positions, and six velocities above 0"
            )
        way = np.abs(goal - self._robot.realtime.wait().q_actual)
        seconds = float((way / limits).max())
        # The joint with the longest distance determines the speed of the motion.
        speed = float(way.max()) / seconds if seconds > 0.0 else float(limits.min())
        self._jog(lambda: self._robot.motion.move_joints(goal, min(speed, math.pi)), wait, 600.0)

    @translated
    def jog_joint(self, joint_velocity: Any, timeout: float, wait: bool) -> None:
        """Turn the joints at the given speeds for `timeout` seconds."""
        self._jog(lambda: self._robot.motion.speed_joints(joint_velocity, duration=timeout), wait, timeout + _BRAKE)

    @translated
    def jog_cartesian(self, max_velocity: Any, timeout: float, wait: bool) -> None:
        """Move the tool at a speed in the base frame for `timeout` seconds; chain 0 is the only one."""
        if set(max_velocity) != {0}:
            raise BadValue(f"jog_cartesian: the chains are {sorted(max_velocity)}; expected only chain 0")
        speed = max_velocity[0]
        if isinstance(speed, np.ndarray):
            speed = speed.flat[0]
        linear, angular = ([float(speed[part][axis]) for axis in "xyz"] for part in ("linear", "angular"))
        self._jog(
            lambda: self._robot.motion.speed_linear([*linear, *angular], duration=timeout), wait, timeout + _BRAKE
        )

    def _jog(self, move: Any, wait: bool, seconds: float) -> None:
        motion = self._commands.begin("jog", _endpoint(), move)
        if wait:
            motion.wait(seconds)

    # -- trajectories ----------------------------------------------------------------------------------

    @translated
    def execute_trajectory(self, trajectory: Any) -> MotionGenerator:
        """Return a generator of `TrajectoryStatus`; the motion starts with the first `Next`.

        Closing the generator cancels the motion.
        """
        commands, endpoint = self._commands, _endpoint()
        here = self._robot.realtime.wait().q_target
        followed, on_the_way, at_the_end = read_trajectory(self._node, trajectory, here)

        def follow() -> Motion:
            return self._robot.motion.follow(
                followed, path_tolerance=on_the_way, goal_tolerance=at_the_end, watchdog=self._watchdog
            )

        def begin() -> Motion:
            motion = commands.begin("trajectory", endpoint, follow)
            self._trajectory = (followed, motion)
            return motion

        def status(code: int, seconds: float) -> Any:
            found = self._status()
            found.seqno = self._states.number
            found.action_status = code
            found.trajectory_time = min(seconds, followed.duration)
            found.current_waypoint = _waypoint(followed, seconds)
            return found

        return MotionGenerator(begin, status, self._actions)

    @translated
    def home(self) -> MotionGenerator:
        """Return a generator of `ActionStatusCode` that moves the arm to `JointLimits.home`.

        The speed is a third of the usual one.
        """
        commands, endpoint = self._commands, _endpoint()

        def begin() -> Motion:
            return commands.begin("homing", endpoint, lambda: self._robot.motion.move_joints(HOME, 0.35))

        return MotionGenerator(begin, lambda code, seconds: code, self._actions)

    # -- signals, tool, payload ------------------------------------------------------------------------

    @translated
    def getf_signal(self, signal_name: str) -> Any:
        """Read a signal; see `signals`."""
        return np.array(read_signal(self._robot, signal_name))

    @translated
    def setf_signal(self, signal_name: str, value: Any) -> None:
        """Set a signal; see `signals`."""
        self._check_commanded()
        write_signal(self._robot, signal_name, np.asarray(value, float).tolist())

    @translated
    def tool_attached(self, chain: int, tool: Any) -> None:
        """Set the TCP of a tool in the controller."""
        self._check_chain(chain)
        tcp = tool.tcp.flat[0] if isinstance(tool.tcp, np.ndarray) else tool.tcp
        position = [float(tcp["translation"][axis]) for axis in "xyz"]
        rotation = poses.quaternion_to_rotvec([float(tcp["rotation"][axis]) for axis in "xyzw"])
        self._robot.set_tcp([*position, *rotation.tolist()])
        self.tool_changed.fire(chain, tool.device_info.device.name)

    @translated
    def tool_detached(self, chain: int, tool_name: str) -> None:
        """Set the TCP back to the flange."""
        self._check_chain(chain)
        self._robot.set_tcp([0.0] * 6)
        self.tool_changed.fire(chain, "")

    @translated
    def payload_attached(self, chain: int, payload: Any, pose: Any) -> None:
        """Set mass and centre of gravity of a payload in the controller.

        `pose` is the pose of the payload's frame in the flange frame.
        """
        self._check_chain(chain)
        inertia = payload.inertia.flat[0] if isinstance(payload.inertia, np.ndarray) else payload.inertia
        at = pose.flat[0] if isinstance(pose, np.ndarray) else pose
        position = [float(at["position"][axis]) for axis in "xyz"]
        rotation = poses.quaternion_to_rotvec([float(at["orientation"][axis]) for axis in "xyzw"])
        cog = poses.transform([*position, *rotation.tolist()], [float(inertia["com"][axis]) for axis in "xyz"])
        self._robot.set_payload(float(inertia["m"]), cog.tolist())
        self.payload_changed.fire(chain, payload.device_info.device.name)

    @translated
    def payload_detached(self, chain: int, payload_name: str) -> None:
        """Set the payload in the controller to 0."""
        self._check_chain(chain)
        self._robot.set_payload(0.0)
        self.payload_changed.fire(chain, "")

    @translated
    def getf_param(self, param_name: str) -> Any:
        """Raise an error, because there are no parameters."""
        raise BadValue(f"unknown parameter {param_name!r}; this robot has no parameters")

    @translated
    def setf_param(self, param_name: str, value: Any) -> None:
        """Raise an error, because there are no parameters."""
        raise BadValue(f"unknown parameter {param_name!r}; this robot has no parameters")

    # --------------------------------------------------------------------------------------------------

    def _check_chain(self, chain: int) -> None:
        self._check_commanded()
        if chain != 0:
            raise BadValue(f"chain={chain}; expected 0, the only chain")

    @property
    def _commands(self) -> Commander:
        """Commander for a new command.

        It raises if commands might be too old. A command to halt does not need this check.
        """
        commander = self._commander_of()
        self._expiry.check()
        return commander

    def _commander_of(self) -> Commander:
        if self._commander is None:
            raise LocalError(f"{self._robot.address} is served read-only, so it cannot be commanded")
        return self._commander

    def _check_commanded(self) -> None:
        self._commander_of()
        self._expiry.check()

    def _wire_value(self, name: str) -> tuple[int, Any, Any, int] | None:
        """Return the newest value of a wire for commands."""
        wire = getattr(self, name, None)
        if wire is None:
            return None
        there, value, _, endpoint = wire.TryGetInValue()
        if not there:
            return None
        # A client that repeats the number of its last state lets this side determine the age of the command on its own.
        seen = int(value.state_seqno)
        newest, sent = self._states.number, self._robot.firmware.rate / self._every
        if seen and not newest - _LARGEST_AGE * sent <= seen <= newest:
            return None
        return int(value.seqno), value.command, value.units, int(endpoint)


def _waypoint(trajectory: Any, seconds: float) -> int:
    return min(int(np.searchsorted(trajectory.time, seconds, side="right")), len(trajectory) - 1)


def _endpoint() -> int:
    """Return the endpoint of the calling client."""
    return int(RR.ServerEndpoint.GetCurrentEndpoint())


def _takes_commands(robot: Robot) -> bool:
    try:
        return robot.motion is not None
    except LocalError:
        return False
