"""Who may connect: loopback by default, CURVE keys for anything else (DESIGN 10)."""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import os
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zmq
import zmq.auth
import zmq.utils.z85
from zmq.auth.thread import ThreadAuthenticator

from shared.errors import InvalidInputError


@dataclass(frozen=True)
class CurveKeys:
    """Keys of one side, Z85 text. A server lists the public keys of its clients, a client knows the server's.

    Attributes:
        public, secret: own pair.
        peers: server: clients let in; client: one entry, the server's public key.
    """

    public: str
    secret: str
    peers: tuple[str, ...]


def load_curve_keys(folder: Path, side: str) -> CurveKeys:
    """Keys of `side` ("server" or "client") from a folder made by `create_curve_keys`."""
    other = {"server": "client", "client": "server"}[side]
    try:
        public, secret = zmq.auth.load_certificate(folder / f"{side}.key_secret")
        peer, _ = zmq.auth.load_certificate(folder / f"{other}.key")
    except (OSError, ValueError) as error:
        raise InvalidInputError(
            f"no CURVE keys for the {side} in {folder}: {error}",
            field="curve_dir",
            allowed="a folder made by `python -m shared.protocol.keys FOLDER`",
        ) from error
    if secret is None:
        raise InvalidInputError(f"{folder}/{side}.key_secret holds no secret key", field="curve_dir")
    return CurveKeys(public.decode(), secret.decode(), (peer.decode(),))


def curve_dir_from_environment() -> Path | None:
    """The folder of CURVE keys that services and clients of this machine share, MOTIONLOOP_CURVE_DIR."""
    name = os.environ.get("MOTIONLOOP_CURVE_DIR")
    return Path(name) if name else None


def client_curve_keys(folder: Path | None = None) -> CurveKeys | None:
    """The client's keys from `folder`, else from MOTIONLOOP_CURVE_DIR, else None."""
    folder = folder or curve_dir_from_environment()
    return load_curve_keys(folder, "client") if folder else None


def create_curve_keys(folder: Path) -> None:
    """Write one server pair and one client pair (server.key, server.key_secret, client.key, client.key_secret)."""
    folder.mkdir(parents=True, exist_ok=True)
    for side in ("server", "client"):
        _, secret = zmq.auth.create_certificates(folder, side)
        Path(secret).chmod(0o600)


def move_client_keys(folder: Path, other: Path) -> None:
    """Move the client's secret of `create_curve_keys` to another folder, and copy the public keys that it needs."""
    other.mkdir(parents=True, exist_ok=True)
    for name in ("client.key", "server.key"):
        shutil.copy(folder / name, other / name)
    secret = other / "client.key_secret"
    shutil.move(folder / "client.key_secret", secret)
    secret.chmod(0o600)


def is_local(endpoint: str) -> bool:
    """Whether only this machine can reach the endpoint."""
    scheme, _, rest = endpoint.partition("://")
    if scheme in ("inproc", "ipc"):
        return True
    return is_loopback(rest.rsplit(":", 1)[0].strip("[]"))


def is_loopback(host: str) -> bool:
    """Whether a host's name or address is this machine's own."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_bind(endpoint: str, curve: CurveKeys | None) -> None:
    """Refuse to listen beyond this machine without CURVE keys."""
    scheme = endpoint.partition("://")[0]
    if scheme not in ("tcp", "ipc", "inproc"):
        raise InvalidInputError(
            f"cannot listen on {endpoint!r}", field="endpoint", allowed="tcp://HOST:PORT, ipc://PATH, inproc://NAME"
        )
    if curve is None and not is_local(endpoint):
        raise InvalidInputError(
            f"{endpoint} can be reached from other machines, and no CURVE keys are set",
            field="endpoint",
            allowed="a loopback address, ipc or inproc; or set MOTIONLOOP_CURVE_DIR to a folder of keys",
        )


def wildcard_port(endpoint: str) -> str:
    """ZeroMQ's spelling of a free port: tcp://HOST:0 becomes tcp://HOST:*."""
    return endpoint[:-1] + "*" if endpoint.startswith("tcp://") and endpoint.endswith(":0") else endpoint


def bound_endpoint(socket: zmq.Socket[Any]) -> str:
    """Where a bound socket really listens."""
    name = socket.getsockopt(zmq.LAST_ENDPOINT)
    return name.decode().rstrip("\0") if isinstance(name, bytes) else str(name)


def secure_server(socket: zmq.Socket[Any], curve: CurveKeys | None) -> None:
    """Make a socket that is about to bind a CURVE server."""
    if curve is not None:
        socket.curve_publickey, socket.curve_secretkey = curve.public.encode(), curve.secret.encode()
        socket.curve_server = True
        socket.zap_domain = b"motionloop"


def secure_client(socket: zmq.Socket[Any], curve: CurveKeys | None) -> None:
    """Make a socket that is about to connect a CURVE client."""
    if curve is not None:
        socket.curve_publickey, socket.curve_secretkey = curve.public.encode(), curve.secret.encode()
        socket.curve_serverkey = curve.peers[0].encode()


class _AllowList:
    """ZAP credentials: the listed client keys."""

    def __init__(self, keys: Sequence[str]):
        self._keys = frozenset(key.encode() for key in keys)

    def callback(self, domain: str, key: bytes) -> bool:
        """Whether the Z85 key may connect (called by pyzmq's authenticator)."""
        return zmq.utils.z85.encode(key) in self._keys if len(key) == 32 else key in self._keys


def start_authenticator(context: zmq.Context[Any], curve: CurveKeys) -> ThreadAuthenticator:
    """The ZAP handler that lets in only the listed keys; one a context; stop it before ending the context."""
    authenticator = ThreadAuthenticator(context)
    authenticator.start()
    authenticator.configure_curve_callback(domain="motionloop", credentials_provider=_AllowList(curve.peers))
    return authenticator


@contextlib.contextmanager
def closed_on_error(socket: zmq.Socket[Any], own_context: zmq.Context[Any] | None) -> Iterator[None]:
    """Close a socket (and its maker's own context) if setting it up fails.

    A context that is left to the garbage collector with an open socket blocks whoever happens to collect it.

    Raises:
        InvalidInputError: the address given to the socket is none.
    """
    try:
        yield
    except BaseException as error:
        socket.close(linger=0)
        if own_context is not None:
            own_context.destroy(linger=0)
        if isinstance(error, zmq.ZMQError) and error.errno in (errno.EINVAL, errno.EPROTONOSUPPORT, errno.ENODEV):
            allowed = "tcp://HOST:PORT or ipc://PATH"
            raise InvalidInputError(f"no address of a service: {error}", field="endpoint", allowed=allowed) from error
        raise
