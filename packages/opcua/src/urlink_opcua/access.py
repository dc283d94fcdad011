"""Access control: who may read, who may send commands, and what each kind of channel permits.

asyncua 2.1 alone would permit more. Each of these classes closes a gap, and a test attacks it:

- `NoSecurity`: on a channel without security, asyncua accepts the certificate that a client claims, without a proof.
- `ChannelRules`: asyncua permits methods and writes on a channel without security.
- `InternalServer.lookup_external_session`: a client can attach to the session of another client by its number. If its
  login fails, asyncua keeps the session attached, with the rights of the other client.
- `InternalServer.register_server`: any client could add entries to the list of servers.
"""

from __future__ import annotations

import dataclasses
import hmac
import logging
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Protocol

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import USER_TYPES, PermissionRuleset, User, UserRole
from asyncua.crypto.security_policies import SECURITY_POLICY_TYPE_MAP, SecurityPolicyFactory, SecurityPolicyNone
from asyncua.server.internal_server import InternalServer as AsyncuaInternalServer
from asyncua.server.internal_session import InternalSession
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat, load_pem_private_key

from urlink import BadValue

__all__ = [
    "POLICIES",
    "Access",
    "InternalServer",
    "Operator",
    "Session",
    "factories",
    "read_certificate",
    "read_private_key",
]

_log = logging.getLogger("urlink.opcua")

#: Smallest length of a password, because a client can try passwords without a limit.
_SHORTEST = 12

#: Channels that the server offers. Commands are only possible on an encrypted channel.
POLICIES = (
    ua.SecurityPolicyType.NoSecurity,
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
)
#: Requests that change something on the robot.
_COMMANDS = {ua.ObjectIds.CallRequest_Encoding_DefaultBinary, ua.ObjectIds.WriteRequest_Encoding_DefaultBinary}


@dataclasses.dataclass
class Operator(User):
    """Client that may send commands.

    Attributes:
        until: Time at which its certificate expires; None for a client with a password.
    """

    until: datetime | None = None

    @property
    def has_expired(self) -> bool:
        """Whether the certificate of the client has expired since the login."""
        return self.until is not None and datetime.now(timezone.utc) >= self.until


class Access:
    """Credentials with which a client may send commands; it is the user manager of asyncua.

    Args:
        trusted: Certificates of clients that may send commands.
        user: User name of clients that log in with a password; None for none.
        password: Password of this user, at least 12 characters.
        anonymous: Whether clients without credentials may read.

    Raises:
        BadValue: If only one of user and password is given, or the password is too short.
    """

    def __init__(
        self,
        trusted: Sequence[x509.Certificate] = (),
        user: str | None = None,
        password: str | None = None,
        *,
        anonymous: bool = True,
    ) -> None:
        if bool(user) != bool(password):
            raise BadValue(f"{'a password' if password else 'a user name'} is given alone; expected both or neither")
        if password and len(password) < _SHORTEST:
            raise BadValue(f"the password has {len(password)} characters; expected at least {_SHORTEST}")
        self._trusted = {each.public_bytes(Encoding.DER): each for each in trusted}
        self._login = None if user is None or password is None else (user.encode(), password.encode())
        self.anonymous = anonymous

    @property
    def permits_commands(self) -> bool:
        """Whether any client could have credentials."""
        return bool(self._trusted) or self._login is not None

    def trusts(self, certificate: bytes | None) -> bool:
        """Whether a certificate (DER) is one of the trusted ones, and is valid now."""
        known = None if certificate is None else self._trusted.get(certificate)
        if known is None:
            return False
        return bool(known.not_valid_before_utc <= datetime.now(timezone.utc) < known.not_valid_after_utc)

    def get_user(
        self,
        iserver: Any,
        username: str | None = None,
        password: str | None = None,
        certificate: bytes | None = None,
    ) -> User | None:
        """Return the user of a session, or None to refuse the login. asyncua calls this method.

        Args:
            iserver: Server of asyncua.
            username: User name, if the client logs in with a password.
            password: Password that the client sent.
            certificate: Certificate of the client (DER), whose private key the client has proved to own.
        """
        if username is not None:
            given = (username.encode(), (password or "").encode())
            # Compare both before the result is used, so that the duration reveals neither.
            matches = [hmac.compare_digest(*each) for each in zip(given, self._login or (b"", b""), strict=True)]
            is_right: bool = self._login is not None and all(matches)
            return Operator(UserRole.User, username) if is_right else None
        if certificate is not None:
            if not self.trusts(certificate):
                return None
            known = self._trusted[certificate]
            return Operator(UserRole.User, known.subject.rfc4514_string(), known.not_valid_after_utc)
        return User(UserRole.User, "anonymous") if self.anonymous else None


class NoSecurity(SecurityPolicyNone):
    """Channel without security. It ignores a certificate of the client, because nothing proves its possession."""

    def __init__(self, peer_cert: Any = None, *args: Any, **kwargs: Any) -> None:
        super().__init__(None, *args, **kwargs)


class ChannelRules(PermissionRuleset):
    """Requests that a channel permits.

    Args:
        commands: Whether the channel permits methods and writes.
    """

    def __init__(self, *, commands: bool) -> None:
        self._permitted = {ua.NodeId(each) for each in USER_TYPES if commands or each not in _COMMANDS}

    def check_validity(self, user: User, action_type_id: ua.NodeId, body: Any) -> bool:
        """Whether a request is permitted. asyncua calls this method."""
        return action_type_id in self._permitted


