"""Draw the diagrams of docs/images: data-path, way-out, interlock, start-permission and reverse-link.

The same code gives the same bytes.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from _drawing import COLOURS, drawing

FOLDER = Path(__file__).parent / "images"
BLUE, ORANGE, GREEN, RED = COLOURS[:4]

STYLE = f"""
.box {{ fill: var(--paper); stroke: var(--faint); stroke-width: 1.2; }}
.ours {{ fill: var(--paper); stroke: {BLUE}; stroke-width: 1.6; }}
.yours {{ fill: var(--paper); stroke: {GREEN}; stroke-width: 1.6; }}
.robot {{ fill: var(--paper); stroke: {ORANGE}; stroke-width: 1.6; }}
.shut {{ fill: var(--paper); stroke: {RED}; stroke-width: 1.6; }}
.lane {{ fill: var(--panel); stroke: var(--line); stroke-width: 1; }}
.name {{ font-weight: 600; text-anchor: middle; }}
.note {{ font-size: 11.5px; fill: var(--faint); text-anchor: middle; }}
.label {{ font-size: 11.5px; fill: var(--faint); }}
.way {{ stroke: var(--faint); stroke-width: 1.6; }}
.blocked {{ stroke: {RED}; stroke-width: 1.6; }}
.head {{ fill: var(--faint); }}
"""

#: Style of text that hides the lines below it.
_HALO = "paint-order: stroke; stroke: var(--paper); stroke-width: 4px; stroke-linejoin: round;"
#: Style of sequences, in addition to `STYLE`.
SEQUENCE = f"""{STYLE.strip()}
.life {{ stroke: var(--faint); stroke-width: 1; stroke-dasharray: 1.5 4; }}
.frame {{ fill: none; stroke: {BLUE}; stroke-width: 1; stroke-dasharray: 6 4; }}
.said {{ font-size: 12px; {_HALO} }}
.when {{ font-size: 12px; font-weight: 600; {_HALO} }}
"""

#: Positions of the four lifelines of a sequence.
YOU, OURS, CONTROLLER, PROGRAM = 80.0, 295.0, 515.0, 715.0


def box(kind: str, x: float, y: float, width: float, height: float, name: str, *notes: str) -> list[str]:
    """Draw a box with its name, and further lines below it."""
    drawn = [f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6"/>']
    middle, first = x + width / 2, y + height / 2 + 5 - 7.5 * len(notes)
    drawn.append(f'<text class="name" x="{middle:g}" y="{first:g}">{name}</text>')
    for number, note in enumerate(notes, 1):
        drawn.append(f'<text class="note" x="{middle:g}" y="{first + 15.5 * number:g}">{note}</text>')
    return drawn


def lane(x: float, y: float, width: float, height: float, name: str) -> list[str]:
    """Draw a region that contains boxes, with its name at the bottom left."""
    return [
        f'<rect class="lane" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="8"/>',
        *label(x + 10, y + height - 9, name),
    ]


def arrow(*points: tuple[float, float], kind: str = "way") -> list[str]:
    """Draw a line through points, with a head at the last point."""
    (bx, by), (x, y) = points[-2:]
    length = ((x - bx) ** 2 + (y - by) ** 2) ** 0.5
    dx, dy = (x - bx) / length, (y - by) / length
    path = "M" + " L".join(f"{px:g},{py:g}" for px, py in (*points[:-1], (x - 6 * dx, y - 6 * dy)))
    head = [(x, y), (x - 8 * dx - 4 * dy, y - 8 * dy + 4 * dx), (x - 8 * dx + 4 * dy, y - 8 * dy - 4 * dx)]
    corners = " ".join(f"{px:.1f},{py:.1f}" for px, py in head)
    return [f'<path class="{kind}" d="{path}"/>', f'<polygon class="head" points="{corners}"/>']


def label(x: float, y: float, text: str, anchor: str = "start") -> list[str]:
    """Draw a few words next to a line."""
    return [f'<text class="label" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{text}</text>']


def lifelines(height: float) -> list[str]:
    """Draw the four participants of a sequence, and their lines down to `height`."""
    heads = (
        ("yours", YOU, "your program", "on your computer"),
        ("ours", OURS, "urlink", "the library"),
        ("robot", CONTROLLER, "controller", "of the robot"),
        ("robot", PROGRAM, "robot program", "on the controller"),
    )
    drawn = []
    for kind, x, name, note in heads:
        drawn.append(f'<path class="life" d="M{x:g},56 L{x:g},{height:g}"/>')
        drawn += box(kind, x - 68, 8, 136, 48, name, note)
    return drawn


def message(y: float, begin: float, end: float, text: str) -> list[str]:
    """Draw a message from one participant to another, with its text above the arrow."""
    middle = (begin + end) / 2
    return [*_said(middle, y - 6, text, "middle"), *arrow((begin, y), (end, y))]


def step(y: float, x: float, *texts: str, is_left: bool = False) -> list[str]:
    """Draw an action of one participant, next to its line."""
    drawn = [f'<circle class="head" cx="{x:g}" cy="{y - 4:g}" r="3.5"/>']
    for number, text in enumerate(texts):
        drawn += _said(x - 9 if is_left else x + 9, y + 15 * number, text, "end" if is_left else "start")
    return drawn


def frame(y: float, height: float, text: str) -> list[str]:
    """Draw a region across all lines, with its condition at the top left."""
    return [
        f'<rect class="frame" x="6" y="{y:g}" width="788" height="{height:g}" rx="6"/>',
        f'<text class="when" x="14" y="{y + 17:g}">{text}</text>',
    ]


def _said(x: float, y: float, text: str, anchor: str) -> list[str]:
    return [f'<text class="said" x="{x:g}" y="{y:g}" text-anchor="{anchor}">{text}</text>']


def data_path() -> str:
    """Draw the path from the robot's bytes to callbacks, and the threads on it."""
    body = [
        *lane(118, 108, 446, 110, "the reader thread"),
        *box("robot", 8, 128, 84, 60, "robot", "TCP"),
        *box("ours", 134, 128, 94, 60, "transport", "bytes, stamp"),
        *box("ours", 246, 128, 92, 60, "framer", "frames"),
        *box("ours", 356, 128, 92, 60, "decoder", "typed states"),
        *box("ours", 466, 128, 84, 60, "fan-out", "newest"),
        *arrow((92, 158), (134, 158)),
        *arrow((228, 158), (246, 158)),
        *arrow((338, 158), (356, 158)),
        *arrow((448, 158), (466, 158)),
        # the recorder receives the unchanged bytes
        *arrow((181, 128), (181, 44), (246, 44)),
        *label(189, 84, "unchanged bytes"),
        *box("ours", 246, 18, 92, 52, "queue", "1024 pieces"),
        *arrow((338, 44), (356, 44)),
        *box("ours", 356, 18, 92, 52, "recorder", "own thread"),
        *arrow((448, 44), (466, 44)),
        *box("box", 466, 18, 84, 52, "file"),
        # consumers
        *arrow((508, 128), (508, 84), (620, 84), (620, 62)),
        *box("ours", 574, 10, 92, 52, "queue", "policy"),
        *arrow((666, 36), (684, 36)),
        *box("yours", 684, 10, 108, 52, "callback", "its own thread"),
        *arrow((550, 158), (574, 158)),
        *box("ours", 574, 132, 92, 52, "queue", "policy"),
        *arrow((666, 158), (684, 158)),
        *box("yours", 684, 132, 108, 52, "for, wait", "your thread"),
        *arrow((508, 188), (508, 250), (684, 250)),
        *box("yours", 684, 224, 108, 52, "callback", "reader thread"),
        *label(520, 243, "inline=True"),
    ]
    title = (
        "The data path: robot, transport, framer, decoder and fan-out in the reader thread; then queues and callbacks"
    )
    return drawing("data-path", 800, 286, title, STYLE, body)


