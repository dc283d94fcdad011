"""Read, jog and move a robot that `urlink serve rr` serves.

urlink serve rr arm=sim://ur5e --port 58651
python jog.py rr+tcp://localhost:58651?service=arm
"""

from __future__ import annotations

import sys

import numpy as np
import RobotRaconteur as RR
from RobotRaconteur.Client import RRN


def main(url: str) -> None:
    arm = RRN.ConnectService(url)
    modes = RRN.GetConstants("com.robotraconteur.robotics.robot", arm)["RobotCommandMode"]
    states = arm.robot_state.Connect()
    states.WaitInValueValid(5.0)
    start = states.InValue.joint_position
    print(f"{arm.robot_info.device_info.model.name} at {np.round(start, 3).tolist()}")

    arm.command_mode = modes["jog"]
    arm.jog_freespace(start + np.array([0.1, 0, 0, 0, 0, 0]), np.full(6, 0.5), True)
    print(f"jogged to {np.round(arm.robot_state.PeekInValue()[0].joint_position, 3).tolist()}")

    arm.command_mode = modes["trajectory"]
    kind = "com.robotraconteur.robotics.trajectory"
    trajectory = RRN.NewStructure(f"{kind}.JointTrajectory", arm)
    back = RRN.NewStructure(f"{kind}.JointTrajectoryWaypoint", arm)
    back.joint_position, back.time_from_start = start, 1.0
    # Without a waypoint at time 0, the trajectory starts at the current position of the arm.
    trajectory.waypoints = [back]
    motion = arm.execute_trajectory(trajectory)
    try:
        while True:
            print(f"{motion.Next().trajectory_time:.1f} s")
    except RR.StopIterationException:
        print(f"back at {np.round(arm.robot_state.PeekInValue()[0].joint_position, 3).tolist()}")
    arm.command_mode = modes["halt"]


if __name__ == "__main__":
    main(sys.argv[1])
