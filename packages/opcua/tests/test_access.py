"""Attacks and mistakes that the server must refuse, and the checks of its options."""

from __future__ import annotations

import argparse
import asyncio
import datetime
import socket
import time
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.common.connection import MessageChunk
from asyncua.crypto import uacrypto
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding

import urlink
from packages.opcua.tests.clients import PASSWORD, Keys, call, certificate, connected, read, run, write
from packages.opcua.tests.conftest import serving
from urlink_opcua import Access, Server, cli
from urlink_opcua.access import read_certificate, read_private_key

pytestmark = pytest.mark.real_time

GOOD = int(ua.StatusCodes.Good)
DENIED = int(ua.StatusCodes.BadUserAccessDenied)


async def may_command(client: Client) -> bool:
    """Whether a client may command; otherwise the server must deny every command."""
    statuses = [
        await call(client, "LoadProgram", "pick.urp"),
        await call(client, "StopProgram"),
        await write(client, "InputInteger24", 7, ua.VariantType.Int32),
    ]
    if statuses == [DENIED] * 3:
        return False
    # A stop takes longer if no program runs: it sends a script.
    assert statuses[0] == statuses[2] == GOOD
    assert statuses[1] in (GOOD, ua.StatusCodes.GoodCompletesAsynchronously)
    return True


@pytest.mark.parametrize(
    ("keys_of", "user", "password", "expected"),
    [
        ("client", None, None, True),
        ("stranger", "operator", PASSWORD, True),
        ("stranger", None, None, False),
        ("expired", None, None, False),
        ("later", None, None, False),
        (None, None, None, False),
    ],
)
def test_commands_need_credentials_and_encryption(
    server: Server, keys: dict[str, Keys], keys_of: str | None, user: str | None, password: str | None, expected: bool
) -> None:
    async def main() -> bool:
        chosen = None if keys_of is None else keys[keys_of]
        async with connected(server.url, chosen, user=user, password=password) as client:
            assert await read(client, "Model") == "UR5e"
            return await may_command(client)

    assert run(main()) == expected


def test_user_certificate_gives_permission(server: Server, keys: dict[str, Keys]) -> None:
    async def main() -> bool:
        async with connected(server.url, keys["stranger"], user_keys=keys["client"]) as client:
            return await may_command(client)

    assert run(main())


@pytest.mark.parametrize("name", ["stranger", "expired", "later"])
def test_unknown_or_invalid_user_certificate_is_refused(server: Server, keys: dict[str, Keys], name: str) -> None:
    async def main() -> None:
        async with connected(server.url, keys["stranger"], user_keys=keys[name]):
            pass

    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        run(main())


@pytest.mark.parametrize(
    ("user", "password"), [("operator", "wrong"), ("operator", ""), ("operator", PASSWORD + "x"), ("admin", PASSWORD)]
)
def test_wrong_password_is_refused(server: Server, keys: dict[str, Keys], user: str, password: str) -> None:
    async def main() -> None:
        async with connected(server.url, keys["client"], user=user, password=password):
            pass

    with pytest.raises(ua.uaerrors.BadUserAccessDenied):
        run(main())


def test_password_without_encryption_is_refused(server: Server) -> None:
    async def main() -> None:
        async with connected(server.url, user="operator", password=PASSWORD):
            pass

    with pytest.raises(ua.uaerrors.BadSecurityPolicyRejected):
        run(main())


