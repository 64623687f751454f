"""Settings of the orchestrator: environment variables MOTIONLOOP_*, checked at the edge."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, SecretStr, model_validator

from orchestrator.store.choice import POSTGRES
from shared.protocol.security import curve_dir_from_environment, is_loopback
from shared.settings import TOKEN_CHARS, Names, Settings
from shared.tracing import LogFormat


class OrchestratorSettings(Settings):
    """Where the orchestrator listens and what it uses.

    Attributes:
        host, port: of the HTTP server; port 0 takes a free one. A host beyond loopback needs `token`.
        token: bearer token that every request must carry; it may do everything.
        command_token, watch_token: tokens for those who may not exchange services, or only look (api/access.py).
        allowed_hosts: names by which the server may be addressed beside loopback's. With a token any will do, as a page
            that lures a browser here does not have it.
        planner, tracker: ZeroMQ endpoints of the services.
        planner_plugin, tracker_plugin: which plug-ins to use; None for the services' defaults.
        data_dir: database and recordings.
        store: URL of a PostgreSQL database (`postgresql://user:password@host/name`) to use instead of SQLite in
            `data_dir`. A password is better given as MOTIONLOOP_STORE than on the command line.
        scenes: folder of scenes of one's own (YAML), before those of the package.
        curve_dir: folder of CURVE keys, for services on other machines.
        connect_timeout_s: how long to wait for the services at the start.
        spare_trackers: endpoints of more trackers: characters are spread over all, and one that loses its own lives on
            at another.
        rescue_s: how long a character whose tracker was lost is tried to be brought back before it has failed.
        max_running: characters and episodes at once.
        unwritten_mb: recordings that a full disk refuses are held in memory up to this, of all episodes together.
            Beyond it their ticks stay with the trackers until the disk takes them, and no episode is begun.
        swap_endpoints: where a service may be swapped to, beside `planner` and `tracker`. Without any, a server on
            loopback swaps to wherever it is told and one beyond it nowhere else.
        max_body_bytes, max_rate_per_s: of one request; requests of one caller.
        max_requests, max_streams: at once, of all callers.
        log_level: of the process; info has a line for every request.
        log_format: lines for people, or JSON with the trace id (docs/operations.md).
    """

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 8080
    token: SecretStr | None = None
    command_token: SecretStr | None = None
    watch_token: SecretStr | None = None
    allowed_hosts: Names = ()
    planner: str = "tcp://127.0.0.1:5601"
    tracker: str = "tcp://127.0.0.1:5602"
    planner_plugin: str | None = None
    tracker_plugin: str | None = None
    data_dir: Path = Path("out/data")
    store: SecretStr | None = None
    scenes: Path | None = None
    curve_dir: Path | None = Field(default_factory=curve_dir_from_environment)
    connect_timeout_s: Annotated[float, Field(gt=0, le=600)] = 60.0
    spare_trackers: Names = ()
    rescue_s: Annotated[float, Field(ge=0, le=3600)] = 60.0
    max_running: Annotated[int, Field(ge=1, le=1000)] = 64
    unwritten_mb: Annotated[float, Field(gt=0)] = 256.0
    swap_endpoints: Names = ()
    max_body_bytes: Annotated[int, Field(ge=1024)] = 2**20
    max_rate_per_s: Annotated[float, Field(gt=0)] = 1000.0
    max_requests: Annotated[int, Field(ge=1)] = 256
    max_streams: Annotated[int, Field(ge=1)] = 64
    log_level: Literal["debug", "info", "warning", "error"] = "warning"
    log_format: LogFormat = "text"

    @model_validator(mode="after")
    def _known_store(self) -> OrchestratorSettings:
        if self.store is not None and not self.store.get_secret_value().startswith(POSTGRES):
            raise ValueError("store must be a URL that begins with postgresql://, or be left out for SQLite")
        return self

    @model_validator(mode="after")
    def _no_open_door(self) -> OrchestratorSettings:
        if not is_loopback(self.host) and self.token is None:
            raise ValueError(
                f"host {self.host} can be reached from other machines: set MOTIONLOOP_TOKEN to a bearer token, "
                "or listen on 127.0.0.1"
            )
        given = [t.get_secret_value() for t in (self.token, self.command_token, self.watch_token) if t is not None]
        if any(len(token) < TOKEN_CHARS for token in given):
            raise ValueError(f"a token must have at least {TOKEN_CHARS} characters")
        if len(set(given)) < len(given):
            raise ValueError("each scope must have a token of its own")
        return self

    def may_swap_to(self, endpoint: str) -> bool:
        """Whether a service may be swapped to an endpoint."""
        if not self.swap_endpoints and is_loopback(self.host):
            return True
        return endpoint in (self.planner, self.tracker, *self.swap_endpoints)
