"""Run the tests of one group once for each mutation, each in its own process that is forked after the collection.

Tests are collected once. For each mutation, a forked child replaces the code of the function by the mutated code. This
costs milliseconds, instead of a new interpreter. Values that are evaluated on import (constants of a module, default
values, class bodies) cannot be replaced in this way. For such a mutation, a new interpreter imports the mutated module.

The fastest tests that execute the mutated lines are run, until one fails. Tests that detected another mutation of the
same function come first, then tests that detected another mutation of the same file. The lines that each test executes
are measured beforehand, without a mutation.

Why not mutmut, which others maintain? Version 3.8.1 can run these tests (``-p pytest_urlink``, 1 s of processor time
for each change), but it changes only the bodies of functions, not constants, defaults or classes. It runs no controls,
and it has no list of changes that no user can see, with the reason. Of its first 92 changes to `silence` and
`interlock`, 9 were not detected, and 5 of these were texts of the log. Cosmic Ray starts an interpreter and all tests
for each change.
"""

from __future__ import annotations

import ast
import contextlib
import faulthandler
import gc
import importlib.abc
import importlib.machinery
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, NamedTuple

import coverage
import pytest

from tests.mutants.defects import draw, with_defect
from tests.mutants.drawn import COUNT, SEED
from tests.mutants.equivalent import Equivalent, equivalents
from tests.mutants.operators import Function, Mutation, mutated, mutations
from tests.mutants.targets import GROUPS, ROOT

#: Time limit of a test with a mutation, in seconds, in addition to ten times its usual time. Many mutants loop forever.
LENIENCE = 5.0

#: Name of the file in the folder of a child that contains the test that it runs.
RUNNING = "running"

#: Number of children without a mutation in each group. Their failures show how many kills the computer causes.
CONTROLS = 10


class Job(NamedTuple):
    """Mutation of a file, or a control that runs the same tests without the mutation."""

    path: Path
    mutation: Mutation
    is_control: bool = False


class Result(NamedTuple):
    path: str
    mutation: Mutation
    is_control: bool
    #: "killed", "survived", or "uncovered" if no test executes it. A test that does not end kills the mutation, too.
    outcome: str
    #: Number of chosen tests.
    tests: int
    #: Test that failed or did not end.
    killer: str | None = None

    def as_json(self) -> dict[str, Any]:
        return {**self._asdict(), "mutation": self.mutation._asdict()}


class Measured(NamedTuple):
    """Measurements of the tests without a mutation."""

    #: Duration of each passing test, in seconds.
    seconds: dict[str, float]
    #: Tests that execute each line of each file.
    lines: dict[str, dict[int, list[str]]]

    def choose(self, job: Job, budget: float, killers: Killers) -> list[str]:
        """Choose the fastest tests that execute the mutated lines, up to `budget` seconds; `killers` come first.

        For a mutation outside of functions, choose tests that execute any line of the file, or are in its test file.
        """
        lines = self.lines.get(str(job.path), {})
        numbers = range(job.mutation.line, job.mutation.end + 1) if job.mutation.function else lines
        names = {name for number in numbers for name in lines.get(number, ())} & self.seconds.keys()
        if not job.mutation.function:
            # A test can read a constant of a module without executing a line of it.
            own = f"/test_{job.path.stem}.py::"
            names |= {name for name in self.seconds if own in name}
        chosen: list[str] = []
        for name in sorted(names, key=lambda name: self.seconds[name]):
            budget -= self.seconds[name]
            if budget < 0 and chosen:
                break
            chosen.append(name)
        chosen.sort(key=lambda name: killers.rank(job, name))
        return chosen


class Killers:
    """Tests that have detected mutations so far, by function and by file."""

    def __init__(self) -> None:
        self._of: dict[object, Counter[str]] = {}

    def note(self, job: Job, test: str) -> None:
        for place in (job.path, (job.path, job.mutation.function)):
            self._of.setdefault(place, Counter())[test] += 1

    def rank(self, job: Job, test: str) -> tuple[int, int]:
        """Return the rank of a test, which is lower if it detected more mutations of the function, then of the file."""
        function, file = (self._of.get(place) for place in ((job.path, job.mutation.function), job.path))
        return -function[test] if function else 0, -file[test] if file else 0