def way_out() -> str:
    """Draw the path from a call to the robot, through the interlock, and the way back."""
    body = [
        *lane(228, 16, 248, 166, "the critical section"),
        *box("yours", 8, 60, 150, 76, "your call", "motion, script, io", "arguments are checked"),
        *arrow((158, 98), (244, 98)),
        *label(201, 90, "text", "middle"),
        *box("ours", 244, 62, 100, 72, "command", "channel"),
        *arrow((344, 88), (374, 88)),
        *arrow((374, 108), (344, 108)),
        *box("shut", 374, 48, 90, 100, "interlock", "open or", "closed,", "and why"),
        *arrow((294, 62), (294, 44), (575, 44), (575, 72)),
        *label(484, 37, "only while it is open"),
        *box("ours", 500, 72, 150, 80, "connection", "programs: primary", "set-points: reverse, RTDE"),
        *arrow((650, 112), (690, 112)),
        *box("robot", 690, 70, 100, 84, "robot", "runs the", "program"),
        *arrow((740, 154), (740, 254), (640, 254)),
        *box("ours", 490, 226, 150, 56, "streams", "primary, real-time"),
        *arrow((490, 254), (419, 254), (419, 148)),
        *label(428, 204, "stops, modes, silence"),
        *arrow((490, 270), (330, 270)),
        *box("ours", 180, 236, 150, 56, "programs", "phase of each"),
        *arrow((180, 264), (83, 264), (83, 136)),
        *label(92, 206, "handle: done, cancelled,"),
        *label(92, 221, "failed, and why"),
    ]
    title = (
        "The command path: your call, the command channel that asks the interlock, the robot, and the replies of its "
        "streams"
    )
    return drawing("way-out", 800, 300, title, STYLE, body)


