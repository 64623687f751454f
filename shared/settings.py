"""Settings: pydantic models filled from the command line, then the environment, then defaults.

A field `max_batch` of a model with prefix `MOTIONLOOP_PLANNER_` is `--max-batch` on the command line and
`MOTIONLOOP_PLANNER_MAX_BATCH` in the environment. Lists are written with commas.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from shared.protocol.errors import invalid_input_from
from shared.protocol.security import CurveKeys, check_bind, load_curve_keys
from shared.tracing import LogFormat

S = TypeVar("S", bound="Settings")


class Settings(BaseModel):
    """Base of all settings: immutable, no unknown names."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    env_prefix: ClassVar[str] = "MOTIONLOOP_"


class ServiceSettings(Settings):
    """What every ZeroMQ service can be told.

    Attributes:
        endpoint: where to listen; beyond this machine only with CURVE keys.
        workers: threads that handle requests.
        max_pending: requests under way before new ones are refused as overloaded.
        curve_dir: folder of CURVE keys (`python -m shared.protocol.keys FOLDER`), or None.
        log_level: of the process; debug has a line for every message.
        log_format: lines for people, or JSON with the trace id (docs/operations.md).
        metrics_port: of loopback, where Prometheus finds the service's numbers; 0 takes a free one, None serves none.
    """

    endpoint: str
    workers: Annotated[int, Field(ge=1, le=64)] = 4
    max_pending: Annotated[int, Field(ge=1, le=10_000)] = 256
    curve_dir: Path | None = Field(default_factory=lambda: curve_dir_from_environment())
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: LogFormat = "text"
    metrics_port: Annotated[int, Field(ge=0, le=65535)] | None = None

    @model_validator(mode="after")
    def _safe_to_listen(self) -> ServiceSettings:
        check_bind(self.endpoint, self.curve_keys())
        return self

    def curve_keys(self) -> CurveKeys | None:
        """The service's keys, if it has any."""
        return load_curve_keys(self.curve_dir, "server") if self.curve_dir else None


def curve_dir_from_environment() -> Path | None:
    """The folder of CURVE keys that services and clients of this machine share, MOTIONLOOP_CURVE_DIR."""
    name = os.environ.get("MOTIONLOOP_CURVE_DIR")
    return Path(name) if name else None


def client_curve_keys(folder: Path | None = None) -> CurveKeys | None:
    """The client's keys from `folder`, else from MOTIONLOOP_CURVE_DIR, else None."""
    folder = folder or curve_dir_from_environment()
    return load_curve_keys(folder, "client") if folder else None


def load_settings(
    model: type[S], arguments: Mapping[str, Any] | None = None, environment: Mapping[str, str] | None = None
) -> S:
    """Settings from arguments (None values are ignored), then the environment, then defaults.

    Raises InvalidInputError that names the field and what is allowed.
    """
    environment = os.environ if environment is None else environment
    values: dict[str, Any] = {}
    for name in model.model_fields:
        value: Any = (arguments or {}).get(name)
        if value is None:
            value = environment.get(model.env_prefix + name.upper())
        if value is not None:
            values[name] = _split(value) if _is_list(model, name) else value
    try:
        return model(**values)
    except ValidationError as error:
        raise invalid_input_from(error) from error


def add_arguments(parser: argparse.ArgumentParser, model: type[Settings]) -> None:
    """One option a field; all default to None so that the environment and the model's defaults show through."""
    for name, field in model.model_fields.items():
        default = "" if field.is_required() or field.default_factory else f" (default {field.default})"
        parser.add_argument(f"--{name.replace('_', '-')}", default=None, help=(field.description or name) + default)


def _is_list(model: type[Settings], name: str) -> bool:
    return "tuple[" in str(model.model_fields[name].annotation)


def _split(value: Any) -> Any:
    return tuple(part.strip() for part in value.split(",") if part.strip()) if isinstance(value, str) else value
