"""Dashboard commands of each generation and release, from the tables that `robot.dashboard` uses."""

from __future__ import annotations

from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from urlink.protocol.dashboard.commands import COMMANDS
from urlink.protocol.dashboard.robot_api import REQUESTS, find
from urlink.protocol.firmware import NEWEST, Firmware

SIZE = (7.0, 6.4)
#: Interface that answers a command.
NOTHING, DASHBOARD_SERVER, ROBOT_API = range(3)
COLOURS = ListedColormap(["#e2e8f0", "#2b6cb0", "#2f855a"])


def answered(command: str, firmware: Firmware) -> int:
    """Return the interface that answers the command with this firmware."""
    if not firmware.is_polyscope_x:
        since = COMMANDS[command].e
        return DASHBOARD_SERVER if since is not None and firmware >= since else NOTHING
    return NOTHING if find(command, firmware) is None else ROBOT_API


def draw(figure: Figure) -> str:
    """Plot a column for each release, a row for each Robot API command, and one for the others."""
    releases = [NEWEST, *(Firmware(10, minor) for minor in range(7, 15))]
    shared = [command for command in COMMANDS if command in REQUESTS]
    others = sum(command.e is not None for command in COMMANDS.values()) - len(shared)
    grid = [[answered(command, release) for release in releases] for command in shared]
    grid.append([NOTHING if release.is_polyscope_x else DASHBOARD_SERVER for release in releases])
    axes = figure.subplots()
    axes.pcolormesh(grid, cmap=COLOURS, vmin=NOTHING, vmax=ROBOT_API, edgecolors="white", linewidth=2.0)
    axes.invert_yaxis()
    axes.set_xticks([number + 0.5 for number in range(len(releases))], map(str, releases))
    axes.set_yticks([number + 0.5 for number in range(len(grid))], [*shared, f"{others} others"])
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    axes.spines[:].set_visible(False)
    kinds = ("nothing known", "the dashboard server, port 29999", "the Robot API, port 80")
    axes.legend(
        handles=[Patch(color=COLOURS(number), label=kind) for number, kind in enumerate(kinds)],
        loc="upper center",
        bbox_to_anchor=(0.4, 0.0),
        ncols=3,
    )
    return (
        f"Interface that answers each dashboard command, by firmware. The server of the e-Series answers "
        f"{len(shared) + others} commands. The Robot API has a request for {len(shared)} of them."
    )
