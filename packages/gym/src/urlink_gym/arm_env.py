"""`ArmEnv`: an arm as a Gymnasium environment with a fixed control rate.

An action sets a new target of a servo with a jerk-limited filter. The arm moves to the newest target, and rests there
if no further action comes. So a policy that hangs, or a training step that takes minutes, leaves the arm at rest.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict
from numpy.typing import ArrayLike, NDArray

import urlink
from linkcore import clock
from urlink import BadValue, Closed, GripperFault, LimitExceeded, LinkError, Robot, SessionLimits
from urlink.arm import poses
from urlink.packets import RealtimeState
from urlink.tools import shown_tcp, six

from .actions import Actions, Blocked, Steps, within
from .tasks import Task

__all__ = ["ArmEnv", "Observation"]

Floats = NDArray[np.float64]
Numbers32 = NDArray[np.float32]
#: Observations by name.
Observation = dict[str, Any]
#: Function that returns an image of a robot's camera, shape (height, width, 3), as bytes.
Camera = Callable[[Robot], NDArray[np.uint8]]

#: Position of the joints at the beginning of an episode, in rad: the tool points down in front of the base.
HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
#: Longest time, in s, until a state arrives, and for the move to the home position.
_STATE_TIMEOUT, _MOVE_TIMEOUT = 1.0, 120.0
#: Largest number of states that wait for the next step: 20 s at 500 Hz.
_STATES = 10_000
#: Distance in rad by which the target of a joint may be ahead of the arm. A target further ahead would move the arm
#: for a long time after the last action.
_AHEAD = 0.5
#: How often the speed of the move to the home position is halved if the session limits the speed of the tool.
_HALVED = 4
#: Change of the gripper's position, of 255, below which no new command is sent.
_SAME = 3
#: Time in s by which a step may be late before it is reported. A sleep ends later than requested.
_LATE = 0.002


class ArmEnv(gymnasium.Env[Observation, Numbers32]):
    """Universal Robots arm as a Gymnasium environment: the simulator, MuJoCo, or a real arm.

    `step` sets the target of the arm, waits until the next multiple of the period, and returns the newest state.
    Nothing is sent before the first `reset`. `reset` moves the arm to `home`. **On a real arm, clear its path first.**

    An action that would exceed a limit of the session, or that the tool cannot reach, is not executed: the arm keeps
    its target, and `info["blocked"]` names the reason. If the robot stops, the connection is lost, or the session is
    closed, the episode ends with `truncated`, the arm is stopped, and `info["error"]` describes the cause. The next
    `reset` raises an error while the cause persists. An exception of your task or intervention also stops the arm.

    Args:
        robot: Address for `urlink.connect`, or a connected `Robot`, which `close` leaves open.
        action: Kind of action, one of `KINDS`.
        rate: Number of steps per second, 1 to 125.
        limits: Limits of the session. Required if `robot` is the address of a real arm.
        home: Joint positions at the beginning of an episode, shape (6,), in rad.
        spread: Largest random deviation of each joint from `home`, in rad.
        steps: Largest change of the target by one action.
        gripper: Whether a Robotiq gripper is the last number of an action, -1 (open) to 1 (closed), and part of the
            observations. The first `reset` activates it: **the fingers close and open**. Each `reset` opens it.
        observe_force: Whether the force at the tool is part of the observations.
        images: Functions that return camera images, by name. Each is called once by the constructor.
        task: Task that rewards steps; None for no reward.
        intervention: Function that is called with this environment in each step. It returns None, or the action that
            replaces the action of the policy.
        freedrive_button: Function that shows in a state of the arm whether a button is held, such as
            `held(DigitalBits.TOOL_0)`. While the button is held, a person moves the arm by hand.
        speed, acceleration, jerk: Limits of the joints for the motion to a target, in rad/s, rad/s² and rad/s³. A
            `joint_speed` of `limits` also applies.
        reset_speed: Speed of the joints on the way to `home`, in rad/s. It is lowered if the limits require that.
        watchdog: Time in s without messages from this computer after which the robot brakes on its own.

    Attributes:
        robot: The connected robot.
        actions: Conversion of actions.
        error: Error that ended the last episode; None if no error ended it.

    Raises:
        BadValue: If an argument is invalid, or `limits` is missing for a real arm.
        LinkError: If the robot cannot be reached.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}

    def __init__(
        self,
        robot: str | Robot = "sim://",
        action: str = "pose_deltas",
        *,
        rate: float = 20.0,
        limits: SessionLimits | None = None,
        home: ArrayLike = HOME,
        spread: float = 0.0,
        steps: Steps | None = None,
        gripper: bool = False,
        observe_force: bool = False,
        images: Mapping[str, Camera] | None = None,
        task: Task | None = None,
        intervention: Callable[[ArmEnv], ArrayLike | None] | None = None,
        freedrive_button: Callable[[RealtimeState], bool] | None = None,
        speed: float = 1.05,
        acceleration: float = 5.0,
        jerk: float = 50.0,
        reset_speed: float = 0.8,
        watchdog: float = 0.5,
    ) -> None:
        self._period = 1.0 / _number("rate", rate, 1.0, 125.0)
        self._home: Floats = np.array(six(home, "home"))
        self._spread = _number("spread", spread, 0.0, 1.0)
        self._reset_speed = _number("reset_speed", reset_speed, 0.01, 3.0)
        _check_limits(robot, limits, freedrive_button is not None)
        if limits is not None and limits.joint_speed is not None:
            speed = min(speed, limits.joint_speed)
        self._servo_options = {"speed": speed, "acceleration": acceleration, "jerk": jerk, "watchdog": watchdog}
        self._has_gripper = gripper
        self._observes_force = observe_force
        self._images = dict(images or {})
        self._task = Task() if task is None else task
        self._intervention = intervention
        self._freedrive_button = freedrive_button
        self.error: LinkError | None = None
        #: block that moves the arm: a servo, freedrive, or None between two episodes
        self._block: urlink.motion.Servo | urlink.motion.Freedrive | None = None
        self._commanded: Floats = self._home
        self._tick = 0.0  # time of the last observation on `linkcore.clock`, in s
        self._grip = 0  # last commanded position of the gripper, 0 to 255
        #: states since the last observation; the reader of the real-time interface adds them
        self._arrived: deque[RealtimeState] = deque(maxlen=_STATES)
        self._state: RealtimeState | None = None
        self._last: Observation = {}
        self._owns_robot = isinstance(robot, str)
        self.robot: Robot = urlink.connect(robot, limits=limits) if isinstance(robot, str) else robot
        try:
            self._subscription = self.robot.realtime.subscribe(self._arrived.append, inline=True)
            self.robot.realtime.wait(5.0)
            box = None if limits is None else limits.box
            self.actions = Actions(action, self.robot.kinematics, steps or Steps(), box)
            low, high = self.actions.space.low, self.actions.space.high
            self.action_space = (
                Box(np.append(low, np.float32(-1.0)), np.append(high, np.float32(1.0)), dtype=np.float32)
                if gripper
                else self.actions.space
            )
            self._bounds = self.action_space.low.astype(np.float64), self.action_space.high.astype(np.float64)
            self.observation_space = Dict(self._spaces())
        except BaseException:
            self.close()
            raise

    # -- episodes --------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Stop the arm, move it to its home position, and begin an episode. THE ARM MOVES.

        Args:
            seed: Seed of `np_random`, from which the task and `spread` draw.
            options: `home`: joint positions for this episode, shape (6,), in rad; without `spread`.

        Returns:
            The observation, and a dictionary with the state under `states`.

        Raises:
            BadValue: If an option is unknown or invalid. The arm does not move.
            SafetyStop, NotRunning, NotEnabled: If the arm must not be moved now.
            LimitExceeded: If the way to the home position exceeds a limit of the session.
            GripperFault: If the gripper cannot be activated.
            LinkError: If the home position is not reached.
        """
        super().reset(seed=seed)
        home = self._home_of(dict(options or {}))
        self._halt()
        if self._has_gripper:
            self.robot.gripper.activate()
            self.robot.gripper.open()
            self._grip = 0
        self._move_home(home)
        self._task.reset(self)
        self.error = None
        self._arrived.clear()
        state = self.robot.realtime.wait(_STATE_TIMEOUT)
        self.actions.tcp = shown_tcp(self.robot.kinematics, state)
        try:
            self._lead(state)
            state, states = self._newest()
            self._last = self._observe(state)
        except BaseException:
            self._halt()
            raise
        self._tick = clock.now()
        return self._last, {"states": states}

    def step(self, action: ArrayLike) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move the target of the arm by an action, wait for the end of the period, and observe the arm.

        `info` contains:

        - `action`: The executed action. It differs from `action` after an intervention, at a limit, and outside of the
          action space.
        - `intervention`: Whether a person replaced the action. Then `intervene_action` contains the same numbers as
          `action`.
        - `blocked`: Why the arm kept its target; empty if it did not. `reach`, `singularity`, `lag`, or the name of a
          limit of the session.
        - `late`: Seconds by which this call came after the end of the last period; 0.0 if it was in time.
        - `states`: All `RealtimeState` objects that arrived since the last observation; the last one is the state of
          the observation. They are kept for 20 s at 500 Hz.
        - `error`: Description of the error that ended the episode; only if `truncated`.

        Args:
            action: Numbers of the action. Numbers outside of the action space are clipped.

        Raises:
            BadValue: If `action` has a wrong shape, or a number is not finite. Nothing is sent.
            ResetNeeded: If no episode is running.
        """
        if self._block is None or self._state is None:
            raise ResetNeeded("no episode is running; call reset() first")
        numbers = self._checked(action, "action")
        try:
            return self._step(numbers, self._state)
        except LinkError as error:
            if isinstance(error, BadValue):
                self._halt()
                raise
            return self._ended(error)
        except BaseException:
            self._halt()
            raise

    def _step(self, numbers: Floats, before: RealtimeState) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        now = clock.now()
        late = now - (self._tick + self._period)
        if late > 0.0:
            self._tick = now  # the arm gets a whole period for each action
        given = None if self._intervention is None else self._intervention(self)
        if given is not None:
            numbers = self._checked(given, "the action of the intervention")
        is_guided = self._freedrive_button is not None and self._freedrive_button(before)
        blocked = ""
        if is_guided:
            self._guide()
            done = None
        else:
            if not isinstance(self._block, urlink.motion.Servo):
                self._halt()
                self._lead(self.robot.realtime.wait(_STATE_TIMEOUT))
            done, blocked = self._command(numbers, before)
        clock.sleep(self._tick + self._period - clock.now())
        self._tick += self._period
        self._check_block()
        state, states = self._newest()
        if done is None:
            done = self.motion_between(before, state)
            self._commanded = state.q_actual
        observation = self._last = self._observe(state)
        reward, is_solved = self._task.judge(self, observation)
        info = {
            "action": done,
            "intervention": given is not None or is_guided,
            "blocked": blocked,
            "late": late if late > _LATE else 0.0,
            "states": states,
        }
        if info["intervention"]:
            info["intervene_action"] = done.copy()
        return observation, float(reward), bool(is_solved), False, info

    def close(self) -> None:
        """Stop the arm, and disconnect if this environment has made the connection. Idempotent."""
        try:
            self._halt()
        finally:
            subscription = getattr(self, "_subscription", None)
            if subscription is not None:
                subscription.close()
            if self._owns_robot:
                self.robot.close()

    # -- for interventions -----------------------------------------------------------------------------

    def rest(self) -> Numbers32:
        """Return the action that keeps the target of the arm and the position of the gripper."""
        return self._with_fingers(self.actions.rest(self._commanded))

    def motion_between(self, before: RealtimeState, after: RealtimeState) -> Numbers32:
        """Return the action that repeats the motion of another arm between two of its states.

        With the kind `joints`, the motion is added to the target of this arm.
        """
        if self.actions.kind == "joints":
            target = self._commanded + (after.q_actual - before.q_actual)
            return self._with_fingers(self.actions.between(target, target, target, target))
        return self._with_fingers(
            self.actions.between(before.q_actual, before.tool_vector_actual, after.q_actual, after.tool_vector_actual)
        )

    # -- motion ----------------------------------------------------------------------------------------

    def _home_of(self, options: dict[str, Any]) -> Floats:
        given = options.pop("home", None)
        if options:
            raise BadValue(f"unknown options {', '.join(map(repr, options))} of reset; expected 'home'")
        if given is not None:
            return np.array(six(given, "home"))
        if not self._spread:
            return self._home
        away: Floats = self.np_random.uniform(-self._spread, self._spread, 6)
        return self._home + away

    def _move_home(self, home: Floats) -> None:
        for halving in range(_HALVED + 1):
            try:
                motion = self.robot.motion.move_joints(home, speed=self._reset_speed / 2**halving)
            except LimitExceeded as error:
                if error.limit not in ("tool_speed", "joint_speed") or halving == _HALVED:
                    raise
            else:
                motion.wait(_MOVE_TIMEOUT)
                return

    def _lead(self, state: RealtimeState) -> None:
        """Begin a servo that keeps the arm at its current target."""
        options: Any = self._servo_options
        servo = self.robot.motion.servo(1.0 / self._period, target_filter="jerk_limited", **options)
        servo.__enter__()
        self._block = servo
        self._commanded = self.robot.realtime.wait(_STATE_TIMEOUT).q_target
        servo.send(self._commanded)
        self._tick = clock.now()

    def _guide(self) -> None:
        """Let a person move the arm by hand."""
        if isinstance(self._block, urlink.motion.Freedrive):
            return
        self._halt()
        freedrive = self.robot.freedrive(watchdog=self._servo_options["watchdog"])
        freedrive.__enter__()
        self._block = freedrive
        self._tick = clock.now()

    def _halt(self) -> None:
        """Stop the arm, and end the servo or freedrive."""
        block, self._block = self._block, None
        if block is not None:
            block.__exit__(None, None, None)

    def _check_block(self) -> None:
        """Raise the error that ended the servo or freedrive, if it has ended."""
        block = self._block
        if block is not None and block.done:
            raise block.error or Closed(f"the {block.name} of this environment has ended")

    def _command(self, numbers: Floats, state: RealtimeState) -> tuple[Numbers32, str]:
        """Send a target, and return the executed action and the reason why the arm kept its target, or ""."""
        servo, commanded = self._block, self._commanded
        assert isinstance(servo, urlink.motion.Servo)
        clipped = within(numbers, *self._bounds)
        arm = clipped[:-1] if self._has_gripper else clipped
        if self._has_gripper:
            self._move_fingers(float(clipped[-1]))
        try:
            target, done = self.actions.target(arm, commanded)
            if np.abs(target - state.q_target).max() > _AHEAD:
                raise Blocked("lag")
            servo.send(target)
        except Blocked as block:
            return self.rest(), block.reason
        except LimitExceeded as error:
            return self.rest(), error.limit
        self._commanded = target
        return self._with_fingers(done), ""

    def _move_fingers(self, wanted: float) -> None:
        position = round(127.5 * (wanted + 1.0))
        if abs(position - self._grip) >= _SAME:
            status = self.robot.gripper.move(position, wait=False)
            if status.fault:
                raise GripperFault(f"the gripper reports fault {status.fault}", status.fault)
            self._grip = position

    def _with_fingers(self, numbers: Numbers32) -> Numbers32:
        return np.append(numbers, np.float32(self._grip / 127.5 - 1.0)) if self._has_gripper else numbers

    def _checked(self, action: ArrayLike, name: str) -> Floats:
        try:
            numbers: Floats = np.asarray(action, np.float64)
        except (TypeError, ValueError):
            raise BadValue(f"{name} is {action!r}; expected {self.action_space.shape} numbers") from None
        if numbers.shape != self.action_space.shape or not np.isfinite(numbers).all():
            raise BadValue(f"{name} is {action!r}; expected finite numbers, shape {self.action_space.shape}")
        return numbers

    def _ended(self, error: LinkError) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """End the episode after an error of the robot or of the session."""
        self.error = error
        self._halt()
        states = list(self._arrived)
        self._arrived.clear()
        info = {
            "action": self.rest(),
            "intervention": False,
            "blocked": "",
            "late": 0.0,
            "states": states,
            "error": f"{type(error).__name__}: {error}",
        }
        # Copies, because the caller holds the arrays of the last observation.
        observation = {name: np.array(value) for name, value in self._last.items()}
        return observation, 0.0, False, True, info

    # -- observations ----------------------------------------------------------------------------------

    def _newest(self) -> tuple[RealtimeState, list[RealtimeState]]:
        """Return the newest state, and all states since the last observation.

        Raises:
            LinkTimeout: If no state arrives within a second.
        """
        arrived = self._arrived
        if not arrived:
            # The reader appends the state shortly after this wait has returned.
            state = self.robot.realtime.wait(_STATE_TIMEOUT)
            states = [state]
        else:
            states = [arrived.popleft() for _ in range(len(arrived))]
            state = states[-1]
        if states[0] is self._state:
            del states[0]
        self._state = state
        return state, states

    def _spaces(self) -> dict[str, Any]:
        spaces: dict[str, Any] = {
            "q_actual": Box(-4.0 * math.pi, 4.0 * math.pi, (6,), np.float32),
            "qd_actual": Box(-10.0, 10.0, (6,), np.float32),
            "tool_position": Box(-10.0, 10.0, (3,), np.float32),
            "tool_rotation": Box(-1.001, 1.001, (6,), np.float32),
        }
        if self._observes_force:
            spaces["tcp_force"] = Box(-1e4, 1e4, (6,), np.float32)
        if self._has_gripper:
            spaces["gripper"] = Box(-1.0, 1.0, (1,), np.float32)
        pictures = {
            name: Box(0, 255, np.asarray(image(self.robot)).shape, np.uint8) for name, image in self._images.items()
        }
        for what, added in (("images", pictures), ("the task", self._task.spaces())):
            if taken := spaces.keys() & added.keys():
                raise BadValue(f"{what} cannot use the names {', '.join(sorted(taken))}; they are already used")
            spaces |= added
        return spaces

    def _observe(self, state: RealtimeState) -> Observation:
        pose = state.tool_vector_actual
        matrix = poses.rotvec_to_matrix(pose[3:])
        found: Observation = {
            "q_actual": state.q_actual.astype(np.float32),
            "qd_actual": state.qd_actual.astype(np.float32),
            "tool_position": pose[:3].astype(np.float32),
            "tool_rotation": np.concatenate((matrix[:, 0], matrix[:, 1])).astype(np.float32),
        }
        if self._observes_force:
            found["tcp_force"] = state.tcp_force.astype(np.float32)
        if self._has_gripper:
            found["gripper"] = np.array([self.robot.gripper.position() / 127.5 - 1.0], np.float32)
        for name, image in self._images.items():
            found[name] = np.asarray(image(self.robot), np.uint8)
        return found | self._task.observe(self)


