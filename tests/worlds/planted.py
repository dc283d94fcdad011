"""Known defects, injected into a copy of the code one at a time, and the smallest world that shows each.

A defect is a list of changes to functions in `src`. Each is found by the name of its function and made in a copy of
`src` in a temporary folder. Worlds run with this copy through ``PYTHONPATH``. ``python -m tests.worlds --planted NAME``
searches for the first seed that fails, and makes its world smaller.
"""

from __future__ import annotations

import ast
import contextlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from .scenes import SCENES
from .world import World

__all__ = ["DEFECTS", "NAMES", "SHOWN", "Change", "apply", "planted", "worlds"]

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Change:
    """Change of one function.

    Attributes:
        module: Name of the module, as in an import.
        function: Qualified name of the function, as in ``Handle.cancel``.
        after: New text. The new body of the function if `before` is empty.
        before: Text of the function that is replaced. It must occur exactly once. Line breaks and indentation do not
            matter.
    """

    module: str
    function: str
    after: str
    before: str = ""

    @property
    def path(self) -> str:
        """File of the module, relative to the repository."""
        return f"src/{self.module.replace('.', '/')}.py"

    def applied(self, source: str) -> str:
        """Return the source of the module with this change.

        Raises:
            LookupError: If the function or the text no longer exists. The message names the entry to edit.
        """
        lines = source.splitlines(keepends=True)
        body = self._function(source).body
        # The docstring stays, so that the change shows the rest of the body only.
        first = body[1] if len(body) > 1 and ast.get_docstring(self._function(source)) is not None else body[0]
        begin, end = first.lineno - 1, body[-1].end_lineno
        found = "".join(lines[begin:end])
        indent = " " * first.col_offset
        if not self.before:
            changed = textwrap.indent(textwrap.dedent(self.after).strip("\n"), indent) + "\n"
        else:
            pattern = r"\s+".join(map(re.escape, self.before.split()))
            changed, count = re.subn(pattern, lambda match: self.after, found)
            if count != 1:
                raise LookupError(
                    f"{self.before!r} occurs {count} times in {self.function} of {self.path}; expected 1. "
                    "Edit DEFECTS in tests/worlds/planted.py"
                )
        changed = "".join(lines[:begin]) + changed + "".join(lines[end:])
        ast.parse(changed)
        return changed

    def _function(self, source: str) -> ast.FunctionDef | ast.AsyncFunctionDef:
        found: ast.AST = ast.parse(source)
        for name in self.function.split("."):
            named = [
                each
                for each in ast.iter_child_nodes(found)
                if isinstance(each, (ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and each.name == name
            ]
            if len(named) != 1:
                raise LookupError(
                    f"{self.path} has {len(named)} definitions of {self.function}; expected 1. "
                    "Edit DEFECTS in tests/worlds/planted.py"
                )
            found = named[0]
        assert isinstance(found, (ast.FunctionDef, ast.AsyncFunctionDef)), self.function
        return found


#: Changes that inject each defect.
DEFECTS: Mapping[str, Sequence[Change]] = {
    "cancel-brakes-not": [
        Change("linkcore.handle", "Handle.cancel", 'cancel("cancelled")', before='cancel("cancelled", brake=True)'),
    ],
    "cancelled-task-moves-the-arm": [
        Change("linkcore.handle", "Lifecycle.is_wanted", "return not self.is_over"),
        Change("linkcore.pending_call", "PendingCall.check", "return"),
        Change("linkcore.pending_call", "PendingCall.give_up", "self.is_given_up = True"),
    ],
    "first-message-of-two-threads": [
        Change(
            "urlink.command.interlock",
            "Interlock.has_reported_since",
            "return all(known.reported_at > since for known in list(self._sources.values()))",
        ),
        Change(
            "urlink.command.safety_monitor",
            "SafetyMonitor.listen",
            "elif False:",
            before="elif self._section.may_wait and not self._is(is_expected):",
        ),
    ],
    "interlock-forgets-the-stop": [
        Change(
            "urlink.command.safety_monitor",
            "SafetyMonitor.refusal_to_begin",
            """
            with self._section.lock:
                call = current_call()
                order = None if call is None else call.order
                return None if order is None else self.overtaken(order)
            """,
        ),
        Change("urlink.command.safety_monitor", "SafetyMonitor.refusal_to_stop", "return None"),
    ],
    "message-after-the-last": [
        Change(
            "urlink.motion.servo.linked_program",
            "LinkedProgram._transmit",
            "if False:",
            before="if (self.is_finishing or not self._life.is_wanted) and data != self._dialogue.farewell:",
        ),
    ],
    "motion-left-to-a-refused-script": [
        Change(
            "urlink.command.programs",
            "Programs.stop",
            "if run is None or run is not self._newest():",
            before="if run is None or run.wrapped.is_secondary:",
        ),
    ],
    "next-stop-forgets-the-program": [
        Change(
            "urlink.command.programs",
            "Programs._interlock_closed",
            """is_sent = self._given_up.phase is GivenUpPhase.STOPPING
            self._note(GivenUpEvent.MISS if is_sent else GivenUpEvent.END)""",
            before="self._note(GivenUpEvent.MISS)",
        ),
    ],
    "one-permission-for-all": [
        Change(
            "urlink.command.programs",
            "Programs._permission",
            "token = 1",
            before="token = 1 + next(self._start_tokens) % place.tokens",
        ),
    ],
    "refused-script-forgets-the-program": [
        Change(
            "urlink.command.programs",
            "Programs.start",
            """self._runs[run.name] = run
            if not wrapped.is_secondary:
                self._note(GivenUpEvent.END)""",
            before="self._runs[run.name] = run",
        ),
    ],
    "speed-outlives-its-program": [
        Change("urlink.motion.motions", "Motions._speed", "if False:", before="if duration > UNLED or is_watched:"),
    ],
    "stop-after-the-next": [
        Change(
            "urlink.command.programs",
            "Programs._send_stop",
            "if not is_wanted() and not wait:",
            before="if not is_wanted():",
        ),
    ],
    "two-connections-claim-the-same": [
        Change(
            "urlink.robot",
            "Robot.rtde",
            "self._rtde._made[None] = made",
            before="self._rtde.keep(made)",
        ),
    ],
    "up-before-its-ports": [
        Change("urlink.simulator.controller", "Controller.is_up", "return self._state.is_up"),
    ],
}
#: Names of the defects.
NAMES = tuple(sorted(DEFECTS))

#: Number of seeds with which a scene is tried, if it is not three. The seed decides which thread runs first.
_TRIES: Mapping[str, int] = {
    "cancelled-task-moves-the-arm": 20,
    "stop-after-the-next": 40,
    "two-connections-claim-the-same": 100,
    "message-after-the-last": 400,
}
#: Small world that shows each defect, and the number of seeds with which it is tried.
SHOWN: Mapping[str, tuple[World, int]] = {name: (SCENES[name], _TRIES.get(name, 3)) for name in NAMES}


@contextlib.contextmanager
def planted(name: str | None) -> Iterator[Path]:
    """Yield a folder with a copy of `src` that contains the defect, or an unchanged copy without a name.

    Raises:
        LookupError: If the code that the defect changes no longer exists.
    """
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        # Copy the compiled files, too, because otherwise each run would compile everything again.
        shutil.copytree(ROOT / "src", root / "src")
        if name is not None:
            apply(name, root)
        yield root


def apply(name: str, root: Path) -> None:
    """Inject a defect into the `src` of a folder.

    Raises:
        LookupError: If the code that the defect changes no longer exists.
    """
    for change in DEFECTS[name]:
        path = root / change.path
        path.write_text(change.applied(path.read_text(encoding="utf-8")), encoding="utf-8")


def worlds(root: Path, arguments: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """Run ``python -m tests.worlds`` with the code of a folder, and capture its output."""
    env = {**os.environ, "PYTHONPATH": str(root / "src")}
    return subprocess.run(
        [sys.executable, "-m", "tests.worlds", *arguments], cwd=ROOT, env=env, text=True, stdout=subprocess.PIPE
    )
