"""Settings: pydantic-settings models filled from the command line, then the environment, then defaults.

A field `max_batch` of a model with prefix `MOTIONLOOP_PLANNER_` is `--max-batch` on the command line and
`MOTIONLOOP_PLANNER_MAX_BATCH` in the environment. Lists are written with commas, and a variable that is empty counts as
not set. Only services have settings of this kind: the light client does without the package.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Field, SecretStr, ValidationError, model_validator
from pydantic_settings import BaseSettings, SettingsConfigDict

from shared.protocol.errors import invalid_input_from
from shared.protocol.security import (
    CurveKeys,
    check_bind,
    curve_dir_from_environment,
    is_loopback,
    load_curve_keys,
)
from shared.telemetry import MetricsEndpoint
from shared.tracing import LogFormat

S = TypeVar("S", bound="Settings")
TOKEN_CHARS = 16
"""A bearer token has at least so many."""


def _split(value: Any) -> Any:
    return tuple(part.strip() for part in value.split(",") if part.strip()) if isinstance(value, str) else value


Names = Annotated[tuple[str, ...], BeforeValidator(_split)]
"""Several names; as text, with commas between them."""


class Settings(BaseSettings):
    """Base of all settings: immutable, no unknown names. A model of its own has its own `env_prefix`."""

    model_config = SettingsConfigDict(
        frozen=True, extra="forbid", env_prefix="MOTIONLOOP_", env_ignore_empty=True, enable_decoding=False
    )


class ServiceSettings(Settings):
    """What every ZeroMQ service can be told.

    Attributes:
        endpoint: where to listen; beyond this machine only with CURVE keys.
        workers: threads that handle requests.
        max_pending: requests under way before new ones are refused as overloaded.
        curve_dir: folder of CURVE keys (`python -m shared.protocol.keys FOLDER`), or None.
        log_level: of the process; debug has a line for every message.
        log_format: lines for people, or JSON with the trace id (docs/operations.md).
        metrics_port: where Prometheus finds the service's numbers; 0 takes a free one, None serves none.
        metrics_host: address of that port; beyond loopback only with a token.
        metrics_token: bearer token without which the numbers are not told.
    """

    endpoint: str
    workers: Annotated[int, Field(ge=1, le=64)] = 4
    max_pending: Annotated[int, Field(ge=1, le=10_000)] = 256
    curve_dir: Path | None = Field(default_factory=curve_dir_from_environment)
    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: LogFormat = "text"
    metrics_port: Annotated[int, Field(ge=0, le=65535)] | None = None
    metrics_host: str = "127.0.0.1"
    metrics_token: Annotated[SecretStr, Field(min_length=TOKEN_CHARS)] | None = None

    @model_validator(mode="after")
    def _safe_to_listen(self) -> ServiceSettings:
        check_bind(self.endpoint, self.curve_keys())
        if self.metrics_token is None and not is_loopback(self.metrics_host):
            raise ValueError(
                f"metrics_host {self.metrics_host} can be reached from other machines: set metrics_token, or 127.0.0.1"
            )
        return self

    def start_metrics(self, endpoint: MetricsEndpoint) -> None:
        """Serve the numbers as these settings say."""
        token = None if self.metrics_token is None else self.metrics_token.get_secret_value()
        endpoint.start(self.metrics_port, self.metrics_host, token)

    def curve_keys(self) -> CurveKeys | None:
        """The service's keys, if it has any."""
        return load_curve_keys(self.curve_dir, "server") if self.curve_dir else None


def load_settings(model: type[S], arguments: Mapping[str, Any] | None = None) -> S:
    """Settings from arguments (None values are ignored), then the environment, then defaults.

    Raises InvalidInputError that names the field and what is allowed.
    """
    given = {name: value for name, value in (arguments or {}).items() if value is not None}
    try:
        return model(**given)
    except ValidationError as error:
        raise invalid_input_from(error) from error


def add_arguments(parser: argparse.ArgumentParser, model: type[Settings]) -> None:
    """One option a field; all default to None so that the environment and the model's defaults show through."""
    for name, field in model.model_fields.items():
        default = "" if field.is_required() or field.default_factory else f" (default {field.default})"
        parser.add_argument(f"--{name.replace('_', '-')}", default=None, help=(field.description or name) + default)