class Child:
    """Process that runs tests, with the group of processes that the tests start."""

    def __init__(self, pid: int, folder: Path) -> None:
        self._pid = pid
        self._folder = folder
        #: Last test of the process, once the process has ended.
        self.last: str | None = None

    def outcome(self) -> str | None:
        """Return the outcome, or None while the process runs."""
        pid, status = os.waitpid(self._pid, os.WNOHANG)
        if not pid:
            return None
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._pid, signal.SIGKILL)
        with contextlib.suppress(FileNotFoundError):
            self.last = (self._folder / RUNNING).read_text()
        shutil.rmtree(self._folder, ignore_errors=True)
        return "survived" if os.waitstatus_to_exitcode(status) == 0 else "killed"


def alone(folder: Path) -> None:
    """Isolate a child: give it its own session, no output, and its own folder for temporary files."""
    os.setsid()
    os.environ["PYTEST_DEBUG_TEMPROOT"] = str(folder)
    tempfile.tempdir = str(folder)
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)


class Engine:
    """Plugin that replaces the loop of pytest over the tests."""

    def __init__(
        self,
        files: Sequence[Path],
        equivalent: Sequence[Equivalent],
        sample: int | None,
        jobs: int,
        budget: float,
        seed: int,
        drawn: slice | None = None,
    ) -> None:
        self._files = files
        self._drawn = drawn
        self._equivalent = equivalent
        self._sample = sample
        self._parallel = jobs
        self._budget = budget
        self._random = random.Random(seed)
        self._sources = {path: path.read_text(encoding="utf-8") for path in files}
        self.results: list[Result] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        # Children have their own deadline, and their output is discarded.
        session.config.pluginmanager.unregister(name="watchdog")
        self._items = {item.nodeid: item for item in session.items}
        self._functions = dict(_functions(set(map(str, self._files))))
        measured = self._measure()
        jobs = self._jobs()
        seconds = sum(measured.seconds.values())
        print(f"{len(measured.seconds)} of {len(self._items)} tests pass, in {seconds:.0f} s", file=sys.stderr)
        print(f"{len(jobs)} runs, of mutants and of {CONTROLS} controls", file=sys.stderr, flush=True)
        running: list[tuple[Child, Job, int]] = []
        killers = Killers()
        while jobs or running:
            while jobs and len(running) < self._parallel:
                job = jobs.pop()
                names = measured.choose(job, self._budget, killers)
                if names:
                    running.append(
                        (self._start(job, {name: measured.seconds[name] for name in names}), job, len(names))
                    )
                elif not job.is_control:
                    self._note(job, "uncovered", 0)
            time.sleep(0.005)
            for each in list(running):
                child, job, count = each
                if (outcome := child.outcome()) is not None:
                    running.remove(each)
                    killer = child.last if outcome == "killed" else None
                    if killer and not job.is_control:
                        killers.note(job, killer)
                    self._note(job, outcome, count, killer)
        return True

    def _note(self, job: Job, outcome: str, tests: int, killer: str | None = None) -> None:
        path = str(job.path.relative_to(ROOT))
        self.results.append(Result(path, job.mutation, job.is_control, outcome, tests, killer))
        if killer and job.is_control:
            print(f"failed without a mutation: {killer}", file=sys.stderr, flush=True)
        if outcome in ("survived", "uncovered") and not job.is_control:
            mutation = job.mutation
            where = f"{job.path.relative_to(ROOT)}:{mutation.line}"
            print(f"{where}: {outcome}: {mutation.before}  ->  {mutation.after}", file=sys.stderr, flush=True)

    def _jobs(self) -> list[Job]:
        """Return the jobs in reverse order of execution, so controls run first."""
        jobs: list[Job] = []
        if self._drawn is not None:
            drawn = [Job(path, mutation) for path, mutation in draw(self._files, SEED, COUNT)][self._drawn]
            return [job for job in drawn if not self._is_equivalent(job.path, job.mutation)][::-1]
        for path, source in self._sources.items():
            found = [one for one in mutations(source) if not self._is_equivalent(path, one)]
            if self._sample is not None and len(found) > self._sample:
                found = sorted(self._random.sample(found, self._sample))
            jobs += [Job(path, mutation) for mutation in found]
        within = [job for job in jobs if job.mutation.function]
        controls = [job._replace(is_control=True) for job in self._random.sample(within, min(CONTROLS, len(within)))]
        return [*jobs[::-1], *controls]

    def _is_equivalent(self, path: Path, mutation: Mutation) -> bool:
        name = path.relative_to(ROOT / "src").as_posix()
        return any(row.matches(name, mutation) for row in self._equivalent)

    # -- children ----------------------------------------------------------------------------

    def _start(self, job: Job, seconds: dict[str, float]) -> Child:
        folder = Path(tempfile.mkdtemp(prefix="mutant-"))
        code = None if job.is_control else self._code(job)
        if code is None and not job.is_control:
            return Child(_interpreter(job, seconds, folder), folder)
        pid = os.fork()
        if pid == 0:
            try:
                alone(folder)
                if code is not None:
                    function, other = code
                    for each in self._functions[str(job.path), function]:
                        each.__code__ = other
                self._run([self._items[name] for name in seconds], First(seconds, folder))
                os._exit(0)
            finally:
                os._exit(2)
        return Child(pid, folder)

    def _code(self, job: Job) -> tuple[Function, CodeType] | None:
        """Return the function to replace and its mutated code, or None if the module must be imported again."""
        function = job.mutation.function
        if function is None or (str(job.path), function) not in self._functions:
            return None
        module = compile(
            changed(self._sources[job.path], job.mutation.number, job.mutation.kind),
            str(job.path),
            "exec",
            dont_inherit=True,
        )
        (code,) = (each for each in codes(module) if (each.co_name, each.co_firstlineno) == function)
        for each in self._functions[str(job.path), function]:
            # If the mutation removes the only use of a variable of an outer function, the code cannot be replaced.
            if each.__code__.co_freevars != code.co_freevars:
                return None
        return function, code

    def _run(self, items: Sequence[pytest.Item], plugin: object) -> None:
        items[0].config.pluginmanager.register(plugin)
        for item, following in zip(items, [*items[1:], None], strict=True):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)

    def _measure(self) -> Measured:
        with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
            path = Path(folder) / "measured.json"
            pid = os.fork()
            if pid == 0:
                try:
                    alone(Path(folder))
                    self._run_measured(path)
                finally:
                    os._exit(2)
            os.waitpid(pid, 0)
            if not path.exists():
                raise pytest.UsageError("the tests could not be run without a mutation")
            seconds, lines = json.loads(path.read_text())
        return Measured(seconds, {name: {int(line): of for line, of in each.items()} for name, each in lines.items()})

    def _run_measured(self, path: Path) -> None:
        tracer = coverage.Coverage(data_file=None, include=list(map(str, self._files)), config_file=False)
        tracer.start()
        watch = Stopwatch(tracer)
        self._run(list(self._items.values()), watch)
        tracer.stop()
        data = tracer.get_data()
        lines = {str(each): data.contexts_by_lineno(str(each)) for each in self._files}
        path.write_text(json.dumps([watch.seconds, lines]))


