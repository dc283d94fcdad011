"""The `urlink` command: one module per subcommand, and what they share."""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import io
import logging
import os
import sys
from collections.abc import Iterator, Sequence

from linkcore.errors import LinkError

from . import dissect, echo, hz, info, monitor, record, replay, sim
from .interruption import Interrupted, raise_on_sigterm
from .terminal import safe

__all__ = ["main"]

_COMMANDS = (monitor, echo, hz, info, record, replay, dissect, sim)

_DESCRIPTION = """\
Read Universal Robots arms of every generation, from a real controller, a simulated one or a recording."""

_EPILOG = """\
addresses:
  192.168.56.101                   a controller, by name or number
  ur://host?primary=40001          one on other ports
  sim://                           a simulated UR5e; sim://ur10?firmware=3.4 another
  replay:///tmp/run.urlog?rate=2   a recording

exit status:
  0 done, 1 the robot, the file or the address was at fault (one line on stderr says how), 2 wrong usage,
  130 ended by Ctrl-C, 143 by SIGTERM

`urlink COMMAND --help` explains each command, with examples."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status and never raises."""
    parser = _parser()
    try:
        args, extra = parser.parse_known_args(argv)
        # argparse gives up on FIELDs that stand after an option.
        if extra and hasattr(args, "fields") and not any(each.startswith("-") for each in extra):
            args.fields += extra
        elif extra:
            args.usage_error(f"unrecognized arguments: {' '.join(extra)}")
    except SystemExit as exit_:  # argparse has said what is wrong, or has shown the help
        return int(exit_.code or 0)
    for stream in (sys.stdout, sys.stderr):
        # Text from the wire must not fail on a terminal that is not UTF-8.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with raise_on_sigterm(), _logging(args.verbose):
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
        # Whoever reads has had enough, as `head` has. What is left in the buffer would fail again at exit.
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except LinkError as error:
        print(f"urlink: {safe(str(error))}", file=sys.stderr)
        return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="urlink",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"urlink {_version()}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", dest="command", required=True)
    for command in _COMMANDS:
        command.add_parser(subparsers)
    return parser


def _version() -> str:
    try:
        return importlib.metadata.version("urlink")
    except importlib.metadata.PackageNotFoundError:
        return "(not installed)"


class _SafeFormatter(logging.Formatter):
    """Log lines quote what came over the wire, so they are made safe as well."""

    def format(self, record: logging.LogRecord) -> str:
        text = super().format(record)
        return "\n".join(map(safe, text.split("\n")))


class _Stderr(logging.Handler):
    """Writes to whatever stderr is at the time: the monitor puts lines above its picture."""

    def emit(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(BrokenPipeError):
            print(self.format(record), file=sys.stderr)


@contextlib.contextmanager
def _logging(verbose: int) -> Iterator[None]:
    level = (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    handler = _Stderr()
    handler.setFormatter(_SafeFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    loggers = [logging.getLogger(name) for name in ("linkcore", "urlink")]
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
