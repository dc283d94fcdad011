"""Run a policy of openpi's policy server on an arm, with real-time chunking.

The server computes a chunk of joint positions from an observation, while the arm executes the previous chunk. The
number of steps that are frozen meanwhile follows the measured latency. Each request contains these steps, under
`planned` and `frozen_steps`, for policies that continue them. The transforms of openpi's UR5 example ignore both.

The observation has the keys of openpi's UR5 example: `joints` (rad), `gripper` (0 open to 1 closed), `base_rgb`,
`wrist_rgb` (224 x 224) and `prompt`. Replace `camera` by your cameras.

pip install openpi-client
python packages/gym/examples/openpi_policy.py sim:// --server localhost:8000 --prompt "pick up the cube"
python packages/gym/examples/openpi_policy.py 192.168.56.101 --limits lab.json --gripper   # THE ARM MOVES
"""

import argparse
import queue
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from openpi_client.websocket_client_policy import WebsocketClientPolicy

import urlink
from linkcore import clock
from urlink_gym import ChunkFollower, Moment
from urlink_gym.arm_env import HOME

#: Longest time in s until the server accepts the connection, and until it answers. The client itself waits forever.
CONNECT_TIMEOUT, ANSWER_TIMEOUT = 30.0, 10.0


def camera(name: str) -> np.ndarray:
    """Return an image of a camera, shape (224, 224, 3). This one is black."""
    return np.zeros((224, 224, 3), np.uint8)


def within(seconds: float, what: str, call: Callable[[], Any]) -> Any:
    """Return the result of a call that has no timeout.

    Raises:
        urlink.LinkTimeout: If it takes longer than `seconds`.
    """
    results: queue.SimpleQueue[tuple[Any, BaseException | None]] = queue.SimpleQueue()

    def work() -> None:
        try:
            results.put((call(), None))
        except BaseException as error:
            results.put((None, error))

    threading.Thread(target=work, name="openpi", daemon=True).start()
    try:
        result, error = clock.get(results, seconds)
    except queue.Empty:
        raise urlink.LinkTimeout(f"{what} did not answer within {seconds:g} s") from None
    if error is not None:
        raise error
    return result


def request(moment: Moment, robot: urlink.Robot, has_gripper: bool, prompt: str) -> dict[str, Any]:
    """Return the observation for the server."""
    position = robot.gripper.position() / 255.0 if has_gripper else 0.0
    return {
        "joints": moment.state.q_actual.astype(np.float32),
        "gripper": np.array([position], np.float32),
        "base_rgb": camera("base"),
        "wrist_rgb": camera("wrist"),
        "prompt": prompt,
        "planned": moment.planned.astype(np.float32),
        "frozen_steps": moment.frozen,
    }


def actions(reply: Any) -> np.ndarray:
    """Return the rows of a reply: six joint positions and the gripper.

    Raises:
        urlink.BadValue: If the reply has no such rows.
    """
    found = reply.get("actions") if isinstance(reply, dict) else None
    if not isinstance(found, np.ndarray) or found.ndim != 2 or found.shape[1] < 7 or not np.isfinite(found).all():
        what = f"an array of shape {found.shape}" if isinstance(found, np.ndarray) else f"{found!r:.60}"
        raise urlink.BadValue(f"the server sent {what} as actions; expected finite rows of 7 numbers")
    return found[:, :7]


def run(robot: urlink.Robot, policy: Any, args: argparse.Namespace) -> ChunkFollower:
    """Follow the policy for `args.duration` seconds; return the follower with its statistics."""
    grip = -1
    with ChunkFollower(robot, args.period, max_step=args.max_step) as follower:
        end = clock.now() + args.duration
        while clock.now() < end:
            moment = follower.observe()
            infer = partial(policy.infer, request(moment, robot, args.gripper, args.prompt))
            chunk = actions(within(ANSWER_TIMEOUT, "the policy server", infer))
            try:
                begins, _ = follower.follow(moment, chunk[:, :6])
            except urlink.BadValue as error:
                # The arm keeps the previous chunk, and rests at its end.
                print(f"skipped a chunk: {error}")
                continue
            if args.gripper:
                # The fingers move once for each chunk, to their position in its first step that is not frozen.
                position = round(255 * min(max(float(chunk[moment.frozen, 6]), 0.0), 1.0))
                if abs(position - grip) > 2:
                    robot.gripper.move(position, wait=False)
                    grip = position
            if args.verbose:
                print(f"t={moment.time:.2f} s: {moment.frozen} frozen, begins {begins:.2f} s")
    return follower


def parsed(words: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Run a policy of openpi's policy server on an arm.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot or simulator (default: sim://)")
    parser.add_argument("--server", default="localhost:8000", help="policy server (default: localhost:8000)")
    parser.add_argument("--prompt", default="", help="instruction for the policy")
    parser.add_argument("--limits", help="JSON file of urlink.SessionLimits, or 'teaching'; required for a real arm")
    parser.add_argument("--gripper", action="store_true", help="use a Robotiq gripper; its fingers close and open")
    parser.add_argument("--period", type=float, default=0.05, help="time between two steps, s (default: 0.05)")
    parser.add_argument("--max-step", type=float, default=0.05, help="largest step of a joint, rad (default: 0.05)")
    parser.add_argument("--duration", type=float, default=30.0, help="duration, s (default: 30)")
    parser.add_argument("--verbose", action="store_true", help="print a line for each chunk")
    args = parser.parse_args(words)
    if args.limits is None and not args.address.startswith("sim://"):
        parser.error("pass --limits for a real arm, because a policy chooses motions on its own")
    return args


def main() -> None:
    args = parsed()
    limits = None if args.limits is None else urlink.SessionLimits.named(args.limits)
    host, _, port = args.server.rpartition(":")
    policy = within(CONNECT_TIMEOUT, "the policy server", lambda: WebsocketClientPolicy(host, int(port)))
    with urlink.connect(args.address, limits=limits) as robot:
        if args.gripper:
            robot.gripper.activate()
        robot.motion.move_joints(HOME, speed=0.25, wait=120.0)
        follower = run(robot, policy, args)
    print(f"latency up to {follower.latency:.2f} s, {follower.late} late chunks")


if __name__ == "__main__":
    main()