class First:
    """Plugin that exits the process at the first test that fails or does not end.

    Args:
        seconds: Duration of each test without a mutation, in seconds.
        folder: Folder for a file with the name of the running test.
    """

    def __init__(self, seconds: dict[str, float], folder: Path) -> None:
        self._seconds = seconds
        self._running = folder / RUNNING
        self._null = os.open(os.devnull, os.O_WRONLY)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self._running.write_text(item.nodeid)
        # The timer is a C thread, so it also ends a loop that keeps the interpreter lock.
        faulthandler.dump_traceback_later(LENIENCE + 10 * self._seconds[item.nodeid], exit=True, file=self._null)
        return (yield)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os._exit(1)


class Stopwatch:
    """Plugin that measures each test, and sets the context of the tracer to the running test."""

    def __init__(self, tracer: coverage.Coverage) -> None:
        self._tracer = tracer
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self._tracer.switch_context(item.nodeid)
        self._has_passed = True
        begin = time.perf_counter()
        try:
            return (yield)
        finally:
            if self._has_passed:
                self.seconds[item.nodeid] = time.perf_counter() - begin

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self._has_passed = False


def _functions(files: set[str]) -> Iterator[tuple[tuple[str, Function], list[FunctionType]]]:
    """Yield (file, function) and the function objects for it; a function has several if its class has clones."""
    found: dict[tuple[str, Function], list[FunctionType]] = {}
    gc.unfreeze()  # tests/conftest.py freezes objects after the collection, and frozen objects are not listed
    for each in gc.get_objects():
        if isinstance(each, FunctionType) and each.__code__.co_filename in files:
            code = each.__code__
            found.setdefault((code.co_filename, Function(code.co_name, code.co_firstlineno)), []).append(each)
    yield from found.items()


