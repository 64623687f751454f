"""The envelope, and the messages that every service understands: handshake, health, errors."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from shared.protocol.base import PROTOCOL_VERSION, Message, Name


class Hello(Message):
    """First message on a connection: who connects and what it needs."""

    type: ClassVar[str] = "Hello"
    client: str = "motionloop"
    protocol_version: int = PROTOCOL_VERSION
    skeleton: str = "human22"
    plugin: Name | None = None


class Welcome(Message):
    """Reply to Hello: service, plug-ins it offers with their specs (as JSON objects), the default one's name."""

    type: ClassVar[str] = "Welcome"
    service: Literal["planner", "tracker"]
    version: str
    protocol_version: int = PROTOCOL_VERSION
    instance_id: str
    default_plugin: Name
    plugins: list[dict[str, object]]
    state_endpoint: str | None = None


class Health(Message):
    """Ask how the service is."""

    type: ClassVar[str] = "Health"


class HealthReport(Message):
    """Reply to Health."""

    type: ClassVar[str] = "HealthReport"
    status: Literal["ok", "degraded"]
    uptime_s: float
    detail: dict[str, float | int | str] = {}


class ErrorReply(Message):
    """Reply to any request that could not be carried out; nothing was changed."""

    type: ClassVar[str] = "ErrorReply"
    code: str
    message: str
    retryable: bool = False
    field: str | None = None
    allowed: str | None = None


class Ok(Message):
    """Reply to a request that has nothing to return."""

    type: ClassVar[str] = "Ok"


class Envelope(BaseModel):
    """Header common to all messages; travels as the JSON part together with the non-array fields of the body.

    Attributes:
        message_id: repeating it returns the first reply.
        deadline_unix_s: the sender stops waiting then; an expired request is dropped, not computed.
        sequence: per character, counts up.
        instance_id: in a request, the life of the service that was shaken hands with; in a reply, the present one.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    protocol_version: int = PROTOCOL_VERSION
    type: str
    message_id: Annotated[str, Field(min_length=8, max_length=64)]
    character_id: Annotated[str, Field(max_length=64)] | None = None
    sequence: int = 0
    deadline_unix_s: float | None = None
    trace_id: Annotated[str, Field(max_length=64)] | None = None
    instance_id: Annotated[str, Field(max_length=64)] | None = None
