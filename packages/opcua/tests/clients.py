"""Clients of the tests, and their certificates."""

from __future__ import annotations

import asyncio
import contextlib
import datetime
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

T = TypeVar("T")

PASSWORD = "long enough for this"


class Keys(NamedTuple):
    """Files of a certificate and its private key."""

    certificate: Path
    private_key: Path


def certificate(folder: Path, name: str, first: int, last: int, bits: int = 2048) -> Keys:
    """Make a certificate that is valid from `first` to `last`, in days from now."""
    key = rsa.generate_private_key(65537, bits)
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    now = datetime.datetime.now(datetime.timezone.utc)
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now + datetime.timedelta(days=first))
        .not_valid_after(now + datetime.timedelta(days=last))
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(f"urn:test:{name}")]), False)
        .sign(key, hashes.SHA256())
    )
    files = Keys(folder / f"{name}.pem", folder / f"{name}_key.pem")
    files.certificate.write_bytes(made.public_bytes(Encoding.PEM))
    files.private_key.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return files


@contextlib.asynccontextmanager
async def connected(
    url: str,
    keys: Keys | None = None,
    *,
    user: str | None = None,
    password: str | None = None,
    policy: Any = SecurityPolicyBasic256Sha256,
    user_keys: Keys | None = None,
) -> AsyncIterator[Client]:
    """Client that is connected to a server; encrypted if it has keys."""
    client = Client(url, timeout=60.0)
    client.session_timeout = 60_000
    if keys is not None:
        await client.set_security(policy, keys.certificate, keys.private_key)
    if user_keys is not None:
        await client.load_client_certificate(str(user_keys.certificate))
        await client.load_private_key(str(user_keys.private_key))
    if user is not None:
        client.set_user(user)
        client.set_password(password or "")
    async with client:
        yield client


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine, with a deadline."""

    async def limited() -> T:
        return await asyncio.wait_for(main, 120.0)

    return asyncio.run(limited())


async def read(client: Client, name: str) -> Any:
    return await client.get_node(f"ns=2;s=arm.{name}").read_value()


async def call(client: Client, name: str, *arguments: Any) -> int:
    """Call a method of the robot; return its status code."""
    request = ua.CallMethodRequest(
        ObjectId=ua.NodeId("arm", 2),
        MethodId=ua.NodeId(f"arm.{name}", 2),
        InputArguments=[ua.Variant(each) for each in arguments],
    )
    try:
        results = await client.uaclient.call([request])
    except ua.UaStatusCodeError as error:
        return int(error.code)
    return int(results[0].StatusCode.value)


async def write(client: Client, name: str, value: Any, variant: ua.VariantType) -> int:
    """Write a node of the robot; return the status code."""
    node = client.get_node(f"ns=2;s=arm.{name}")
    try:
        await node.write_value(ua.DataValue(ua.Variant(value, variant)))
    except ua.UaStatusCodeError as error:
        return int(error.code)
    return int(ua.StatusCodes.Good)


async def until(condition: Callable[[], Awaitable[object]], seconds: float = 60.0) -> None:
    end = asyncio.get_running_loop().time() + seconds
    while not await condition():
        assert asyncio.get_running_loop().time() < end, f"the condition did not become true within {seconds:g} s"
        await asyncio.sleep(0.01)
