"""Everyday checks. `nox` runs the checks of the gate, `nox -s tests` runs one of them, and `nox -l` lists all.

The long checks are in nightly.py: `nox -f nightly.py -l`.
"""

import os
import re
import shutil
import subprocess
import time
from pathlib import Path

import nox
from nox.command import CommandFailed

nox.needs_version = ">=2025.2.9"
nox.options.sessions = ["tests", "slow", "lint", "types", "docs", "packages"]
nox.options.error_on_external_run = True

ROOT = Path(__file__).parent
PROJECT = nox.project.load_toml(ROOT / "pyproject.toml")
EXTRAS = "[cli,plot]"

PROCESSORS = os.cpu_count() or 1

# Number of test processes: one more than there are processors, because many tests wait for a third of their time. At
# most four, because the simulators and streams of a process start their own threads, and tests of periods need some
# free processor time.
PARALLEL = (f"-n{min(PROCESSORS + 1, 4)}", "--dist=worksteal")

# Environment of the test processes.
# PYTHONDONTWRITEBYTECODE: hundreds of tests start an interpreter. If the environment forbids bytecode files, each
# interpreter compiles every module again, which takes a fifth of the time of all tests.
# OPENBLAS_NUM_THREADS: numpy would compute large matrices in as many threads as there are processors. These threads
# wait for each other in busy loops. While other test processes run, a fit then takes four times the processor time.
LEAN = {"PYTHONDONTWRITEBYTECODE": None, "OPENBLAS_NUM_THREADS": "1"}

#: Checks that `nox -s tests` leaves out, and the commands that run them.
NOT_RUN = (
    "not run: slow tests (nox -s slow), the packages below packages/ (nox -s packages), style, types and documentation "
    "(nox -s lint types docs), clients of other projects (nox -s interop), and the long checks (nox -f nightly.py -l)"
)


#: The packages in packages/ that need no middleware. Every session that runs tests installs them, and their tests run
#: together with the tests of the library.
LIGHT = ("accept", "compat", "view")
#: Folders with tests. The folder with the longest tests is first, so that they do not run alone at the end.
TESTED = (*(f"packages/{each}" for each in LIGHT), "tests")
#: Options of pytest for the examples in pages and docstrings, and the places of these examples.
DOCTESTS = ("--doctest-modules", "--doctest-glob=*.md", "--ignore=docs/conf.py")
EXAMPLES = ("src", "docs", "README.md")


#: Requirements to build the distributions of this repository, also in editable mode. A session installs them once. In
#: build isolation, pip would install them again for each distribution, which takes 3 s of processor time.
BUILD = (*PROJECT["build-system"]["requires"], "editables")
UNISOLATED = "--no-build-isolation"


def install(session: nox.Session, *requirements: str, extras: str = EXTRAS) -> None:
    """Install the library and the `LIGHT` packages in editable mode, and other requirements."""
    session.install(*BUILD)
    session.install(UNISOLATED, "-e", f".{extras}", *requirements)
    # Without their requirements: the library is already installed, and tests that need viser are skipped without it.
    session.install(UNISOLATED, "--no-deps", *(word for each in LIGHT for word in ("-e", f"./packages/{each}")))


def group(*names: str) -> tuple[str, ...]:
    """The requirements of the named dependency groups."""
    return nox.project.dependency_groups(PROJECT, *names)


def present(*paths: str) -> list[str]:
    """Return the paths that exist."""
    return [path for path in paths if (ROOT / path).exists()]


@nox.session
def tests(session: nox.Session) -> None:
    """Run the tests that are not slow, and the examples in docstrings, docs and README. Run it after every change."""
    install(session, *group("tests"))
    if not session.posargs and not any((ROOT / "tests").glob("__pycache__/*pytest*")):
        session.log("preparing the tests for the first run; this takes about 10 s")
        _rewrite_asserts(session)
    # A single pytest run, so that its last line is the result of all tests.
    everything = [
        *PARALLEL,
        "--durations=10",
        *DOCTESTS,
        "-m",
        "not slow",
        # The examples include some of the longest tests, which would run alone at the end if they came last.
        *present(*EXAMPLES, *TESTED),
    ]
    session.run("pytest", *(session.posargs or everything), env=LEAN)
    if not session.posargs:
        session.log(NOT_RUN)


def _rewrite_asserts(session: nox.Session) -> None:
    """Let pytest rewrite and store every test module, with one process for each processor.

    This takes 16 s of processor time. In a fresh clone, each process of the test run would do all of it.
    """
    modules = sorted(str(path) for folder in TESTED for path in (ROOT / folder).rglob("test_*.py"))
    shares = [modules[first::PROCESSORS] for first in range(PROCESSORS)]
    environment = {key: value for key, value in os.environ.items() if key not in LEAN}
    command = [f"{session.bin}/python", "-m", "pytest", "--collect-only", "-qq"]
    processes = [subprocess.Popen([*command, *share], env=environment, stdout=subprocess.DEVNULL) for share in shares]
    for process in processes:
        process.wait(timeout=600)


