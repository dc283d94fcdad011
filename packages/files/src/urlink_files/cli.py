"""Command `urlink files`: lists and copies the files of a controller."""

from __future__ import annotations

import argparse
import asyncio
import getpass

from urlink.tools import argument, command, printable, seconds, strict_json

from .controller_files import RemoteFile, connect
from .places import PLACES


@command(
    "files",
    "list and copy files of a controller",
    argument("action", choices=("ls", "get", "put"), help="list files, or copy them from or to the controller"),
    argument("host", metavar="HOST", help="name or address of the controller"),
    argument(
        "words",
        metavar="NAME",
        nargs="*",
        trailing=True,
        words=lambda: PLACES,
        help="ls: a place or pattern (default: programs); get: patterns, then a local folder; put: local files",
    ),
    argument("--port", type=int, default=22, metavar="N", help="port of the SSH server (default: 22)"),
    argument("--user", default="root", metavar="NAME", help="user on the controller (default: root)"),
    argument("--password", action="store_true", help="ask for a password"),
    argument("--key", metavar="FILE", help="private key (default: your keys and your SSH agent)"),
    argument("--host-key", metavar="SHA256:...", help="fingerprint of the controller (default: ~/.ssh/known_hosts)"),
    argument("--into", default="programs", metavar="FOLDER", help="folder for put (default: programs)"),
    argument("--replace", action="store_true", help="replace existing files"),
    argument("--timeout", type=seconds, default=60.0, metavar="S", help="stop after S seconds (default: 60)"),
    argument("--json", action="store_true", help="print one JSON object per line"),
    listing=lambda: "\n".join(f"  {name:14} {place.folder}: {place.content}" for name, place in PLACES.items()),
)
def run(args: argparse.Namespace) -> int:
    """List and copy files of a controller over SSH. `put` writes only into the folder of the programs. A loaded program
    does not change before it is loaded again.

    Places, which a NAME can begin with:

    examples:
      urlink files ls 192.168.56.101
      urlink files get 192.168.56.101 'programs/*.urp' programs/default.installation backup --password
      urlink files get 192.168.56.101 flightreports reports
      urlink files put 192.168.56.101 pick.urp --into programs/cell --replace
    """
    if args.action == "ls" and len(args.words) > 1:
        args.usage_error("ls takes at most one NAME")
    if args.action == "get" and len(args.words) < 2:
        args.usage_error("get needs names on the controller and a folder of this computer")
    if args.action == "put" and not args.words:
        args.usage_error("put needs files of this computer")
    password = getpass.getpass(f"password of {args.user} at {args.host}: ") if args.password else None
    asyncio.run(_run(args, password))
    return 0


async def _run(args: argparse.Namespace, password: str | None) -> None:
    async with connect(
        args.host,
        port=args.port,
        user=args.user,
        password=password,
        key=args.key,
        host_key=args.host_key,
        timeout=args.timeout,
    ) as files:
        if args.action == "ls":
            for file in await files.ls(*args.words):
                print(_as_json(file) if args.json else _as_line(file))
        elif args.action == "get":
            *names, folder = args.words
            for copy in await files.get(names, folder, replace=args.replace):
                print(strict_json({"path": str(copy)}) if args.json else copy)
        else:
            for path in args.words:
                file = await files.put(path, args.into, replace=args.replace)
                print(_as_json(file) if args.json else file.path)


def _as_json(file: RemoteFile) -> str:
    modified = file.modified.isoformat()
    return strict_json({"path": file.path, "size": file.size, "modified": modified, "is_folder": file.is_folder})


def _as_line(file: RemoteFile) -> str:
    mark = "/" if file.is_folder else ""
    return f"{file.size:>12} {file.modified:%Y-%m-%d %H:%M} {printable(file.path)}{mark}"
