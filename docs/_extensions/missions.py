"""The directives of the pages on missions: run a mission, and show the differences between the profiles.

    ```{mission} arc.smr --turtle
    :profiles: sound mrc
    An arc that ends.
    ```

    ```{mission-differences}
    ```

    ```{mission-bounds}
    ```

A script of `examples/missions` is run with the shown command, once for each profile, and the figures are shown side by
side. The simulated robot is the same each time, so the figures are too. The tables are from `rhdlink.smrcl.profile`.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from rhdlink.smrcl.profile import BOTH, differences

_ROOT = Path(__file__).parents[2]


class MissionDirective(SphinxDirective):
    """The figures of a mission, and the command that draws them."""

    required_arguments = 1
    final_argument_whitespace = True
    option_spec = {"profiles": directives.unchanged}  # noqa: RUF012
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Run the command once for each profile."""
        name, *options = shlex.split(self.arguments[0])
        script = Path("examples") / "missions" / name
        self.env.note_dependency(str(_ROOT / script))
        words = ["mission", str(script), *options]
        folder = Path(self.env.app.outdir) / "_static"
        folder.mkdir(parents=True, exist_ok=True)
        caption = " ".join(self.content)
        images, ends = [], []
        profiles = self.options.get("profiles", "sound").split()
        for profile in profiles:
            picture = f"{Path(name).stem}-{profile}{'-smr' if 'smr' in options else ''}.svg"
            end = self._draw([*words, "--profile", profile, "--svg", str(folder / picture)])
            ends.append(f"{profile}: {end}")
            images.append(f'<img src="_static/{picture}" alt="{profile}" width="{680 // max(len(profiles), 2)}"/>')
        # Not an image node, because Sphinx would search the file next to the sources.
        figure = f'<figure class="align-center">{"".join(images)}<figcaption>{caption}</figcaption></figure>'
        told = f"$ {shlex.join(['rhdlink', *words, '--svg', 'way.svg'])}\n" + "\n".join(ends)
        return [nodes.raw("", figure, format="html"), nodes.literal_block(told, told, language="text")]

    def _draw(self, words: list[str]) -> str:
        """Run the command, and return its last message: the position of the robot at the end."""
        done = subprocess.run(
            [sys.executable, "-m", "rhdlink.cli", *words],
            cwd=_ROOT,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        if done.returncode:
            raise self.error(f"{shlex.join(words)} failed: {done.stderr}")
        return done.stderr.splitlines()[-1].removeprefix("rhdlink: ")


class DifferencesDirective(SphinxDirective):
    """Table of the differences between the profiles."""

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each difference."""
        rows = [(f"`{each.name}`", each.mrc, each.sound) for each in differences()]
        return _table(self, ("field", '`"mrc"`: what the original does', '`"sound"`'), rows)


class BoundsDirective(SphinxDirective):
    """Table of the points in which both profiles differ from the original."""

    def run(self) -> list[nodes.Node]:
        """Return a table with one row for each point."""
        return _table(self, ("the original", "here, under both profiles"), BOTH)


def _table(directive: SphinxDirective, head: tuple[str, ...], rows: Any) -> list[nodes.Node]:
    """Return a table whose cells contain Markdown."""
    lines = [head, tuple("---" for _ in head), *rows]
    text = ["| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines]
    return directive.parse_text_to_nodes("\n".join(text))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives."""
    app.add_directive("mission", MissionDirective)
    app.add_directive("mission-differences", DifferencesDirective)
    app.add_directive("mission-bounds", BoundsDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