@nox.session
def slow(session: nox.Session) -> None:
    """Run the tests that take a fifth of a second of processor time or more. Run it before you commit."""
    install(session, *group("tests"))
    session.run("pytest", *PARALLEL, "-m", "slow", *(session.posargs or TESTED), env=LEAN)


@nox.session
def lint(session: nox.Session) -> None:
    """Check style, format, and imports between modules. Run it before you commit; `ruff format` corrects the format."""
    session.install(*group("lint"))
    session.run("ruff", "check", *session.posargs, ".")
    session.run("ruff", "format", "--check", ".")
    session.run("lint-imports", env={"PYTHONPATH": "src"})


@nox.session
def types(session: nox.Session) -> None:
    """Check the types of the packages, the tests and the benchmarks. Run it before you commit."""
    install(session, *group("types"))
    session.run("mypy", *(session.posargs or present("src", "tests", "benchmarks", "packages")))
    if not session.posargs:
        # Checks what the type checkers of users see: the asyncio interface has the types of the blocking interface.
        session.run("pytest", "-q", "tests/urlink/aio/test_surface.py")
        # Finds uses of a standard library that is newer than the oldest supported Python. With that Python, the types
        # of a newer numpy are Any, so this run is separate and less strict about Any.
        oldest = ["--python-version=3.10", "--no-warn-return-any", "--no-warn-unused-ignores"]
        session.run("mypy", *oldest, "src")


@nox.session
def docs(session: nox.Session) -> None:
    """Build the documentation into docs/_build/html. Run it after changing a page; a warning is an error."""
    install(session, *group("docs"))
    session.run("python", "docs/make_tables.py", "--check")
    # -E: read unchanged pages again; otherwise their warnings would appear only once.
    session.run("sphinx-build", "-W", "--keep-going", "-E", *session.posargs, "-b", "html", "docs", "docs/_build/html")


@nox.session
def bench(session: nox.Session) -> None:
    """Run every benchmark, quickly unless arguments are given. Run it after changing code that runs for each packet."""
    install(session)
    # A module with a leading underscore is shared by the benchmarks, and is not a benchmark itself.
    scripts = sorted(path for path in Path("benchmarks").glob("*.py") if not path.name.startswith("_"))
    if not scripts:
        session.error("there is no benchmark in benchmarks/")
    for script in scripts:
        session.run("python", str(script), *(session.posargs or ["--quick"]))


@nox.session
def interop(session: nox.Session) -> None:
    """Test the simulator with clients of other projects. Run it after changing the simulator or a protocol."""
    install(session, *group("tests", "interop"))
    # urx calls Condition.notifyAll in its receiving threads. As an error, the warning would end these threads.
    session.run(
        "pytest",
        "-W",
        "ignore:notifyAll:DeprecationWarning",
        *(session.posargs or ["tests/interop"]),
    )


#: A compiled client for the tests of a package, if there is a wheel.
UR_RTDE = "ur_rtde==1.6.5; python_version < '3.13' and sys_platform == 'linux' and platform_machine == 'x86_64'"

#: Packages whose middleware is one or two packages, and additional requirements of their tests.
PACKAGES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(LIGHT, ()),
    "mujoco": (UR_RTDE,),
    "mqtt": (),
    "opcua": (),
    "mcp": (),
    "files": (),
    "gym": ("./packages/mujoco", "openpi-client==0.1.2; python_version < '3.13'"),
    "prometheus": (),
    "rr": (),
    "zenoh": ("jsonschema",),
}


def distributions() -> dict[str, Path]:
    """Map the library (as "") and the packages to their folders."""
    return {"": ROOT, **{path.parent.name: path.parent for path in sorted(ROOT.glob("packages/*/pyproject.toml"))}}


def build_wheels(session: nox.Session, place: Path) -> dict[str, Path]:
    """Build the wheels of the library (as "") and of every package in an empty folder; map the packages to the wheels.

    The environment of the session must contain `BUILD`.
    """
    shutil.rmtree(place, ignore_errors=True)
    folders = distributions()
    command = ("python", "-m", "pip", "wheel", "-q", "--no-deps", UNISOLATED, f"--wheel-dir={place}")
    session.run(*command, *map(str, folders.values()))
    names = {key: nox.project.load_toml(path / "pyproject.toml")["project"]["name"] for key, path in folders.items()}
    return {key: next(place.glob(f"{name.replace('-', '_')}-*.whl")) for key, name in names.items()}


