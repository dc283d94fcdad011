"""Runs the first example of a package's README with the Python that runs this program; `nox -s release` uses it.

    python .ci/first_example.py packages/mqtt

An example consists of the commands in the first ``sh`` block, without the installation, and of the first ``python``
block, if the README has one. Addresses of robots are replaced by simulated robots. A command that serves robots runs
until the example has ended; another command must succeed within ten minutes. The working directory is a temporary
folder, so the package must be installed.
"""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

__all__ = ["commands", "main"]

ROOT = Path(__file__).resolve().parents[1]

#: Texts of the examples, and what runs here instead of them.
REPLACED = {
    # The other stages move a simulated arm for minutes.
    "urlink accept sim://ur5e": "urlink accept sim://ur5e --stage 0",
    "192.168.56.101": "sim://ur5e",
    "192.168.56.102": "sim://ur5e",
    "broker.local": "127.0.0.1",
    # The server itself listens, because no router of Zenoh is installed.
    "--connect tcp/fleet.local:7447": "--listen tcp/127.0.0.1:7447",
    "tcp/fleet.local:7447": "tcp/127.0.0.1:7447",
}

#: Files that an example reads, by name.
FILES = {"table.xml": ROOT / "packages/mujoco/tests/table.xml"}

#: Commands that run until they are interrupted.
SERVES = ("urlink serve ", "urlink sim ", "urlink view ", "mosquitto_sub ")
#: Programs of other projects, which are left out if they are not installed.
OTHERS = ("curl", "mosquitto_sub")
TIMEOUT = 600.0


def commands(readme: str) -> list[list[str]]:
    """Return the commands of the first example; a Python block is the command ``python -c``."""
    for text, other in REPLACED.items():
        readme = readme.replace(text, other)
    shell = re.search(r"(?ms)^```sh\n(.*?)^```$", readme)
    lines = shell[1].replace("\\\n", " ").splitlines() if shell else []
    found = [shlex.split(line, comments=True) for line in lines if not line.startswith("pip install")]
    if block := re.search(r"(?ms)^```python\n(.*?)^```$", readme):
        found.append(["python", "-c", block[1]])
    return [each for each in found if each]


def is_server(command: list[str]) -> bool:
    # The server of MCP ends with its standard input.
    return " ".join(command).startswith(SERVES) and "mcp" not in command


@contextlib.contextmanager
def broker() -> Iterator[None]:
    """Run a broker of MQTT on its usual port.

    Raises:
        SystemExit: If mosquitto is not installed.
    """
    program = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if program is None:
        raise SystemExit("the example needs a broker; install mosquitto")
    with subprocess.Popen([program], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            until_open(1883, process)
            yield
        finally:
            process.terminate()


def until_open(port: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until a process listens at a port of this computer."""
    end = time.monotonic() + 30.0
    while process.poll() is None and time.monotonic() < end:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(0.1)
    raise SystemExit(f"{process.args!r} does not listen at port {port}")


@contextlib.contextmanager
def served(command: list[str]) -> Iterator[None]:
    """Run a command that serves robots until the block ends; it must then end without an error.

    Raises:
        SystemExit: If the command ends too early, does not serve within `TIMEOUT`, or fails.
    """
    is_ready = threading.Event()

    def read(lines: Iterable[str]) -> None:
        for line in lines:
            print(line, end="", flush=True)
            if "Ctrl-C" in line or command[0] in OTHERS:
                is_ready.set()

    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, text=True, **both) as process:
        assert process.stdout is not None
        reader = threading.Thread(target=read, args=(process.stdout,), daemon=True)
        reader.start()
        try:
            end = time.monotonic() + TIMEOUT
            while not is_ready.wait(0.1):
                if process.poll() is not None or time.monotonic() > end:
                    raise SystemExit(f"{shlex.join(command)} did not start")
            yield
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(60.0)
            except subprocess.TimeoutExpired:
                process.kill()
            reader.join(60.0)
    # Most programs report the signal that ended them.
    if process.returncode not in (0, 128 + signal.SIGINT, -signal.SIGINT):
        raise SystemExit(f"{shlex.join(command)} ended with status {process.returncode}")


def main(folder: str) -> None:
    """Run the first example of a package.

    Raises:
        SystemExit: If a command fails; the message names the command.
    """
    readme = (ROOT / folder / "README.md").read_text(encoding="utf-8")
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    if sys.platform == "linux":
        os.environ.setdefault("MUJOCO_GL", "egl")  # MuJoCo draws without a screen
    with contextlib.ExitStack() as stack:
        place = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        # The commands name the examples of the packages as in a checkout.
        (place / "packages").symlink_to(ROOT / "packages")
        for name, path in FILES.items():
            shutil.copy(path, place / name)
        os.chdir(place)
        stack.callback(os.chdir, ROOT)
        if "--broker" in readme:
            stack.enter_context(broker())
        found = commands(readme)
        if not found:
            raise SystemExit(f"{folder}/README.md has no example")
        for command in found:
            if command[0] in OTHERS and shutil.which(command[0]) is None:
                print("left out, because the program is not installed:", shlex.join(command), flush=True)
                continue
            print("+", shlex.join(command), flush=True)
            if is_server(command):
                stack.enter_context(served(command))
                continue
            # A program that waits for a key goes on.
            done = subprocess.run(command, input=b"\n", timeout=TIMEOUT, check=False)
            if done.returncode:
                raise SystemExit(f"{shlex.join(command[:2])} failed with status {done.returncode}")


if __name__ == "__main__":
    main(sys.argv[1])
