"""Command `urlink accept`: test a controller together with this library, and store the evidence."""

from __future__ import annotations

import argparse
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

from urlink import BadValue
from urlink.tools import ProgressBar, address, agrees, argument, command, seconds, tell

from ..acceptance import report, stages
from ..acceptance.bundle import opened, pack
from ..acceptance.person import AtTheTerminal
from ..acceptance.report import judge
from ..acceptance.requirements import from_file, requirements


@command(
    "accept",
    "test a controller and store the evidence",
    *address("?"),
    argument(
        "--stage",
        type=int,
        action="append",
        choices=list(stages.STAGES),
        help="stage to run; can be repeated (default: all)",
    ),
    argument("--yes", action="store_true", help="consent to the stages given by --stage"),
    argument("--dead-man", type=int, choices=range(8), metavar="N", help="move only while digital input N is on"),
    argument("--reverse-host", metavar="HOST", help="address of this computer as seen by the robot, for set-points"),
    argument("--reverse-peer", metavar="HOST", help="source address of the robot's connections (default: its own)"),
    argument("--duration", type=seconds, default=10.0, metavar="S", help="listen for S seconds (default: 10)"),
    argument("--requirements", metavar="FILE", help="use the limits and the description of the cell in FILE (TOML)"),
    argument("--bundle", metavar="FILE", help="save the evidence in this new file, a ZIP archive"),
    argument("--replay", metavar="FILE", help="judge a bundle again, without a controller"),
    argument("--html", metavar="FILE", help="also write the page as HTML"),
)
def run(args: argparse.Namespace) -> int:
    """Test a controller together with this library, and print a page that can be signed.

    Stage 0 only reads, stage 1 moves nothing, stage 2 MOVES wrist 3 by a few degrees, and stage 3 MOVES each joint
    alone by 17 degrees to either side. Each stage, and each joint of stage 3, needs your consent. --yes gives this
    consent for the stages that --stage names. A simulated arm needs no consent. Each requirement gets a verdict: held,
    NOT HELD, or not tried, with the reason. The exit status is 0 if all tried requirements are held.

    examples:
      urlink accept sim://ur5e
      urlink accept 192.168.56.101 --stage 0 --yes --html page.html
      urlink accept 192.168.56.101 --requirements cell.toml --bundle run.zip
      urlink accept --replay run.zip
    """
    if (args.address is None) == (args.replay is None):
        args.usage_error("expected an address, or --replay and a bundle")
    if args.replay is not None:
        return _page(Path(args.replay), args)
    if args.yes and not args.stage:
        args.usage_error("--yes needs --stage: each stage needs its own consent")
    if args.bundle is not None and Path(args.bundle).exists():
        raise BadValue(f"{args.bundle} already exists; expected a new file for the bundle")
    with tempfile.TemporaryDirectory(prefix="urlink-accept-") as folder:
        bundle = Path(folder, "bundle.zip") if args.bundle is None else Path(args.bundle)
        _test(args, Path(folder, "logbook.urlog"), bundle)
        return _page(bundle, args)


def _test(args: argparse.Namespace, logbook: Path, bundle: Path) -> None:
    wanted, site = (requirements(), {}) if args.requirements is None else from_file(Path(args.requirements))
    is_simulated = args.address.strip().startswith("sim:")

    def consent(number: int, does: str) -> str:
        if args.yes or is_simulated:
            return ""
        if not sys.stdin.isatty():
            return "no terminal to ask for consent"
        return "" if agrees(f"Stage {number} {does}.\nRun it?") else "no consent"

    numbers = args.stage or list(stages.STAGES)
    tell(f"testing {args.address}: stage {', '.join(map(str, numbers))}; press Ctrl-C to abort")
    person = AtTheTerminal() if sys.stdin.isatty() and not is_simulated else None
    with ProgressBar(f"connecting to {args.address}", args.quiet) as progress:
        secrets = stages.run(
            args.address,
            logbook,
            numbers,
            consent,
            person=person,
            dead_man=args.dead_man,
            seconds=args.duration,
            timeout=args.connect_timeout,
            reverse_host=args.reverse_host,
            reverse_peer=args.reverse_peer,
            progress=progress,
        )
        progress.next("packing the evidence")
        pack(logbook, bundle, wanted, site, secrets)


def _page(path: Path, args: argparse.Namespace) -> int:
    to = args.html
    with ExitStack() as stack:
        with ProgressBar("reading the evidence", args.quiet) as progress:
            bundle = stack.enter_context(opened(path))
            progress.next("judging the evidence")
            verdicts = judge(bundle.evidence, bundle.requirements, progress)
        print(report.as_text(bundle.evidence, verdicts, bundle.site, bundle.digest, args.address or ""))
        if to is not None:
            page = report.as_html(bundle.evidence, verdicts, bundle.site, bundle.digest, args.address or "")
            try:
                Path(to).write_text(page, encoding="utf-8")
            except OSError as error:
                raise BadValue(f"cannot write {to}: {error.strerror or error}") from None
    return 0 if report.is_accepted(verdicts) else 1