def new_environment(session: nox.Session, place: Path) -> str:
    """Create an empty environment in a folder, and return its Python. The pip of the session installs into it."""
    session.run("python", "-m", "venv", "--clear", "--without-pip", str(place))
    return str(next(path for path in (place / "bin/python", place / "Scripts/python.exe") if path.exists()))


@nox.session
def packages(session: nox.Session) -> None:
    """Install and test each package of `PACKAGES` alone. Run it after changing one of packages/: ``-- accept mqtt``.

    It builds every package, and leaves out tests whose middleware cannot be installed here.
    """
    place = Path(session.create_tmp()).resolve()
    session.install(*BUILD)
    wheels = build_wheels(session, place / "wheels")
    for package in session.posargs or PACKAGES:
        # A separate environment, which shows whether a package needs another package.
        python = new_environment(session, place / package)
        ours = (f"{wheels['']}{EXTRAS}", str(wheels[package]), *PACKAGES[package], *group("tests"))
        try:
            session.run("python", "-m", "pip", "--python", python, "install", "-q", *ours)
        except CommandFailed:
            if package in LIGHT:
                raise
            session.warn(f"packages/{package} cannot be installed here; its tests are left out")
            continue
        # The tests of `LIGHT` packages use the fixtures of the library's own tests.
        own = () if package in LIGHT else ("--confcutdir=packages",)
        tests = f"packages/{package}/tests"
        session.run(python, "-m", "pytest", *PARALLEL, *own, tests, env=LEAN, external=True)


@nox.session
def ursim(session: nox.Session) -> None:
    """Run `urlink accept` on any controller, without moving its arm. Run it with URSim or a robot: ``-- ADDRESS``.

    ``-- ADDRESS --start`` powers the arm on first and releases its brakes, which URSim needs. Other arguments are
    options of `urlink accept`, for example ``--stage 0 --yes``; without any, it runs the stages 0 and 1.
    """
    if not session.posargs:
        session.error("give the address of a controller: nox -s ursim -- 192.168.56.101")
    address, *options = session.posargs
    install(session)
    if "--start" in options:
        options.remove("--start")
        _start(session, address)
    # It reports a controller in local control as a fault, although URSim accepts commands in that mode.
    session.run("urlink", "doctor", address, success_codes=[0, 1])
    chosen = options if "--stage" in options else [*options, "--stage", "0", "--stage", "1", "--yes"]
    session.run("urlink", "accept", address, *chosen)


def _start(session: nox.Session, address: str) -> None:
    """Power an arm on and release its brakes. Try for five minutes, because URSim takes one or two to start."""
    for _ in range(60):
        try:
            session.run("urlink", "dashboard", address, "start")
            return
        except CommandFailed:
            time.sleep(5)
    session.error(f"{address} did not power the arm on within five minutes")


@nox.session(reuse_venv=False)
def wheel(session: nox.Session) -> None:
    """Run the tests against the wheel that users get. Run it before a release."""
    dist = Path(session.create_tmp()).resolve() / "dist"
    session.install("build", "twine", "check-wheel-contents")
    session.run("python", "-m", "build", "--wheel", "--outdir", str(dist))
    (built,) = dist.glob("*.whl")
    session.run("twine", "check", "--strict", str(built))
    session.run("check-wheel-contents", str(built))
    session.install(f"{built}{EXTRAS}", *group("tests"))
    session.install("--no-deps", *(f"./packages/{each}" for each in LIGHT))
    packages = sorted(path.parent.name for path in ROOT.glob("src/*/__init__.py"))
    # From here on, src/ must not be importable.
    session.chdir(dist)
    session.run(
        "python",
        "-c",
        "import importlib, sys\n"
        "for name in sys.argv[1:]:\n"
        "    path = importlib.import_module(name).__file__\n"
        "    assert path.startswith(sys.prefix), f'{name} comes from {path}, not from the wheel'",
        *packages,
    )
    config = ["-c", str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT)]
    session.run("pytest", *config, *(session.posargs or [*PARALLEL, *(str(ROOT / each) for each in TESTED)]))


#: What `nox -s release` does not install or run, and why.
TOO_LARGE = {"lerobot": "LeRobot with torch takes 4 GB; nox -f nightly.py -s lerobot tests it"}
EXAMPLE_NEEDS = {
    "files": "a controller with SSH; nox -s packages -- files tests it",
    "ros2": "an installed ROS 2; nox -f nightly.py -s ros2 tests it",
}


