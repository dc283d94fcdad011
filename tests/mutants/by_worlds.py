"""Find the drawn defects with simulated worlds: ``python -m tests.mutants.by_worlds --report FILE``.

The worlds run once without a defect, to record the functions that each of them calls. For each defect, a forked process
replaces the function, and runs the worlds that call this function in the order of their seeds, until one fails. Worlds
that fail without a defect are not run. Worlds that do not call the function are not run either, because their result
would be the same.
"""

from __future__ import annotations

import argparse
import ast
import faulthandler
import importlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

from tests.mutants.defects import Drawn, draw, with_defect
from tests.mutants.drawn import COUNT, SEED
from tests.mutants.engine import _functions, codes
from tests.mutants.operators import Function
from tests.mutants.targets import GROUPS, ROOT

#: Limit of real time for one world with a defect, in s. A world that takes longer counts as hanging.
_HANGS = 25.0


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants.by_worlds", description=__doc__)
    parser.add_argument("--drawn", metavar="FROM:TO", default=":", help="try this range of the drawn defects")
    parser.add_argument("--only", metavar="NUMBERS", help="of this range, try only the defects in this list: 3,7,12")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the draw (default: %(default)s)")
    parser.add_argument(
        "--worlds", type=int, default=500, help="number of worlds for each defect (default: %(default)d)"
    )
    parser.add_argument("--first", type=int, default=0, help="seed of the first world (default: %(default)d)")
    parser.add_argument(
        "--limit", type=float, default=120.0, help="processor time for each defect, in s (default: 120)"
    )
    parser.add_argument("--jobs", type=int, default=1, help="parallel processes (default: %(default)d)")
    parser.add_argument(
        "--calls", type=Path, help="file to save or load the functions that worlds call without a defect"
    )
    parser.add_argument(
        "--report", type=Path, required=True, metavar="FILE", help="write one JSON object per line to FILE"
    )
    options = parser.parse_args()
    files = GROUPS["drawn"].files()
    for path in files:
        importlib.import_module(".".join(path.relative_to(ROOT / "src").with_suffix("").parts))
    importlib.import_module("tests.worlds.running")
    first, _, last = options.drawn.partition(":")
    drawn = list(enumerate(draw(files, options.seed, COUNT)))[slice(int(first or 0), int(last) if last else None)]
    if options.only is not None:
        drawn = [each for each in drawn if each[0] in set(map(int, options.only.split(",")))]
    functions = dict(_functions(set(map(str, files))))
    seeds = range(options.first, options.first + options.worlds)
    if options.calls is not None and options.calls.exists():
        calls, failing = json.loads(options.calls.read_text())
    else:
        calls, failing = _measured(draw(files, options.seed, COUNT), functions, seeds)
        if options.calls is not None:
            options.calls.write_text(json.dumps([{seed: sorted(names) for seed, names in calls.items()}, failing]))
    print(f"{len(seeds)} worlds, of which {len(failing)} fail without a defect: {failing}", flush=True)
    waiting = list(drawn)
    running: dict[int, tuple[int, Drawn, int, int]] = {}
    with options.report.open("a") as report:
        while waiting or running:
            while waiting and len(running) < options.jobs:
                number, each = waiting.pop(0)
                asked = [seed for seed in seeds if seed not in failing and str(_key(each)) in calls[str(seed)]]
                read, write = os.pipe()
                pid = os.fork()
                if pid == 0:
                    os.close(read)
                    _try(each, functions, asked, options.limit, write)
                os.close(write)
                running[pid] = number, each, read, len(asked)
            pid, _status = os.wait()
            number, each, read, count = running.pop(pid)
            with os.fdopen(read) as pipe:
                lines = pipe.read().splitlines()
            outcome = json.loads(lines[-1]) if lines else {"outcome": "not made"}
            if outcome["outcome"] == "begins":
                outcome = {**outcome, "outcome": "found", "fault": "the process hangs or ends"}
            result = {"number": number, "path": str(each.path.relative_to(ROOT / "src")), "of": count, **outcome}
            result |= {"kind": each.mutation.kind, "line": each.mutation.line, "before": each.mutation.before}
            report.write(json.dumps(result) + "\n")
            report.flush()
            print(number, result["path"], each.mutation.line, outcome, flush=True)
    return 0