def test_claimed_certificate_without_encryption_gives_nothing(
    server: Server, keys: dict[str, Keys], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The certificate of a trusted client is public. Only a signature proves its possession."""
    claimed = uacrypto.der_from_x509(read_certificate(str(keys["client"].certificate)))
    original = MessageChunk.message_to_chunks
    sent: list[bytes] = []

    def chunks(policy: Any, *args: Any, **kwargs: Any) -> Any:
        made = original(policy, *args, **kwargs)
        if kwargs["message_type"] == ua.MessageType.SecureOpen and not sent:  # the request, not the response
            made[0].SecurityHeader.SenderCertificate = claimed
            sent.append(claimed)
        return made

    monkeypatch.setattr(MessageChunk, "message_to_chunks", staticmethod(chunks))

    async def main() -> bool:
        async with connected(server.url) as client:
            return await may_command(client)

    assert not run(main())
    assert sent


def test_certificate_with_other_private_key_is_refused(server: Server, keys: dict[str, Keys]) -> None:
    async def main() -> None:
        stolen = Keys(keys["client"].certificate, keys["stranger"].private_key)
        client = Client(server.url, timeout=3.0)
        await client.set_security(SecurityPolicyBasic256Sha256, stolen.certificate, stolen.private_key)
        async with client:
            pass

    with pytest.raises((ConnectionError, TimeoutError, asyncio.TimeoutError, ua.UaError)):
        run(main())


@pytest.mark.parametrize("mode", [ua.MessageSecurityMode.None_, ua.MessageSecurityMode.Sign])
def test_channel_without_encryption_is_not_opened(
    server: Server, keys: dict[str, Keys], mode: ua.MessageSecurityMode
) -> None:
    """The client uses the policy and keys of an encrypted channel, but asks for less."""

    async def main() -> None:
        client = Client(server.url, timeout=3.0)
        await client.set_security(SecurityPolicyBasic256Sha256, keys["client"].certificate, keys["client"].private_key)
        client.security_policy.Mode = mode
        await client.connect()

    with pytest.raises((ConnectionError, TimeoutError, asyncio.TimeoutError, ua.UaError)):
        run(main())


def test_session_of_other_client_cannot_be_taken(server: Server, keys: dict[str, Keys]) -> None:
    """A failed login to the session of an operator must not give the rights of the operator."""

    async def main() -> None:
        async with connected(server.url, keys["client"]) as operator:
            token = operator.uaclient.protocol.authentication_token
            attacker = Client(server.url, timeout=60.0)
            await attacker.connect_socket()
            try:
                await attacker.send_hello()
                await attacker.open_secure_channel()
                attacker.uaclient.protocol.authentication_token = token
                params = ua.ActivateSessionParameters()
                params.UserIdentityToken = ua.UserNameIdentityToken(PolicyId="username", UserName="operator")
                for _ in range(2):
                    with pytest.raises(ua.uaerrors.BadSessionIdInvalid):
                        await attacker.uaclient.activate_session(params)
                assert await call(attacker, "LoadProgram", "pick.urp") == DENIED
            finally:
                attacker.disconnect_socket()
            assert await may_command(operator)

    run(main())


def test_session_loses_rights_after_failed_login(server: Server, keys: dict[str, Keys]) -> None:
    async def main() -> None:
        async with connected(server.url, keys["client"]) as client:
            assert await may_command(client)
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                await client.activate_session(username="operator", password="wrong")
            assert not await may_command(client)

    run(main())


def test_client_cannot_change_address_space(server: Server, keys: dict[str, Keys]) -> None:
    async def main() -> None:
        async with connected(server.url, keys["client"]) as client:
            with pytest.raises(ua.UaStatusCodeError):
                await client.nodes.objects.add_object(2, "mine")
            with pytest.raises(ua.UaStatusCodeError):
                await client.delete_nodes([client.get_node("ns=2;s=arm.Model")])
            node = client.get_node("ns=2;s=arm.InputInteger24")
            with pytest.raises(ua.uaerrors.BadWriteNotSupported):
                await node.write_attribute(ua.AttributeIds.DisplayName, ua.DataValue(ua.LocalizedText("x")))

    run(main())


def test_server_keeps_serving_after_nonsense(server: Server) -> None:
    host, port = "127.0.0.1", server.port
    for data in (
        b"GET / HTTP/1.1\r\n\r\n",
        b"OPNF\xff\xff\xff\x7f" + b"x" * 100,
        b"\x00" * 4096,
        b"HELF\x08\x00\x00\x00",
    ):
        with socket.create_connection((host, port), 10.0) as raw:
            raw.sendall(data)

    async def main() -> str:
        async with connected(server.url) as client:
            return str(await read(client, "Model"))

    assert run(main()) == "UR5e"


@pytest.mark.slow
def test_slow_client_is_disconnected_and_delays_nothing(server: Server, robot: urlink.Robot) -> None:
    """A client that sends requests and never reads the answers."""

    async def main() -> None:
        async with connected(server.url) as client:
            transport = client.uaclient.protocol.transport
            node = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)
            transport.pause_reading()
            params = ua.ReadParameters()
            params.NodesToRead = [ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.Value)] * 2000
            tasks = [asyncio.create_task(client.uaclient.read(params)) for _ in range(400)]
            before = robot.realtime.stats
            end = time.monotonic() + 60.0
            while server._server.iserver.asyncio_transports and time.monotonic() < end:
                await asyncio.sleep(0.05)
            assert not server._server.iserver.asyncio_transports
            after = robot.realtime.stats
            assert after.received > before.received
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    run(main())


@pytest.mark.slow
def test_anonymous_clients_are_refused_on_request(robot: urlink.Robot, keys: dict[str, Keys]) -> None:
    trusted = [read_certificate(str(keys["client"].certificate))]

    async def main(server: Server) -> None:
        for name in (None, "stranger"):
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                async with connected(server.url, None if name is None else keys[name]):
                    pass
        async with connected(server.url, keys["client"]) as client:
            assert await may_command(client)

    with serving(robot, keys, Access(trusted, anonymous=False), allow=True) as server:
        run(main(server))


# -- options -------------------------------------------------------------------------------------------


def parsed(*argv: str, read_only: bool = False) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    cli.add_arguments(parser)
    return parser.parse_args(argv, argparse.Namespace(read_only=read_only))


def refused(*argv: str, read_only: bool = False) -> str:
    with pytest.raises(urlink.BadValue) as caught, cli.serve({}, parsed(*argv, "--port", "0", read_only=read_only)):
        pass
    return str(caught.value)


def test_options_that_do_not_fit_are_refused(
    keys: dict[str, Keys], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("URLINK_OPCUA_PASSWORD", raising=False)
    server = ("--certificate", str(keys["server"].certificate), "--private-key", str(keys["server"].private_key))
    assert "commands need encryption" in refused("--allow")
    assert "commands need credentials" in refused("--allow", *server)
    assert "contradict" in refused("--allow", read_only=True)
    assert "belong together" in refused(*server[:2])
    assert "set the environment variable URLINK_OPCUA_PASSWORD" in refused("--user", "operator")
    monkeypatch.setenv("URLINK_OPCUA_PASSWORD", "short")
    assert "at least 12" in refused("--user", "operator")
    assert "no client could log in" in refused("--no-anonymous")
    assert "rate=100.0; expected 0.1 to 50" in refused("--rate", "100")
    other = str(keys["client"].private_key)
    assert "does not belong to the certificate" in refused(*server[:2], "--private-key", other)
    expired = ("--certificate", str(keys["expired"].certificate), "--private-key", str(keys["expired"].private_key))
    assert "expected one that is valid now" in refused(*expired)
    assert "cannot read" in refused("--trust", str(folder / "absent.pem"))


def test_files_of_other_kinds_are_refused(keys: dict[str, Keys], folder: Path) -> None:
    (folder / "text.pem").write_text("no certificate")
    with pytest.raises(urlink.BadValue, match="contains no certificate"):
        read_certificate(str(folder / "text.pem"))
    own = read_certificate(str(keys["server"].certificate))
    with pytest.raises(urlink.BadValue, match="contains no private key"):
        read_private_key(str(folder / "text.pem"), own)
    small = certificate(folder, "small", -1, 1, bits=1024)
    with pytest.raises(urlink.BadValue, match="at least 2048 bits"):
        read_certificate(str(small.certificate))
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([])
    now = datetime.datetime.now(datetime.timezone.utc)
    made = x509.CertificateBuilder(name, name, key.public_key(), 1, now, now + datetime.timedelta(1))
    (folder / "curve.der").write_bytes(made.sign(key, hashes.SHA256()).public_bytes(Encoding.DER))
    with pytest.raises(urlink.BadValue, match="RSA"):
        read_certificate(str(folder / "curve.der"))


def test_port_in_use_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as used:
        port = used.getsockname()[1]
        with pytest.raises(urlink.ConnectFailed, match=f"cannot listen at 127.0.0.1:{port}"):
            Server({}, port=port)


def test_server_is_only_on_this_computer_by_default() -> None:
    args: Any = parsed()
    assert (args.listen, args.allow, args.no_anonymous, args.port) == ("127.0.0.1", False, False, 4840)
