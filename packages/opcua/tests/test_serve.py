"""The command `urlink serve opcua`, and the example."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

import urlink
from packages.opcua.tests.clients import PASSWORD, Keys

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

EXAMPLE = Path(__file__).parents[1] / "examples" / "read_arm.py"


def test_example_reads_and_starts_program_of_served_robot(keys: dict[str, Keys]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = str(probe.getsockname()[1])
    environment = os.environ | {"URLINK_OPCUA_PASSWORD": PASSWORD}
    with urlink.simulator.Controller("UR5e", firmware="5.11") as controller:
        controller.pendant.files["pick.urp"] = "def pick():\n  sleep(600)\nend"
        command = [sys.executable, "-m", "urlink.cli", "serve", "opcua", f"arm={controller.address}", "--port", port]
        own = keys["server"]
        command += ["--allow", "--certificate", str(own.certificate), "--private-key", str(own.private_key)]
        command += ["--user", "operator"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == "serving arm over opcua; Ctrl-C ends it\n"

                def example(*argv: str) -> str:
                    url = f"opc.tcp://127.0.0.1:{port}/urlink/"
                    done = subprocess.run(
                        [sys.executable, str(EXAMPLE), "arm", "--url", url, *argv],
                        capture_output=True,
                        text=True,
                        env=environment,
                        timeout=120.0,
                        check=True,
                    )
                    return done.stdout

                assert re.fullmatch(r"arm: base at -?\d+\.\d+ degrees, NORMAL\n", example())
                client = keys["stranger"]
                secure = ["--certificate", str(client.certificate), "--private-key", str(client.private_key)]
                secure += ["--server-certificate", str(own.certificate)]
                assert "refused: " in example(*secure, "--play", "pick.urp")
                assert "pick.urp: started" in example(*secure, "--user", "operator", "--play", "pick.urp")
                process.send_signal(signal.SIGTERM)
                process.wait(60.0)
            finally:
                process.kill()
