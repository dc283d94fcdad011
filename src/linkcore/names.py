"""Lazy imports of package members, and errors that suggest the right name for a misspelt attribute.

- `lazy_names` makes the public names of a package (PEP 562), and `needs` names the extra that installs a missing
  package.
- `plugin` loads a part from a separate distribution, such as a command or a recorder. If the distribution is missing,
  the error shows the command that installs it.
- `StrictAttributes` is a base class whose objects raise an error with a hint when a program reads or sets an attribute
  that they do not have. Without this class, setting a misspelt attribute would create a new attribute and have no
  effect.
"""

from __future__ import annotations

import contextlib
import functools
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, NoReturn, cast

from . import NAME

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

#: Package -> its module with the names of other libraries. The function `own_name(name)` of the module returns the
#: equivalent name in the package, or None.
_foreign_names: dict[str, str] = {}


def lazy_names(
    package: str,
    homes: Mapping[str, str],
    modules: str = "",
    foreign: str | None = None,
    packages: Mapping[str, str] | None = None,
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Make the public names of a package lazy, so that a program imports only the modules that it uses.

    The package declares the same names to type checkers, and a test checks that both are equal::

        if TYPE_CHECKING:
            from .robot import Robot as Robot
        else:
            __getattr__, __dir__, __all__ = lazy_names(__name__, {".robot": "Robot"})

    A public name must differ from the names of the modules of the package, because importing such a module would
    replace the name.

    Args:
        package: The `__name__` of the package.
        homes: Public names of each module, separated by blanks. A module that begins with a dot belongs to the
            package.
        modules: Modules of the package, separated by blanks, that are found under their last name without being
            imported: `package.poses` for "arm.poses". They are not in `__all__`.
        foreign: Module of the package with the names of other libraries; it has a function `own_name(name)`.
        packages: Subpackage -> the distribution that provides it, by an entry point of the group
            `<package>.packages`. It is imported as if it were in the package, and is not in `__all__`.

    Returns:
        The `__getattr__`, `__dir__` and `__all__` of the package.
    """
    home = {name: module for module, names in homes.items() for name in names.split()}
    public = sorted(home)
    of_package = {module.rpartition(".")[2]: f".{module}" for module in modules.split()}

    brought = {} if packages is None else packages

    if foreign is not None:
        _foreign_names[package] = f"{package}{foreign}"
    for name, distribution in brought.items():
        # Put the finder before those of Python, which would import the modules of such a package a second time.
        sys.meta_path.insert(0, _Brought(package, name, distribution))

    def imported(module: str) -> Any:
        try:
            return import_module(module, package)
        except AttributeError as error:
            # From this error Python would conclude that the name is missing, and `from package import name` would not
            # show the reason.
            raise ImportError(f"{module} of {package} cannot be imported: {error}") from error

    def get(name: str) -> Any:
        if name in brought:
            return import_module(f"{package}.{name}")
        if name not in home and name not in of_package:
            from .text import similar  # imported here: importing a package stays fast

            own = None if name.startswith("_") else foreign_hint(package, name)
            if own is not None:
                raise AttributeError(f"module {package!r} has no {name!r}; equivalent here: {own}")
            hint = "" if name.startswith("_") else similar(name, [*public, *of_package])
            raise AttributeError(f"module {package!r} has no attribute {name!r}{hint}")
        value = imported(of_package[name]) if name in of_package else getattr(imported(home[name]), name)
        setattr(sys.modules[package], name, value)  # later accesses do not call this function
        return value

    return get, lambda: sorted([*public, *of_package]), public


def foreign_hint(package: str, name: str) -> str | None:
    """Return the equivalent in a package for a name of another library.

    Return None if no table has the name.

    Args:
        package: Name of the package; "linkcore" searches the tables of all packages.
        name: Name in the other library.
    """
    for owner, module in _foreign_names.items():
        if package in (owner, "linkcore"):
            own: str | None = import_module(module).own_name(name)
            if own is not None:
                return own
    return None


@contextlib.contextmanager
def needs(extra: str, purpose: str, distribution: str = NAME) -> Iterator[None]:
    """Import optional packages in a block, with an error that shows how to install a missing one.

    Args:
        extra: Extra of the distribution that installs the packages; empty if the distribution itself requires them.
        purpose: Name of the part that needs the packages, used in the error.
        distribution: Name of the distribution.

    Raises:
        LocalError: If a package is not installed. The message has the command that installs it.
    """
    try:
        yield
    except ImportError as error:
        package = error.name or extra
        from .errors import LocalError  # imported here: importing a package stays fast

        install = f"'{distribution}[{extra}]'" if extra else distribution
        raise LocalError(f"{purpose} needs {package}, which is not installed: pip install {install}") from error


def plugins(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of all installed distributions in a group, by their names."""
    import importlib.metadata  # imported here: importing a package stays fast

    return {entry.name: entry for entry in importlib.metadata.entry_points(group=group)}


def plugin(group: str, name: str, distribution: str, purpose: str) -> Any:
    """Load a part that a separate distribution provides by an entry point.

    Args:
        group: Group of the entry point.
        name: Name of the entry point.
        distribution: Distribution that provides it, with its extra if one is needed: "urlink-view[foxglove]".
        purpose: Name of the part that needs it, used in the error.

    Raises:
        LocalError: If the distribution is not installed. The message has the command that installs it.
    """
    entry = plugins(group).get(name)
    if entry is None:
        from .errors import LocalError  # imported here: importing a package stays fast

        raise LocalError(missing_plugin(distribution, purpose))
    return entry.load()


def missing_plugin(distribution: str, purpose: str) -> str:
    """Return the error message for a distribution that is not installed."""
    install = f"'{distribution}'" if "[" in distribution else distribution
    return (
        f"{purpose} needs the package {distribution.partition('[')[0]}, which is not installed: pip install {install}"
    )


class _Brought:
    """Finder for a subpackage from another distribution.

    Each module of the subpackage is the same object under both names.

    Args:
        package: Package that the subpackage belongs to.
        name: Name of the subpackage.
        distribution: Distribution that provides the subpackage.
    """

    def __init__(self, package: str, name: str, distribution: str) -> None:
        self._group = f"{package}.packages"
        self._name = name
        self._prefix = f"{package}.{name}"
        self._distribution = distribution
        self._there = ""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Find a module. The import system of Python calls this.

        Raises:
            ModuleNotFoundError: If the distribution is not installed. The message has the command that installs it.
        """
        if name != self._prefix and not name.startswith(f"{self._prefix}."):
            return None
        entry = plugins(self._group).get(self._name)
        if entry is None:
            raise ModuleNotFoundError(missing_plugin(self._distribution, f"import {name}"), name=name)
        from importlib.util import find_spec  # imported here: importing a package stays fast

        self._there = entry.value
        return None if find_spec(self._elsewhere(name)) is None else ModuleSpec(name, self)  # type: ignore[arg-type]

    def _elsewhere(self, name: str) -> str:
        return self._there + name.removeprefix(self._prefix)

    def create_module(self, spec: ModuleSpec) -> None:
        """Return None, so that the import system makes an empty module, which `exec_module` replaces."""

    def exec_module(self, module: ModuleType) -> None:
        """Import the module under its other name.

        The import system then uses the entry in `sys.modules`.
        """
        sys.modules[module.__name__] = import_module(self._elsewhere(module.__name__))


#: Name of an argument in this library -> names of the same argument in other libraries.
_KEYWORDS = {
    "speed": "v vel velocity max_vel max_velocity",
    "acceleration": "a acc accel max_acc max_acceleration",
    "time": "t duration",
    "blend": "r radius blend_radius",
    "wait": "asynchronous async_ is_async blocking block",
}
_OWN_KEYWORDS = {name: own for own, names in _KEYWORDS.items() for name in names.split()}

#: A method with one of these arguments moves something; if it is called with an argument name of another library, the
#: error suggests the right name.
_OF_MOVES = frozenset({"speed", "acceleration", "wait"})


class StrictAttributes:
    """Base class for objects whose attributes are checked: programs can only read and set attributes that exist.

    Code in the packages of its classes can add attributes. Any other code can set existing attributes, and can replace
    a method by another function, as tests do. Names that begin with an underscore are not checked when they are set.

    If a method has an argument `speed`, `acceleration` or `wait`, its error for an unknown argument has a hint.
    """

    __slots__ = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, method in list(vars(cls).items()):
            if isinstance(method, FunctionType) and (name == "__init__" or name[0] != "_") and _moves(method):
                setattr(cls, name, _explaining_arguments(method))

    def _hint(self, name: str) -> str | None:
        """Return a hint for the end of the error about a missing public name; None for the usual hints."""
        return None

    if not TYPE_CHECKING:  # type checkers would conclude that the object has every attribute

        def __getattr__(self, name: str) -> object:
            raise unknown_attribute(self, name)

        def __setattr__(self, name: str, value: object) -> None:
            if name[:1] != "_" and not _is_settable(self, name, value, sys._getframe(1).f_globals.get("__name__")):
                raise unknown_attribute(self, name, is_set=True)
            object.__setattr__(self, name, value)


class Elsewhere:
    """Placeholder for an attribute that a class does not have.

    The error for its use names the equivalent attribute. `dir` omits the placeholder.

    It is used for classes of packets, which have no `__getattr__`, because that would slow down each access to a field.

    Args:
        name: Name of the missing attribute.
        own: Equivalent name in this library.
    """

    def __init__(self, name: str, own: str) -> None:
        self._name = name
        self.own = own

    def __get__(self, held: object, kind: type) -> NoReturn:
        message = f"{kind.__name__} has no {self._name!r}; equivalent here: {self.own}"
        raise AttributeError(message, name=self._name, obj=None)


def unknown_attribute(held: StrictAttributes, name: str, *, is_set: bool = False) -> AttributeError:
    """Return the error for a name that an object does not have, or that cannot be set."""
    kind = type(held)
    what, hint = f"attribute {name!r}", "" if name.startswith("_") else None
    if is_set and hasattr(kind, name):
        what += " that can be set"
        instead = f"; {name}() is a method" if _is_method(kind, name) else ""
        hint = f"; use set_{name}()" if hasattr(kind, f"set_{name}") else instead
    if hint is None:
        hint = held._hint(name)
    if hint is None:
        own = foreign_hint(kind.__module__.partition(".")[0], name)
        if own is not None:
            what, hint = repr(name), f"; equivalent here: {own}"
    if hint is None:
        from .text import similar  # imported here: importing the library stays fast

        hint = similar(name, (each for each in dir(held) if each[0] != "_" and each != name))
    # `obj` is None because Python would otherwise add its own suggestion to a traceback.
    return AttributeError(f"{kind.__name__} has no {what}{hint}", name=name, obj=None)


def _is_method(kind: type, name: str) -> bool:
    return callable(getattr(kind, name))


@functools.cache
def _packages(kind: Hashable) -> frozenset[str]:
    """Return the top packages of the class of an object and of its base classes."""
    return frozenset(each.__module__.partition(".")[0] for each in cast("type", kind).__mro__)


def _is_settable(held: object, name: str, value: object, module: str | None) -> bool:
    """Whether code of a module may set the attribute `name` to `value`."""
    kind = type(held)
    if module is not None and module.partition(".")[0] in _packages(cast("Hashable", kind)):
        return True
    found = next((vars(each)[name] for each in kind.__mro__ if name in vars(each)), None)
    if isinstance(found, property):
        return found.fset is not None
    if found is not None:
        return callable(value) or not _is_method(kind, name)
    return bool(kind.__dictoffset__) and name in vars(held)


# -- arguments -------------------------------------------------------------------------------------


def _arguments(method: Callable[..., Any]) -> list[str]:
    """Return the names of the arguments of a method, without `self`."""
    while hasattr(method, "__wrapped__"):
        method = method.__wrapped__
    code = method.__code__
    return list(code.co_varnames[1 : code.co_argcount + code.co_kwonlyargcount])


def _moves(method: FunctionType) -> bool:
    # A coroutine calls the method that moves the robot later, and that method raises the error.
    is_coroutine = method.__code__.co_flags & 0x80
    return not is_coroutine and not _OF_MOVES.isdisjoint(_arguments(method))


def _explaining_arguments(method: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a method so that its error for an unknown argument has a hint."""

    @functools.wraps(method)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            return method(*args, **kwargs)
        except TypeError:
            known = _arguments(method)
            unknown = next((name for name in kwargs if name not in known), None)
            if unknown is None:
                raise
            hint = _argument_hint(unknown, known)
        raise TypeError(f"{method.__qualname__.removesuffix('.__init__')}() has no argument {unknown!r}{hint}")

    return call


def _argument_hint(unknown: str, known: list[str]) -> str:
    from .text import similar

    own = _OWN_KEYWORDS.get(unknown)
    if own in known:
        how = " (wait=True returns when the motion has ended, wait=False at once)" if own == "wait" else ""
        return f"; use {own!r}{how}"
    return similar(unknown, known) or f"; its arguments are {', '.join(known)}"