def interlock() -> str:
    """Draw the states of the interlock, and its transitions."""
    body = [
        *box(
            "shut",
            30,
            96,
            190,
            92,
            "closed",
            "a source reports a stop,",
            "is silent, or has no data yet;",
            "every motion is refused",
        ),
        *box(
            "box",
            306,
            10,
            190,
            92,
            "clear, not enabled",
            "only under the policies",
            "on_startup and always;",
            "NotEnabled",
        ),
        *box("yours", 580, 96, 190, 92, "open", "motions start,", "set-points are sent"),
        *arrow((160, 96), (230, 56), (306, 56)),
        *label(150, 44, "all sources clear"),
        *arrow((496, 56), (590, 56), (650, 96)),
        *label(560, 44, "safety.enable()"),
        *arrow((220, 142), (580, 142)),
        *label(400, 134, "all sources clear", "middle"),
        *label(400, 158, "policy never, or on_startup and enabled before", "middle"),
        *arrow((675, 188), (675, 236), (125, 236), (125, 188), kind="blocked"),
        *label(
            400, 229, "any source: a stop, a mode other than running, a second of silence, a lost connection", "middle"
        ),
        *label(400, 256, "a motion ends at once with SafetyStop or NotRunning, and never resumes on its own", "middle"),
    ]
    title = "The interlock: any source closes it; when all sources are clear, the policy decides whether it opens"
    return drawing("interlock", 800, 266, title, STYLE, body)


def start_permission() -> str:
    """Draw how a motion that is one program asks before it moves the arm."""
    body = [
        *lifelines(540),
        *message(88, YOU, OURS, "move_joints(q)"),
        *step(112, OURS, "asks the interlock"),
        *message(138, OURS, CONTROLLER, "program text, with its token"),
        *message(164, OURS, YOU, "handle, in phase SENT"),
        *message(188, CONTROLLER, PROGRAM, "starts it"),
        *step(214, PROGRAM, "clears the register, and waits", is_left=True),
        *message(242, PROGRAM, OURS, "textmsg: started"),
        *step(268, OURS, "Is the motion still wanted?", "Is the interlock still open?"),
        *frame(294, 166, "if both are true"),
        *message(324, OURS, CONTROLLER, "sec that writes the token"),
        *message(350, CONTROLLER, PROGRAM, "token in the register"),
        *step(376, PROGRAM, "moves the arm", is_left=True),
        *message(402, PROGRAM, OURS, "textmsg: finished"),
        *message(426, CONTROLLER, OURS, "reports that it has ended"),
        *message(450, OURS, YOU, "handle, in phase DONE"),
        *frame(470, 64, "otherwise"),
        *step(497, OURS, "writes no token; the handle ends with an error"),
        *step(522, PROGRAM, "ends after start_timeout (5 s), and has not moved the arm", is_left=True),
    ]
    title = (
        "The start permission: the program reports that it has started, and moves the arm only after urlink has "
        "written its token"
    )
    return drawing("start-permission", 800, 546, title, SEQUENCE, body)


def reverse_link() -> str:
    """Draw how a motion over the reverse link starts, continues and ends."""
    body = [
        *lifelines(620),
        *message(88, YOU, OURS, "follow(trajectory)"),
        *step(112, OURS, "asks the interlock, opens a port"),
        *message(138, OURS, CONTROLLER, "program with port and token"),
        *message(164, OURS, YOU, "handle, in phase SENT"),
        *message(188, CONTROLLER, PROGRAM, "starts it"),
        *message(214, PROGRAM, OURS, "connects to the port, and sends the token"),
        *step(240, OURS, "accepts no other connection"),
        *frame(256, 134, "for each cycle of the controller"),
        *message(290, CONTROLLER, OURS, "real-time state of cycle n"),
        *step(314, OURS, "asks the interlock"),
        *message(342, OURS, PROGRAM, "set-point for cycle n + 2, dated n"),
        *step(368, PROGRAM, "discards it if it is too old; otherwise calls servoj", is_left=True),
        *frame(400, 136, "at the end of the trajectory"),
        *message(428, OURS, PROGRAM, "STOP"),
        *step(452, PROGRAM, "brakes, and ends", is_left=True),
        *message(478, PROGRAM, OURS, "textmsg: finished"),
        *message(502, CONTROLLER, OURS, "reports that it has ended"),
        *message(526, OURS, YOU, "handle, in phase DONE"),
        *frame(546, 68, "if no message arrives for 0.1 s (watchdog)"),
        *step(580, PROGRAM, "brakes and ends; textmsg: nothing to go to", is_left=True),
        *message(604, OURS, YOU, "handle fails: ConnectionLost"),
    ]
    title = (
        "A motion over the reverse link: the program connects back, follows a set-point for each cycle, and brakes on "
        "its own if no set-point arrives"
    )
    return drawing("reverse-link", 800, 626, title, SEQUENCE, body)


DIAGRAMS = {
    "data-path": data_path,
    "way-out": way_out,
    "interlock": interlock,
    "start-permission": start_permission,
    "reverse-link": reverse_link,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw all diagrams."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=FOLDER)
    folder = parser.parse_args(arguments).folder
    for name, draw in DIAGRAMS.items():
        (folder / f"{name}.svg").write_text(draw(), encoding="utf-8")


if __name__ == "__main__":
    main()
