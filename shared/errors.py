"""The error tree of motionloop.

::

    MotionLoopError                 code, retryable, field, allowed
    ├── InvalidInputError           a value the caller sent is wrong (HTTP 422)
    ├── NotFoundError               the named thing does not exist (HTTP 404)
    ├── ConflictError               the thing exists but is in the wrong state (HTTP 409)
    ├── OverloadedError             a bounded queue is full (HTTP 429/503)
    ├── IncompatiblePeerError       a handshake or conformance probe failed (HTTP 409)
    ├── TransportError
    │   ├── DeadlineError           no reply before the deadline (HTTP 504)
    │   ├── UnavailableError        the peer is not there (HTTP 503)
    │   ├── MalformedMessageError   bytes that do not decode
    │   └── HandshakeRequiredError  the peer was restarted; shake hands again (clients do so by themselves)
    └── SimulationError             physics or a plan produced non-finite values
"""

from __future__ import annotations


class MotionLoopError(Exception):
    """Base of every error motionloop raises on purpose.

    Args:
        message: what went wrong, in words a user can act on.
        field: the offending field in dotted form, if one is to blame.
        allowed: the allowed values or range, in words.
    """

    code = "internal"
    retryable = False

    def __init__(self, message: str, *, field: str | None = None, allowed: str | None = None):
        super().__init__(message)
        self.message = message
        self.field = field
        self.allowed = allowed


class InvalidInputError(MotionLoopError):
    """A value sent by the caller is outside what is allowed."""

    code = "invalid_input"


class NotFoundError(MotionLoopError):
    """The named thing does not exist."""

    code = "not_found"


class ConflictError(MotionLoopError):
    """The request is sound but the thing is in a state that forbids it."""

    code = "conflict"


class OverloadedError(MotionLoopError):
    """A bounded queue is full; trying again later may work."""

    code = "overloaded"
    retryable = True


class IncompatiblePeerError(MotionLoopError):
    """The peer speaks another protocol version, skeleton or rate."""

    code = "incompatible_peer"


class TransportError(MotionLoopError):
    """A message could not be exchanged."""

    code = "transport"
    retryable = True


class DeadlineError(TransportError):
    """No reply came before the deadline."""

    code = "deadline_exceeded"


class UnavailableError(TransportError):
    """The peer is not reachable."""

    code = "unavailable"


class MalformedMessageError(TransportError):
    """Bytes on the wire that are not a valid message."""

    code = "malformed_message"
    retryable = False


class HandshakeRequiredError(TransportError):
    """The request names another life of the service than the present one, or none."""

    code = "handshake_required"


class SimulationError(MotionLoopError):
    """Physics or a plan produced non-finite or exploding values."""

    code = "simulation"
