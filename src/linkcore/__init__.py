"""Common base of urlink and rhdlink: streams, connections, recordings and handles.

Importing linkcore warns if another distribution with a package `urlink` is installed. Every package of this project
imports linkcore first. The project called urlink on PyPI shortens URLs. It also installs a package `urlink`, so only
one of the two packages can be imported: the package that was installed last, or the package that comes first on the
path. Python itself does not report this conflict.
"""

from __future__ import annotations

import os
import sys
import warnings

#: Distribution of linkcore, urlink, rhdlink and pytest_urlink.
NAME = "urlink-robot"

_OTHER = "urlink"
#: Suffixes of the folders that hold the metadata of a distribution.
_METADATA = (".dist-info", ".egg-info")


def _warn_of_other() -> None:
    """Warn if another installed distribution has a package `urlink`.

    This function lists the folders of the path instead of using `importlib.metadata`, because importing that module
    takes longer than importing urlink.
    """
    for folder in sys.path:
        try:
            entries = os.listdir(folder or ".")
        except OSError:
            continue  # not a folder: a zip file, or a path that does not exist
        for entry in entries:
            stem, suffix = os.path.splitext(entry)
            name, _, version = stem.partition("-")
            if name == _OTHER and suffix in _METADATA and _has_the_package(os.path.join(folder, entry)):
                _warn(version)
                return


def _has_the_package(metadata: str) -> bool:
    """Whether a distribution has a package `urlink`.

    The result is also True for a distribution that does not list its files, because it might have the package.
    """
    try:
        with open(os.path.join(metadata, "RECORD"), encoding="utf-8") as files:
            return any(line.startswith("urlink/__init__.py,") for line in files)
    except OSError:
        return True


def _warn(version: str) -> None:
    found = "the package of the other project" if _is_shadowed() else f"the package of {NAME}"
    warnings.warn(
        f"the distribution {_OTHER!r} {version} is installed; it is a different project from {NAME!r}. "
        f"Both have a package 'urlink', and 'import urlink' finds {found}. To use {NAME}, run: "
        f"pip uninstall -y {_OTHER} && pip install --force-reinstall --no-deps {NAME}",
        RuntimeWarning,
        stacklevel=3,  # the warning points to the line that imports linkcore
    )


def _is_shadowed() -> bool:
    """Whether `import urlink` finds the package of another project."""
    from importlib.util import find_spec

    try:
        spec = find_spec("urlink")
    except ValueError:
        return True  # the other package was imported, and has replaced its module by an object without a spec
    if spec is None or spec.origin is None:
        return True
    with open(spec.origin, encoding="utf-8", errors="replace") as file:
        return "linkcore" not in file.read()


_warn_of_other()
