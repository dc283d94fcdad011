"""What is imported when it is first needed: names of a package (PEP 562), and third-party packages of a part of it."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import Any

#: package -> its module with the names of other libraries. It has `own_name(name)`, which returns None or the own name.
foreign_names: dict[str, str] = {}


def lazy_names(
    package: str,
    homes: Mapping[str, str],
    modules: str = "",
    moved: Mapping[str, str] | None = None,
    foreign: str | None = None,
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """What makes the public names of a package, so that a program pays for the modules which it uses and no others.

    A package says the same to type checkers, and a test holds the two equal::

        if TYPE_CHECKING:
            from .robot import Robot as Robot
        else:
            __getattr__, __dir__, __all__ = lazy_names(__name__, {".robot": "Robot"})

    A name must not be that of a module of the package: importing the module would replace the name.

    Args:
        package: its `__name__`.
        homes: module -> its public names, separated by blanks. A module that begins with a dot is the package's own.
        modules: names of modules of the package, separated by blanks, that are found as `package.module` without being
            imported by name. They are not in `__all__`.
        moved: module -> names, separated by blanks, that were public here before and are that module's now. Asking for
            one raises an AttributeError that names the new place.
        foreign: the package's module with the names of other libraries; see `foreign_names`.

    Returns:
        The package's `__getattr__`, `__dir__` and `__all__`.
    """
    home = {name: module for module, names in homes.items() for name in names.split()}
    public = sorted(home)
    of_package = modules.split()
    elsewhere = {name: module for module, names in (moved or {}).items() for name in names.split()}

    if foreign is not None:
        foreign_names[package] = f"{package}{foreign}"

    def imported(module: str) -> Any:
        try:
            return import_module(module, package)
        except AttributeError as error:
            # Python takes that for a name which is not there, and `from package import name` does not show why.
            raise ImportError(f"{module} of {package} cannot be imported: {error}") from error

    def get(name: str) -> Any:
        if name in of_package:
            return imported(f".{name}")  # which makes it an attribute of the package
        if name in elsewhere:
            raise AttributeError(f"{package}.{name} is {elsewhere[name]}.{name}")
        if name not in home:
            from .text import similar  # a package is imported without it

            own = None if name.startswith("_") else foreign_hint(package, name)
            if own is not None:
                raise AttributeError(f"module {package!r} has no {name!r}; here it is: {own}")
            hint = "" if name.startswith("_") else similar(name, [*public, *of_package])
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")
        value = getattr(imported(home[name]), name)
        setattr(sys.modules[package], name, value)  # from now on it is found without asking here
        return value

    return get, lambda: sorted([*public, *of_package]), public


def foreign_hint(package: str, name: str) -> str | None:
    """What a name of another library is called in a package; None if no table has it.

    Args:
        package: "linkcore" looks in the tables of all packages.
        name: The name.
    """
    for owner, module in foreign_names.items():
        if package in (owner, "linkcore"):
            own: str | None = import_module(module).own_name(name)
            if own is not None:
                return own
    return None


@contextlib.contextmanager
def needs(extra: str, purpose: str) -> Iterator[None]:
    """Around the imports of what an extra of the distribution brings.

    Raises:
        LocalError: it is not installed; says what installs it.
    """
    try:
        yield
    except ImportError as error:
        package = error.name or extra
        from .errors import LocalError  # a package is imported without it

        raise LocalError(f"{purpose} needs {package}, which is not installed: pip install 'urlink[{extra}]'") from error
