"""`rhdlink serve`: a robot from its `rhdconfig.xml`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from linkcore.cli.options import Subparsers, add_command, seconds

from ..config import read_config
from ..host import Host
from .options import port
from .serving import serve_until_told

__all__ = ["add_parser"]

_DESCRIPTION = """\
Be a robot: run the plugins that an rhdconfig.xml names, and serve their variables, until Ctrl-C, SIGTERM or
--duration. Plugins are ended in order.

The file is that of the original daemon, with plugins in Python: lib="package.module:Class". Modules are
looked for where Python finds them, and then beside the file. Without <address value="..."/> in <server>
only programs on this machine can connect: whoever can connect can drive the robot. When a plugin with
critical="true" fails, the robot ends in order with exit status 1; others are disabled."""

_EXAMPLES = (
    "rhdlink serve rhdconfig.xml",
    "rhdlink serve rhdconfig.xml --port 0 --duration 10",
    "rhdlink serve rhdconfig.xml --listen 0.0.0.0 -v",
)


def add_parser(subparsers: Subparsers) -> None:
    """Declare the command."""
    parser = add_command(subparsers, "serve", "run plugins and serve their variables", _DESCRIPTION, _EXAMPLES)
    parser.add_argument("config", metavar="CONFIG.xml", help="an rhdconfig.xml")
    parser.add_argument("--port", type=port, metavar="P", help="listen on port P, 0 for a free one (the file's)")
    parser.add_argument("--listen", metavar="H", help="listen on the address H (the file's, or 127.0.0.1)")
    parser.add_argument("--duration", type=seconds, metavar="S", help="end after S seconds (never)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Serve until told to stop.

    Raises:
        BadConfiguration: the file, or a plugin in it, cannot be used.
        PluginFailed: a critical plugin raised.
    """
    config = read_config(args.config)
    folder = str(Path(args.config).resolve().parent)
    # Last, so that no file there takes the place of a module that others mean.
    sys.path.append(folder)
    try:
        options: dict[str, Any] = {"port": args.port, "address": args.listen}
        host = Host.from_config(config, **{name: value for name, value in options.items() if value is not None})
        names = ", ".join(plugin.name for plugin in host.plugins) or "no plugin"
        ended = serve_until_told(host, args.listen or config.address, f"{args.config}: {names}", args.duration)
    finally:
        sys.path.remove(folder)
    ended.raise_if_any()
    return 0
