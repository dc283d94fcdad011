"""Options of `urlink serve mqtt`."""

from __future__ import annotations

import argparse

import pytest

from urlink import BadValue
from urlink_mqtt import cli


def parsed(*argv: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    cli.add_arguments(parser)
    return parser.parse_args(argv)


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("broker.local", "broker.local", None),
        ("broker.local:1884", "broker.local", 1884),
        ("192.168.56.5:8883", "192.168.56.5", 8883),
        ("::1", "::1", None),
        ("[::1]", "::1", None),
        ("[fe80::1%eth0]:1884", "fe80::1%eth0", 1884),
    ],
)
def test_broker_address_is_parsed_with_and_without_port(text: str, host: str, port: int | None) -> None:
    assert parsed("--broker", text).broker == (host, port)


@pytest.mark.parametrize(
    "text", ["", "host:", "host:0", "host:65536", "host:x", "mqtt://host", "a:1:2", "user@host", "[::1"]
)
def test_broker_address_rejects_other_forms(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parsed("--broker", text)
    assert f"{text!r} is not the address of a broker; expected HOST or HOST:PORT" in capsys.readouterr().err


def test_serve_rejects_two_different_ports() -> None:
    with (
        pytest.raises(BadValue, match="names port 1884 and --port names port 1885"),
        cli.serve({}, parsed("--broker", "localhost:1884", "--port", "1885")),
    ):
        pass


def test_serve_accepts_port_in_broker_or_port_option(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[str, int | None]] = []
    monkeypatch.setattr(cli, "Broker", lambda host, port, *rest: made.append((host, port)))
    for argv in (["--broker", "a:1884"], ["--broker", "a", "--port", "1884"], ["--broker", "a:1884", "--port", "1884"]):
        with cli.serve({}, parsed(*argv)):
            pass
    assert made == [("a", 1884)] * 3
