"""Draw docs/images/time.svg: a simulated arm on a curve while the speed slider moves.

The same code gives the same bytes.
"""

import threading
import time
from pathlib import Path

import matplotlib

matplotlib.use("svg")

import numpy as np
from _drawing import PLOT_STYLE, plot_text
from matplotlib import pyplot

import urlink
from urlink.simulator import Controller, Still

PICTURE = Path(__file__).parent / "images" / "time.svg"
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)


def slider(t):
    """Return the position of the slider, 0 to 1, at a time in s since the start of the motion."""
    return 1.0 if t < 0.7 else 0.3 if t < 1.7 else 0.0 if t < 2.4 else 1.0


def run(scaling):
    """Return time, slider, trajectory time, and positions (desired, actual) of two joints."""
    angle = np.linspace(0.0, 1.0, 41)
    angle = 2.0 * np.pi * angle**3 * (10.0 - 15.0 * angle + 6.0 * angle**2)
    q = np.array([np.add(READY, [0.4 * np.sin(a), 0.4 * (1 - np.cos(a)), 0, 0, 0, 0]) for a in angle])
    rows = []
    with (
        urlink.simulated_time(seed=1),
        Controller("UR5e", "5.11", motion=Still(READY)) as controller,
        urlink.connect(controller.address) as robot,
    ):
        over = threading.Event()

        def move():
            began = time.monotonic()
            while not over.wait(0.01):
                controller.speed_fraction = slider(time.monotonic() - began)

        def note(now):
            rows.append([now.time, slider(now.time), now.trajectory_time, *now.q_desired[:2], *now.q_actual[:2]])

        thread = threading.Thread(target=move)
        thread.start()
        path = urlink.Trajectory.from_arrays(np.linspace(0.0, 2.0, 41), q)
        robot.motion.follow(path, scaling=scaling, feedback=note, goal_time=5.0).wait()
        over.set()
        thread.join()
    return np.array(rows).T


def main():
    """Plot the times, and the two joints against each other."""
    followed, ignored = run("follow"), run("ignore")
    with matplotlib.rc_context(PLOT_STYLE):
        figure, (times, paths) = pyplot.subplots(1, 2, figsize=(8.0, 3.2), layout="constrained")
        times.plot(followed[0], followed[1], color="#718096", linewidth=1.0, label="speed slider")
        times.plot(followed[0], followed[2], color="#2b6cb0", linewidth=1.2, label="trajectory_time, s")
        times.plot(ignored[0], ignored[2], color="#c05621", linewidth=1.2, label='with scaling="ignore", s')
        times.set_xlabel("time, s")
        times.legend(frameon=False, loc="upper left")
        paths.plot(ignored[5], ignored[6], color="#c05621", linewidth=1.2, label='scaling="ignore"')
        paths.plot(followed[5], followed[6], color="#2b6cb0", linewidth=1.2, label="follow")
        paths.plot(followed[3], followed[4], color="black", linewidth=0.8, linestyle=(0, (4, 3)), label="trajectory")
        paths.set_xlabel("base, rad")
        paths.set_ylabel("shoulder, rad")
        paths.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.45, 0.55))
        PICTURE.write_text(plot_text(figure))
        pyplot.close(figure)


if __name__ == "__main__":
    main()
