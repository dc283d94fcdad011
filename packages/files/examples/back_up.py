"""Back up the programs and installations of a controller into a folder named after the date.

python packages/files/examples/back_up.py 192.168.56.101 --password
"""

import argparse
import asyncio
import getpass
import sys
from datetime import date

import urlink
import urlink_files


async def back_up(args: argparse.Namespace, password: str | None) -> None:
    folder = f"{args.into}/{date.today():%Y-%m-%d}"
    async with urlink_files.connect(
        args.host, port=args.port, user=args.user, password=password, key=args.key, host_key=args.host_key
    ) as files:
        names = ["programs/*.urp", "programs/*.installation"]
        copies = await files.get(names, folder, replace=True)
        print(f"{len(copies)} files in {folder}")


def main() -> int:
    parser = argparse.ArgumentParser(description="Back up the programs of a controller.")
    parser.add_argument("host", help="name or address of the controller")
    parser.add_argument("--into", default="backup", help="folder for the backups (default: backup)")
    parser.add_argument("--port", type=int, default=22)
    parser.add_argument("--user", default="root")
    parser.add_argument("--password", action="store_true", help="ask for a password")
    parser.add_argument("--key", help="private key (default: your keys)")
    parser.add_argument("--host-key", help="fingerprint of the controller (default: ~/.ssh/known_hosts)")
    args = parser.parse_args()
    try:
        asyncio.run(back_up(args, getpass.getpass() if args.password else None))
    except urlink.LinkError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
