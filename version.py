"""The version of this checkout: what its newest tag says. Read by hatchling as it builds; no package imports it.

======================================  =======================
at the tag ``v1.2.0``                   1.2.0
five commits after it                   1.2.1.dev5+g0123abc
a clone without tags                    0.1.0.dev300+g0123abc
an unpacked sdist                       what PKG-INFO says
anything else, such as a downloaded zip 0.1.0.dev0
======================================  =======================
"""

import re
import subprocess
from pathlib import Path

#: Of the release that has not been made yet.
FIRST = "0.1.0"

_ROOT = Path(__file__).resolve().parent


def version(root: Path = _ROOT) -> str:
    """The version of what is in a folder."""
    packed = root / "PKG-INFO"
    if packed.exists():
        found = re.search(r"^Version: (\S+)$", packed.read_text(encoding="utf-8"), re.MULTILINE)
        if found is not None:
            return found[1]
    # A checkout of its own: not one that this folder happens to lie in.
    if not (root / ".git").exists():
        return f"{FIRST}.dev0"
    try:
        return described(_git(root, "describe", "--tags", "--long", "--match", "v[0-9]*"))
    except (OSError, subprocess.CalledProcessError):
        pass  # no tag
    try:
        return f"{FIRST}.dev{_git(root, 'rev-list', '--count', 'HEAD')}+g{_git(root, 'rev-parse', '--short', 'HEAD')}"
    except (OSError, subprocess.CalledProcessError):
        return f"{FIRST}.dev0"  # no git, or no commit


def described(text: str) -> str:
    """The version from what ``git describe --long`` says: ``v1.2.0-5-g0123abc``."""
    tag, distance, commit = text.rsplit("-", 2)
    release = tag.removeprefix("v")
    if distance == "0":
        return release
    *first, last = release.split(".")
    return f"{'.'.join([*first, str(int(last) + 1)])}.dev{distance}+{commit}"


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=root, capture_output=True, text=True, check=True)
    return done.stdout.strip()
