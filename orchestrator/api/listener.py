"""The socket of the HTTP server, and what to do where its port is taken."""

from __future__ import annotations

import errno
import socket

from shared.errors import ConflictError, InvalidInputError


def bind(host: str, port: int) -> socket.socket:
    """A socket bound to host and port (0 takes a free one), not listening yet.

    Raises:
        ConflictError: the port is taken.
        InvalidInputError: this machine has no such address, or the port may not be used.
    """
    try:
        family, kind, proto, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        raise InvalidInputError(f"{host!r} is no address of this machine: {error.strerror}", field="host") from error
    listener = socket.socket(family, kind, proto)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind(address)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            raise ConflictError(
                f"port {port} on {host} is taken by another program: end that one, or choose another port with --port "
                "(0 takes a free one)",
                field="port",
            ) from error
        raise InvalidInputError(f"cannot listen on {host}, port {port}: {error.strerror}", field="host") from error
    listener.set_inheritable(False)
    return listener


def check_port(host: str, port: int) -> None:
    """Raise as `bind` does; for telling so before anything is started."""
    bind(host, port).close()
