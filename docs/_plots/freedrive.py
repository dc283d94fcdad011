"""An arm that is pushed in freedrive, and the same without freedrive."""

from __future__ import annotations

from matplotlib.figure import Figure

from urlink.simulator import Controller, Still

SIZE = (7.0, 4.2)
#: Force upwards, in N; start and end of the push, in s.
PUSH, BEGINS, ENDS = 20.0, 0.3, 0.8
DURATION = 1.6
PROGRAM = """
def guide():
  freedrive_mode()
  sleep(60)
end
"""


def pushed(program: str) -> tuple[list[float], list[float], list[float]]:
    """Return times (s), force of the hand (N), and rise of the tool (mm)."""
    controller = Controller("UR5e", "5.11", motion=Still())
    controller.step()
    start = controller.arm.sample.pose_target[2]
    controller.take(program)
    times, forces, ways = [], [], []
    for cycle in range(round(DURATION * controller.firmware.rate)):
        times.append(cycle / controller.firmware.rate)
        forces.append(PUSH if BEGINS <= times[-1] < ENDS else 0.0)
        controller.push([0.0, 0.0, forces[-1], 0.0, 0.0, 0.0])
        controller.step()
        ways.append(1e3 * (controller.arm.sample.pose_target[2] - start))
    return times, forces, ways


def draw(figure: Figure) -> str:
    """Plot the force of the hand, and the motion of the tool."""
    times, forces, ways = pushed(PROGRAM)
    held = pushed("def hold():\n  sleep(60)\nend\n")[2]
    hand, way = figure.subplots(2, 1, sharex=True, height_ratios=(1, 2))
    hand.plot(times, forces, color="#c05621")
    way.plot(times, ways, color="#2b6cb0", label="in freedrive")
    way.plot(times, held, color="0.5", linestyle="--", label="not in freedrive")
    hand.set_ylabel("push, N")
    way.set(ylabel="tool above its start, mm", xlabel="controller time, s")
    way.legend()
    return (
        f"A hand pushes a simulated UR5e up with {PUSH:g} N for {ENDS - BEGINS:g} s. In freedrive, the arm yields by "
        f"{max(ways):.0f} mm, and is at rest {settled(times, ways) - ENDS:.1f} s after the end of the push. Otherwise "
        "it holds its position."
    )


def settled(times: list[float], ways: list[float]) -> float:
    """Return the time, in s, after which the tool stays within 0.1 mm of its end position."""
    return next(time for time, way in zip(reversed(times), reversed(ways), strict=True) if abs(way - ways[-1]) > 0.1)
