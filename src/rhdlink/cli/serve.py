"""`rhdlink serve`: host a robot from an `rhdconfig.xml`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from linkcore.cli.options import DURATION, argument, command

from ..host.config import read_config
from ..host.host import Host
from .hosting import serve_until_told, service_arguments, service_options
from .options import port


@command(
    "serve",
    "run plugins and serve their variables",
    argument("config", metavar="CONFIG.xml", help="an rhdconfig.xml"),
    argument("--port", type=port, metavar="P", help="listen on port P, 0 for a free port (default: the file's)"),
    argument(
        "--listen", dest="address", metavar="H", help="listen on the address H (default: the file's, or 127.0.0.1)"
    ),
    *service_options("the file's, or "),
    DURATION,
)
def run(args: argparse.Namespace) -> int:
    """Host a robot: run the plugins that an rhdconfig.xml names, and serve their variables, until Ctrl-C, SIGTERM or
    --duration. Plugins are closed at the end.

    The file has the format of the original daemon, with plugins in Python: lib="package.module:Class". Modules are
    searched in Python's path, then in the folder of the file. Without <address value="..."/> in <server>, only
    programs on this computer can connect, because any program that can connect can drive the robot. If a plugin with
    critical="true" fails, the robot is shut down with exit status 1. Other plugins that fail are disabled.

    examples:
      rhdlink serve rhdconfig.xml
      rhdlink serve rhdconfig.xml --port 0 --duration 10
      rhdlink serve rhdconfig.xml --listen 0.0.0.0 -v
    """
    config = read_config(args.config)
    folder = str(Path(args.config).resolve().parent)
    # Add the folder at the end of the path, so that its files never hide a module that other code imports.
    sys.path.append(folder)
    try:
        host = Host.from_config(config, **service_arguments(args, config.limits))
        names = ", ".join(plugin.name for plugin in host.plugins) or "no plugins"
        return serve_until_told(host, f"{args.config}: {names}", args.duration)
    finally:
        sys.path.remove(folder)