def _number(name: str, value: float, low: float, high: float) -> float:
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not low <= value <= high:
        raise BadValue(f"{name}={value!r}; expected a number from {low:g} to {high:g}")
    return float(value)


def _check_limits(robot: object, limits: SessionLimits | None, needs_freedrive: bool) -> None:
    """Reject a real arm without limits, and limits that could have no effect or that do not allow freedrive."""
    if not isinstance(robot, str):
        if not isinstance(robot, Robot):
            raise BadValue(f"robot={robot!r}; expected an address such as 'sim://', or a robot of urlink.connect")
        if limits is not None:
            raise BadValue("limits are set when a robot is connected; pass them to urlink.connect, or pass an address")
        return
    if limits is None and not robot.startswith("sim://"):
        raise BadValue(
            f"limits are missing for {robot!r}; a policy chooses motions on its own, so pass "
            "limits=urlink.SessionLimits(...) with a box and a tool_speed"
        )
    if limits is not None and not {"servo", "move_joints"} <= set(limits.allowed):
        raise BadValue("the limits do not allow 'servo' and 'move_joints', which the environment needs")
    if needs_freedrive and limits is not None and "freedrive" not in limits.allowed:
        raise BadValue("a freedrive_button needs 'freedrive' in the attribute allowed of the limits")