def factories(certificate: x509.Certificate | None, private_key: rsa.RSAPrivateKey | None) -> list[Any]:
    """Return the channels of `POLICIES`; without a certificate, only the channel without security."""
    made = [
        SecurityPolicyFactory(
            NoSecurity,
            ua.MessageSecurityMode.None_,
            certificate,
            private_key,
            permission_ruleset=ChannelRules(commands=False),
        )
    ]
    if certificate is not None:
        for policy in POLICIES[1:]:
            kind, mode, _ = SECURITY_POLICY_TYPE_MAP[policy]
            rules = ChannelRules(commands=True)
            made.append(SecurityPolicyFactory(kind, mode, certificate, private_key, permission_ruleset=rules))
    return made


class Requests(Protocol):
    """Object that executes the commands of clients."""

    def is_ready(self) -> bool:
        """Whether clients may log in."""

    async def call(self, session: Session, request: ua.CallMethodRequest) -> ua.CallMethodResult:
        """Execute a method."""

    async def write(self, session: Session, value: ua.WriteValue) -> ua.StatusCode:
        """Write an attribute."""


class Session(InternalSession):
    """Session of one client. Its commands go to `Requests`, which checks them."""

    iserver: InternalServer

    @property
    def client(self) -> str:
        """Address of the client, for messages."""
        return ":".join(map(str, self.name[:2])) if isinstance(self.name, tuple) else str(self.name)

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Log a client in. asyncua calls this method.

        Args:
            params: Credentials.
            peer_certificate: Certificate of the channel (DER); empty for a channel without security.

        Raises:
            ServiceError: If the credentials are refused.
        """
        if not self.iserver.requests.is_ready():
            raise ServiceError(ua.StatusCodes.BadServerHalted)
        # A failed login must not keep the rights of an earlier one.
        self.user = User(UserRole.Anonymous)
        token = params.UserIdentityToken
        is_named = isinstance(token, ua.UserNameIdentityToken | ua.X509IdentityToken)
        try:
            if is_named and not peer_certificate:
                raise ServiceError(ua.StatusCodes.BadSecurityPolicyRejected)
            if isinstance(token, ua.UserNameIdentityToken) and not token.UserName:
                raise ServiceError(ua.StatusCodes.BadIdentityTokenInvalid)
            if not is_named and not self.iserver.access.trusts(peer_certificate):
                # An unknown certificate encrypts the channel, but gives no rights.
                peer_certificate = None
            return super().activate_session(params, peer_certificate)
        except Exception as error:
            _log.warning("refused the login of %s: %s", self.client, error)
            raise

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Call methods, one after the other. asyncua calls this method."""
        return [await self.iserver.requests.call(self, each) for each in params]

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Write values, one after the other. asyncua calls this method."""
        return [await self.iserver.requests.write(self, each) for each in params.NodesToWrite]


class InternalServer(AsyncuaInternalServer):
    """Part of asyncua's server that makes sessions.

    Args:
        access: Credentials.
        requests: Object that executes commands.
    """

    def __init__(self, access: Access, requests: Requests) -> None:
        super().__init__(user_manager=access)
        self.access = access
        self.requests = requests
        self.allow_remote_admin = False
        self.max_connections = 100
        self.max_subscriptions = 200
        self.max_session_timeout_ms = 60_000.0
        self.max_monitored_item_queue_size = 100
        self.max_unacked_messages_per_subscription = 100
        self.max_pending_activation_seconds = 10.0

    def create_session(self, name: str, user: User | None = None, external: bool = False) -> InternalSession:
        """Make a session. asyncua calls this method."""
        user = User(UserRole.Anonymous) if user is None else user
        return Session(self, self.aspace, self.subscription_service, name, user=user, external=external)

    def lookup_external_session(self, auth_token: ua.NodeId) -> None:
        """Find no session of another connection: a client that reconnects must make a new session."""

    def register_server(self, server: Any, conf: Any = None) -> None:
        """Refuse to register a server.

        Raises:
            ServiceError: Always.
        """
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


def read_certificate(path: str) -> x509.Certificate:
    """Read a certificate from a file (PEM or DER).

    Raises:
        BadValue: If the file cannot be read, contains no certificate, or its certificate has no RSA key.
    """
    data = _read(path)
    load = x509.load_pem_x509_certificate if data.lstrip().startswith(b"-----") else x509.load_der_x509_certificate
    try:
        certificate = load(data)
        key = certificate.public_key()
    except ValueError as error:
        raise BadValue(f"{path} contains no certificate: {error}") from None
    if not isinstance(key, rsa.RSAPublicKey) or key.key_size < 2048:
        raise BadValue(f"the certificate {path} has another key; expected an RSA key of at least 2048 bits")
    return certificate


def read_private_key(path: str, certificate: x509.Certificate) -> rsa.RSAPrivateKey:
    """Read the private key of a certificate from a file (PEM, not encrypted).

    Raises:
        BadValue: If the file cannot be read, contains no such key, or the key does not belong to the certificate.
    """
    try:
        key = load_pem_private_key(_read(path), None)
    except (ValueError, TypeError) as error:
        raise BadValue(f"{path} contains no private key (PEM, not encrypted): {error}") from None

    def public(key: Any) -> bytes:
        return bytes(key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo))

    if not isinstance(key, rsa.RSAPrivateKey) or public(key.public_key()) != public(certificate.public_key()):
        raise BadValue(f"the private key {path} does not belong to the certificate")
    return key


def _read(path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise BadValue(f"cannot read {path}: {error.strerror}") from None
