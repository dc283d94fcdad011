"""Completions in bash after it has executed the output of `completion`."""

from __future__ import annotations

import shutil
import subprocess

import pytest

import rhdlink.cli

from .conftest import Run


def completed(script: str, *words: str) -> set[str]:
    """Return the completions that bash offers for the last word."""
    asking = (
        f'COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _{words[0]}; printf "%s\\n" "${{COMPREPLY[@]}}"'
        if words
        else "true"
    )
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("bash is not installed")
    done = subprocess.run(
        [bash, "--norc", "-c", f"{script}\n{asking}", "bash", *words], capture_output=True, text=True, timeout=30
    )
    assert (done.returncode, done.stderr) == (0, "")
    return set(done.stdout.split())


@pytest.fixture
def script(run: Run) -> str:
    status, out, err = run("completion", "bash")
    assert (status, err) == (0, "")
    return out


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (("mon",), {"monitor"}),
        (("d",), {"doctor", "dashboard", "dissect"}),
        (("rtde", "host", "actual_TCP_p"), {"actual_TCP_pose"}),
        (("rtde", "host", "actual_q", "target_q"), {"target_q", "target_qd", "target_qdd"}),
        (("rtde", "host", "--dur"), {"--duration"}),
        (("echo", "host", "tcp_f"), {"tcp_force"}),
        (("echo", "host", "--interface", "re"), {"realtime"}),
        (("dashboard", "host", "unl"), {"unlock"}),
        (("completion", ""), {"bash", "zsh", "-h", "--help", "-v", "--verbose", "-q", "--quiet"}),
        (("record", "host", "a.urlog", "--count", ""), set()),
    ],
)
@pytest.mark.real_time
def test_bash_offers_completions(script: str, words: tuple[str, ...], offered: set[str]) -> None:
    assert completed(script, "urlink", *words) == offered


def test_zsh_script_contains_bash_script(run: Run, script: str) -> None:
    out = run("completion", "zsh")[1]
    assert out.endswith(script)
    assert "bashcompinit" in out.removesuffix(script)


@pytest.mark.real_time
def test_rhdlink_has_completion(capsys: pytest.CaptureFixture[str]) -> None:
    assert rhdlink.cli.main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    assert completed(script, "rhdlink", "mis") == {"mission"}
    assert completed(script, "rhdlink", "mission", "--profile", "") == {"mrc", "sound"}


@pytest.mark.parametrize(
    ("argv", "hint"),
    [
        (("moniter",), "unknown command 'moniter'; did you mean 'monitor'? the commands are monitor, "),
        (("xyzzy",), "unknown command 'xyzzy'; the commands are monitor, "),
        (("rtde", "sim://", "timestamp", "--fequency", "5"), "--fequency 5; did you mean '--frequency'?"),
        (("echo", "sim://", "--cuont=3"), "--cuont=3; did you mean '--count'?"),
    ],
)
def test_misspelt_words_get_a_hint(run: Run, argv: tuple[str, ...], hint: str) -> None:
    status, out, err = run(*argv)
    assert (status, out) == (2, "")
    assert hint in err
