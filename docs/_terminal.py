"""Shared code of the images of a terminal: colours, a console that records, and a file without fonts."""

from __future__ import annotations

import io
import re
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import TerminalTheme
from rich.text import Text

__all__ = ["IMAGES", "WIDTH", "recorder", "save", "session"]

IMAGES = Path(__file__).parent / "images"
#: Columns of a terminal that prints text. The monitor has its own width.
WIDTH = 104

_THEME = TerminalTheme(
    background=(22, 27, 34),
    foreground=(222, 228, 235),
    normal=[
        (36, 41, 47),
        (248, 81, 73),
        (63, 185, 80),
        (210, 153, 34),
        (88, 166, 255),
        (188, 140, 255),
        (57, 197, 207),
        (222, 228, 235),
    ],
    bright=[(125, 133, 144)] * 8,
)


def recorder(width: int = WIDTH) -> Console:
    """Return a console that records what it prints, and shows nothing."""
    return Console(record=True, width=width, file=io.StringIO(), force_terminal=True)


def session(command: str, output: str, width: int = WIDTH) -> Console:
    """Return a console with a command at a prompt, and the output of the command.

    A long line continues in the next one, as in a terminal.
    """
    console = recorder(width)
    console.print(Text.assemble(("$ ", "bright_black"), (command, "bold")))
    console.print(Text(output.rstrip("\n"), overflow="fold"))
    return console


def save(console: Console, path: Path, title: str) -> None:
    """Write the image of a console.

    Args:
        console: Console of `recorder` or `session`.
        path: File to write.
        title: Title of the window.
    """
    path.parent.mkdir(exist_ok=True)
    svg = console.export_svg(title=title, theme=_THEME, unique_id=path.stem)
    # An image in a document loads no fonts, and should not request any.
    path.write_text(re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL), encoding="utf-8")