def _key(each: Drawn) -> tuple[str, Function | None]:
    return str(each.path), each.mutation.function


def _measured(
    drawn: Iterable[Drawn], functions: dict[Any, list[FunctionType]], seeds: range
) -> tuple[dict[str, set[str]], list[int]]:
    """Return the functions that each world calls, by seed, and the seeds that fail without a defect."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        os.close(read)
        hits: set[str] = set()
        sys.modules["__hits__"] = hits  # type: ignore[assignment]
        for path, function in {_key(each) for each in drawn}:
            _replace(functions, (path, function), _counting(Path(path), function))
        from tests.worlds.drawn import draw as draw_world
        from tests.worlds.running import run

        with os.fdopen(write, "w") as pipe:
            for seed in seeds:
                hits.clear()
                faults = run(draw_world(seed)).faults
                pipe.write(json.dumps([seed, sorted(hits), faults[:1]]) + "\n")
                pipe.flush()
        os._exit(0)
    os.close(write)
    calls, failing = {}, []
    with os.fdopen(read) as pipe:
        for line in pipe:
            seed, hit, faults = json.loads(line)
            calls[str(seed)] = set(hit)
            if faults:
                failing.append(seed)
    os.waitpid(pid, 0)
    return calls, failing


def _counting(path: Path, function: Function | None) -> ast.Module:
    """Return the module, with a function that records its calls."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    note = f"__import__('sys').modules['__hits__'].add({str((str(path), function))!r})"
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)) and function is not None:
            first = node.decorator_list[0].lineno if node.decorator_list else node.lineno
            if (node.name, first) == function:
                node.body.insert(0, ast.parse(note).body[0])
    return ast.fix_missing_locations(tree)


def _replace(functions: dict[Any, list[FunctionType]], key: tuple[str, Function | None], tree: ast.Module) -> bool:
    """Replace the code of the functions with this name; return False if that is not possible."""
    module = compile(tree, key[0], "exec", dont_inherit=True)
    found: list[CodeType] = [each for each in codes(module) if (each.co_name, each.co_firstlineno) == key[1]]
    live = functions.get(key, [])
    if not live or len(found) != 1 or any(each.__code__.co_freevars != found[0].co_freevars for each in live):
        return False
    for each in live:
        each.__code__ = found[0]
    return True


def _try(each: Drawn, functions: dict[Any, list[FunctionType]], seeds: list[int], limit: float, write: int) -> None:
    """Run worlds until one fails. Called in a forked process."""
    tell: Callable[[dict[str, Any]], int] = lambda what: os.write(write, (json.dumps(what) + "\n").encode())  # noqa: E731
    null = os.open(os.devnull, os.O_WRONLY)
    for descriptor in (1, 2):
        os.dup2(null, descriptor)
    try:
        tree = with_defect(each.path.read_text(encoding="utf-8"), each.mutation.number)
        if not _replace(functions, _key(each), tree):
            tell({"outcome": "not made"})
            os._exit(0)
        from tests.worlds.drawn import draw as draw_world
        from tests.worlds.running import run

        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        for count, seed in enumerate(seeds):
            tell({"outcome": "begins", "seed": seed, "worlds": count + 1})
            faulthandler.dump_traceback_later(_HANGS, exit=True, file=null)
            faults = run(draw_world(seed)).faults
            faulthandler.cancel_dump_traceback_later()
            if faults:
                fault = faults[0].splitlines()
                tell({"outcome": "found", "seed": seed, "worlds": count + 1, "fault": f"{fault[0]} {fault[-1]}"[:200]})
                os._exit(0)
            if time.process_time() > limit:
                tell({"outcome": "missed, out of time", "worlds": count + 1})
                os._exit(0)
        tell({"outcome": "missed", "worlds": len(seeds)})
    except BaseException as error:
        tell({"outcome": "found", "fault": f"raised {error!r}"[:200], "worlds": 0})
    finally:
        os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