def codes(code: CodeType) -> Iterator[CodeType]:
    """Yield the code objects of all classes and functions in a code object, outer ones first."""
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield each
            yield from codes(each)


# -- a new interpreter -----------------------------------------------------------------------


def _interpreter(job: Job, seconds: dict[str, float], folder: Path) -> int:
    order = {
        "path": str(job.path),
        "number": job.mutation.number,
        "kind": job.mutation.kind,
        "seconds": seconds,
        "folder": str(folder),
    }
    command = [sys.executable, "-m", "tests.mutants.engine"]
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env={**os.environ, "PYTEST_DEBUG_TEMPROOT": str(folder), "TMPDIR": str(folder)},
        text=True,
    )
    assert process.stdin is not None
    with process.stdin as stdin:
        json.dump(order, stdin)
    process.returncode = 0  # the engine waits for the process by its id
    return process.pid


def changed(source: str, number: int, kind: str) -> ast.Module:
    """Return the module with one mutation, or with one defect if `kind` is not empty."""
    return with_defect(source, number) if kind else mutated(source, number)


class MutatedLoader(importlib.machinery.SourceFileLoader):
    def __init__(self, fullname: str, path: str, number: int, kind: str) -> None:
        super().__init__(fullname, path)
        self._number = number
        self._kind = kind

    def get_code(self, fullname: str) -> CodeType:
        # Do not call the base class, because it takes the bytecode of the original program from the cache.
        return compile(
            changed(self.get_data(self.path).decode(), self._number, self._kind), self.path, "exec", dont_inherit=True
        )


class Finder(importlib.abc.MetaPathFinder):
    """Finder that gives one module a loader that mutates it."""

    def __init__(self, path: str, number: int, kind: str) -> None:
        self._path = path
        self._number = number
        self._kind = kind

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
        if spec is None or spec.origin != self._path:
            return None
        spec.loader = MutatedLoader(fullname, self._path, self._number, self._kind)
        return spec


def options() -> list[str]:
    """Return the options of pytest for every process."""
    return ["-q", "-s", "-p", "no:cacheprovider", "-p", "no:xdist", "-c", str(ROOT / "pyproject.toml")]


def run_order() -> int:
    """Import the mutated module and run the tests, in a new interpreter."""
    order = json.load(sys.stdin)
    sys.meta_path.insert(0, Finder(order["path"], order["number"], order["kind"]))
    # A test that cannot be collected has detected the mutation, too.
    return int(pytest.main([*options(), *order["seconds"]], plugins=[First(order["seconds"], Path(order["folder"]))]))


def run_group(
    name: str,
    only: str | None,
    tests: Sequence[str] | None,
    sample: int | None,
    jobs: int,
    budget: float,
    seed: int,
    drawn: slice | None = None,
) -> list[Result]:
    group = GROUPS[name]
    files = [path for path in group.files() if only is None or path.stem == only]
    engine = Engine(files, equivalents(name), sample, jobs, budget, seed, drawn)
    status = pytest.main([*options(), *(str(ROOT / test) for test in tests or group.tests)], plugins=[engine])
    if status != pytest.ExitCode.OK:
        raise SystemExit(f"the tests of {name} could not be collected")
    return engine.results


if __name__ == "__main__":
    sys.exit(run_order())
