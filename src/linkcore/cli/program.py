"""Program with several commands: parsing of the command line, logging, error messages and exit status."""

from __future__ import annotations

import argparse
import contextlib
import functools
import io
import itertools
import logging
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from typing import NamedTuple

from .. import NAME
from ..errors import LinkError
from ..names import missing_plugin, plugins
from ..text import printable, similar
from .options import Subcommand, common_options
from .terminal import Interrupted, raise_on_sigterm

#: Pattern of the options that every command has.
_COMMON = re.compile("-[qv]+|--quiet|--verbose")


#: End of the help of every program.
_END_OF_HELP = """\
exit status:
  0 success, 1 error of the robot, the file or the address (one line on stderr), 2 wrong usage,
  130 ended by Ctrl-C, 143 ended by SIGTERM

`{name} COMMAND --help` explains each command, with examples."""


class Plugin(NamedTuple):
    """Command from a separate distribution.

    Attributes:
        distribution: Distribution that provides the command, with its extra if one is needed.
        summary: Line in the help of the program while the distribution is not installed.
    """

    distribution: str
    summary: str


def program(
    name: str, commands: Mapping[str, str | Plugin], description: str, epilog: str, argv: Sequence[str] | None = None
) -> int:
    """Run the command line of the package `name`; return the exit status, and never raise.

    Args:
        name: Name of the package and of the program.
        commands: Command -> its module in the `cli` folder of the package, in the order of the help. Only the module of
            the given command is imported, because importing all modules takes longer than most commands. The module of
            a `Plugin` is found by an entry point of the group `<name>.commands`. Other distributions may add further
            commands to this group.
        description: Description in the help.
        epilog: Text at the end of the help, before the exit status.
        argv: Arguments; by default the arguments of the process.
    """
    argv = sys.argv[1:] if argv is None else argv
    parser = argparse.ArgumentParser(
        prog=name,
        description=description,
        epilog=f"{epilog}\n\n{_END_OF_HELP.format(name=name)}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    common_options(parser)
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    # A subparser overwrites the values of the main parser, so the common options are moved behind the command.
    leading = list(itertools.takewhile(_COMMON.fullmatch, argv))
    if 0 < len(leading) < len(argv) and not argv[len(leading)].startswith("-"):
        argv = [argv[len(leading)], *leading, *argv[len(leading) + 1 :]]
    asked = next((word for word in argv if not word.startswith("-")), "")

    installed = functools.cache(functools.partial(plugins, f"{name}.commands"))
    known = commands.get(asked)
    if isinstance(known, Plugin) and asked not in installed():
        print(f"{name}: {missing_plugin(known.distribution, f'`{name} {asked}`')}", file=sys.stderr)
        return 1

    def declare(names: Iterable[str]) -> argparse.ArgumentParser:
        for each in names:
            where = commands.get(each)
            if isinstance(where, str):
                found = import_module(where if "." in where else f"{name}.cli.{where}")
            elif each in installed():
                found = installed()[each].load()
            elif where is not None:
                subparsers.add_parser(each, help=f"{where.summary} (pip install {where.distribution})")
                continue
            rows = (row for row in vars(found).values() if isinstance(row, Subcommand))
            next(row for row in rows if row.name == each).declare(subparsers)
        return parser

    def every() -> list[str]:
        return [*commands, *sorted(installed().keys() - commands.keys())]

    names = [asked] if isinstance(known, str) else every()
    declare([asked] if asked in names else names)
    parser.set_defaults(all_commands=lambda: declare(each for each in every() if each != asked))
    try:
        if asked and asked not in names and argv[0] == asked:
            hint = similar(asked, names) or ";"
            parser.error(f"unknown command {asked!r}{hint} the commands are {', '.join(names)}")
        if asked not in names and argv and argv[0].startswith("--") and not "--version".startswith(argv[0]):
            behind = next((word for word in argv if word in names), None)
            if behind is not None:
                parser.error(f"options come after the command: {name} {behind} {argv[0]}")
        args, extra = parser.parse_known_args(argv)
        # argparse does not assign a variable number of positional arguments that come after an option.
        trailing = getattr(args, "trailing", None)
        if extra and trailing is not None and not any(each.startswith("-") for each in extra):
            getattr(args, trailing).extend(extra)
        elif extra:
            option = extra[0].partition("=")[0]
            if option in args.options():
                hint = f"; options come after the command: {name} {args.command} {option}"
            else:
                hint = similar(option, args.options())
            args.usage_error(f"unrecognized arguments: {' '.join(extra)}{hint}")
    except SystemExit as exit_:  # argparse has printed the error, or the help
        return int(exit_.code or 0)
    for stream in (sys.stdout, sys.stderr):
        # Printing text from the wire must not fail on a terminal that is not UTF-8, so unknown characters are escaped.
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
        # The reader has closed the pipe, as `head` does. Writing the rest of the buffer would fail again at the exit.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except LinkError as error:
        print(f"{name}: {printable(str(error))}", file=sys.stderr)
        return 1


class _Version(argparse.Action):
    """Action that prints the version.

    The version is looked up only when the option is used, because the look-up imports many modules.
    """

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        import importlib.metadata

        try:
            version = importlib.metadata.version(NAME)
        except importlib.metadata.PackageNotFoundError:
            version = "(not installed)"
        print(parser.prog, version)
        parser.exit()


class _SafeFormatter(logging.Formatter):
    """Formatter that escapes control characters, because log lines quote text from the wire."""

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return "\n".join(map(printable, text.split("\n")))


class _Stderr(logging.Handler):
    """Handler that writes to the current `sys.stderr`, which a live view replaces to print lines above its panel."""

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
