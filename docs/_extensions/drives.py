"""The directive `drive`: run an example, and show the figure that it draws.

    ```{drive} rhd_spiral
    A square spiral with a closing diagonal.
    ```

The examples run in lockstep, so the figure is the same each time. It is written to the folder of the built pages.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

_EXAMPLES = Path(__file__).parents[2] / "examples"


class DriveDirective(SphinxDirective):
    """The figure of a drive, and the output of the program."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Run the example, and show its figure."""
        program = _EXAMPLES / f"{self.arguments[0]}.py"
        self.env.note_dependency(str(program))
        folder = Path(self.env.app.outdir) / "_static"
        folder.mkdir(parents=True, exist_ok=True)
        picture = folder / f"{self.arguments[0]}.svg"
        done = subprocess.run(
            [sys.executable, str(program), str(picture)], capture_output=True, text=True, timeout=120, check=False
        )
        if done.returncode:
            raise self.error(f"{program.name} failed: {done.stderr}")
        caption = " ".join(self.content)
        # Not an image node, because Sphinx would search the file next to the sources.
        figure = (
            f'<figure class="align-center"><img src="_static/{picture.name}" alt="{caption}" width="400"/>'
            f"<figcaption>{caption}</figcaption></figure>"
        )
        printed = nodes.literal_block(done.stdout.rstrip(), done.stdout.rstrip(), language="text")
        return [nodes.raw("", figure, format="html"), printed]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("drive", DriveDirective)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