@nox.session(reuse_venv=False)
def release(session: nox.Session) -> None:
    """Build and check everything that a release uploads, without uploading. Run it before a release: ``-- mqtt view``.

    It builds the wheel and the source distribution of the library and of every package, with the version of
    CHANGELOG.md, into ``dist``. Then it installs each wheel in its own environment, and runs the first example of its
    README there. Arguments name the packages to install; without any, it installs all. On a commit with a tag, it also
    checks that the tag and the changelog agree, and that the release has a date.
    """
    version, date = _released()
    tag = session.run("git", "tag", "--points-at", "HEAD", "--list", "v*", external=True, silent=True) or ""
    if tag.strip() and (tag.split() != [f"v{version}"] or date == "unreleased"):
        session.error(f"the commit has the tag {tag.strip()}, but CHANGELOG.md has {version} - {date}")
    projects = {path: nox.project.load_toml(path / "pyproject.toml")["project"] for path in distributions().values()}
    if lacking := [str(path) for path, project in projects.items() if not project.get("urls")]:
        (session.error if tag.strip() else session.warn)(f"no [project.urls] in the pyproject.toml of {lacking}")
    dist = ROOT / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    session.install("build", "twine", "check-wheel-contents", *BUILD)
    built = {}
    for package, folder in distributions().items():
        place = dist / (package or "urlink")
        pretended = {} if tag.strip() else {"SETUPTOOLS_SCM_PRETEND_VERSION": version}
        session.run("python", "-m", "build", "-q", "--no-isolation", "-o", str(place), str(folder), env=pretended)
        built[package] = next(place.glob("*.whl"))
        if built[package].name.split("-")[1] != version:
            session.error(f"{built[package].name} does not have the version {version} of CHANGELOG.md")
        session.run("twine", "check", "--strict", *map(str, place.iterdir()))
        # The library consists of several packages, each of the others of one.
        config = ("--no-config",) if package else ()
        session.run("check-wheel-contents", *config, str(built[package]))
    results = {each: _tried(session, each, built) for each in session.posargs or sorted(built.keys() - {""})}
    for package, result in results.items():
        session.log(f"{package:12} {result}")
    if failed := [package for package, result in results.items() if result.startswith("FAILED")]:
        session.error(f"{', '.join(failed)} cannot be released")


def _released() -> tuple[str, str]:
    """Return the newest version of CHANGELOG.md, and its date or "unreleased"."""
    found = re.search(r"(?m)^## \[(\d+\.\d+\.\d+)\] - (.+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"))
    if found is None:
        raise LookupError("CHANGELOG.md has no heading such as '## [0.1.0] - unreleased'")
    return found[1], found[2]


def _tried(session: nox.Session, package: str, built: dict[str, Path]) -> str:
    """Install the wheels of the library and of a package in a new environment, and run its first example."""
    python = new_environment(session, Path(session.create_tmp()).resolve() / package)
    pip = ("python", "-m", "pip", "--python", python)
    try:
        session.run(*pip, "install", "-q", f"{built['']}[cli]")
        if package in TOO_LARGE:
            session.run(*pip, "install", "-q", "--no-deps", str(built[package]))
            return f"installed without its requirements: {TOO_LARGE[package]}"
        session.run(*pip, "install", "-q", str(built[package]))
        session.run(*pip, "check")
        if package in EXAMPLE_NEEDS:
            return f"installed; its first example needs {EXAMPLE_NEEDS[package]}"
        session.run(python, ".ci/first_example.py", f"packages/{package}", external=True)
    except CommandFailed:
        return "FAILED"
    return "installed; its first example runs"


@nox.session(reuse_venv=False)
def new_user(session: nox.Session) -> None:
    """Do the tasks of a new user with only the examples of the pages. Run it after changing pages for beginners."""
    session.install(".")
    session.run("python", "-m", "tests.new_user", *session.posargs)


@nox.session(reuse_venv=False)
def sdist(session: nox.Session) -> None:
    """Run the tests from the unpacked source distribution. Run it before a release."""
    dist = Path(session.create_tmp()).resolve() / "sdist"
    session.install("build", "twine", "check-wheel-contents")
    # Build a wheel too; `build` makes it from the source distribution.
    session.run("python", "-m", "build", "--outdir", str(dist))
    (packed,) = dist.glob("*.tar.gz")
    session.run("twine", "check", "--strict", *map(str, dist.iterdir()))
    session.run("check-wheel-contents", *map(str, dist.glob("*.whl")))
    shutil.unpack_archive(packed, dist, filter="data")
    session.chdir(dist / packed.name.removesuffix(".tar.gz"))
    session.install(f".{EXTRAS}", *group("tests"))
    session.install("--no-deps", *(f"./packages/{each}" for each in LIGHT))
    session.run("pytest", *(session.posargs or [*PARALLEL, *TESTED]))
