"""What surrounds every command: parsing, logging, errors, ends from outside and the exit status."""

from __future__ import annotations

import argparse
import contextlib
import io
import logging
import os
import signal
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from types import FrameType, TracebackType
from typing import Any, Protocol

from ..errors import LinkError
from ..text import printable, similar
from .options import Subparsers

__all__ = ["CommandModule", "Interrupted", "Interruption", "program"]


class Interrupted(KeyboardInterrupt):
    """Raised by a signal that ends the program.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def raise_on_sigterm() -> contextlib.AbstractContextManager[object]:
    """A context in which SIGTERM unwinds the program as Ctrl-C does."""

    def handler(number: int, frame: FrameType | None) -> None:
        raise Interrupted(number)

    return _Handlers({signal.SIGTERM: handler})


class Interruption:
    """A context in which Ctrl-C and SIGTERM are only noted, so that no call is interrupted; a second one raises.

    Attributes:
        number: the signal that came, or None.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._handlers = _Handlers({signal.SIGINT: self._note, signal.SIGTERM: self._note})

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.number is not None:
            raise Interrupted(number)  # the second signal: end at once, without cleaning up
        self.number = number

    def wait(self, seconds: float) -> bool:
        """Sleep until a signal comes, at most `seconds`; returns whether one has come."""
        until = time.monotonic() + seconds
        while self.number is None:
            left = until - time.monotonic()
            if left <= 0:
                return False
            # A signal that is only noted does not end a sleep, so it sleeps in short steps.
            time.sleep(min(left, 0.05))
        return True

    def raise_if_any(self) -> None:
        """End the program as the signal would have ended it.

        Raises:
            Interrupted: a signal has come.
        """
        if self.number is not None:
            raise Interrupted(self.number)

    def __enter__(self) -> Interruption:
        self._handlers.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._handlers.__exit__(kind, error, trace)


class _Handlers:
    def __init__(self, wanted: dict[signal.Signals, Any]) -> None:
        self._wanted = wanted
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> None:
        # Only the main thread may set handlers; elsewhere the surrounding program handles signals.
        with contextlib.suppress(ValueError):
            for number, handler in self._wanted.items():
                self._before[number] = signal.signal(number, handler)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


#: The distribution of all packages.
_DISTRIBUTION = "urlink"


class CommandModule(Protocol):
    """A module with a subcommand; `run` gets the parsed arguments and returns the exit status."""

    def add_parser(self, subparsers: Subparsers) -> None:
        """Declare the command."""


def program(
    name: str, commands: Mapping[str, str], description: str, epilog: str, argv: Sequence[str] | None = None
) -> int:
    """Run the command line of the package `name`; returns the exit status and never raises.

    Args:
        name: of the package, and of the program.
        commands: each command -> the module in the package's `cli` that declares it, in the order of the help. Only the
            module of the given command is imported: importing all of them takes longer than most commands.
        description, epilog: of the help.
        argv: the arguments; those of the process by default.
    """
    argv = sys.argv[1:] if argv is None else argv
    parser = argparse.ArgumentParser(
        prog=name,
        description=description,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and end")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    asked = next((word for word in argv if not word.startswith("-")), "")

    def declare(modules: Iterable[str]) -> argparse.ArgumentParser:
        for module in modules:
            command: CommandModule = import_module(module if "." in module else f"{name}.cli.{module}")
            command.add_parser(subparsers)
        return parser

    everything = dict.fromkeys(commands.values())
    declare((commands[asked],) if asked in commands else everything)
    parser.set_defaults(all_commands=lambda: declare(each for each in everything if each != commands[asked]))
    try:
        if asked and asked not in commands and argv[0] == asked:
            parser.error(f"no command {asked!r}{similar(asked, commands) or ';'} there are {', '.join(commands)}")
        args, extra = parser.parse_known_args(argv)
        # argparse does not assign positional arguments of variable number that come after an option.
        trailing = getattr(args, "trailing", None)
        if extra and trailing is not None and not any(each.startswith("-") for each in extra):
            getattr(args, trailing).extend(extra)
        elif extra:
            hint = similar(extra[0].partition("=")[0], args.options())
            args.usage_error(f"unrecognized arguments: {' '.join(extra)}{hint}")
    except SystemExit as exit_:  # argparse has printed the error, or the help
        return int(exit_.code or 0)
    for stream in (sys.stdout, sys.stderr):
        # Text from the wire must not fail on a terminal that is not UTF-8, so what it lacks is escaped.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with raise_on_sigterm(), _logging(name, args.verbose):
            status: int = args.run(args)
            sys.stdout.flush()
            return status
    except SystemExit as exit_:
        return int(exit_.code or 0)
    except Interrupted as signal_:
        return 128 + signal_.number
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of the pipe has closed it, as `head` does. What is left in the buffer would fail again at exit.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except LinkError as error:
        print(f"{name}: {printable(str(error))}", file=sys.stderr)
        return 1


class _Version(argparse.Action):
    """Finds the version only when it is printed: that imports more than most commands need."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        import importlib.metadata

        try:
            version = importlib.metadata.version(_DISTRIBUTION)
        except importlib.metadata.PackageNotFoundError:
            version = "(not installed)"
        print(parser.prog, version)
        parser.exit()


class _SafeFormatter(logging.Formatter):
    """Log lines quote text from the wire, so control characters in them are escaped."""

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return "\n".join(map(printable, text.split("\n")))


class _Stderr(logging.Handler):
    """Writes to `sys.stderr` as it is at the time: a live view replaces it, to print lines above its picture."""

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(BrokenPipeError):
            print(self.format(record), file=sys.stderr)


@contextlib.contextmanager
def _logging(name: str, verbose: int) -> Iterator[None]:
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    handler = _Stderr()
    handler.setFormatter(_SafeFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    loggers = [logging.getLogger(each) for each in ("linkcore", name)]
    before = [(logger.level, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(level)
        logger.propagate = False
    try:
        yield
    finally:
        for logger, (old_level, old_propagate) in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(old_level)
            logger.propagate = old_propagate
