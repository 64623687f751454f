"""A blocking client of the HTTP API."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Any

import httpx

from orchestrator.client.models import CharacterInfo, EpisodeInfo, EventInfo, StateInfo
from shared.errors import MotionLoopError, UnavailableError

TIMEOUT_S = 60.0
VIDEO_TIMEOUT_S = 960.0


class ServerProblem(MotionLoopError):
    """The server answered with a problem; `code`, `field` and `allowed` are its."""

    def __init__(self, status: int, problem: Mapping[str, Any]):
        detail = str(problem.get("detail") or problem.get("title") or f"HTTP {status}")
        super().__init__(detail, field=problem.get("field"), allowed=problem.get("allowed"))
        self.status = status
        self.code = str(problem.get("code", "http_error"))
        self.retryable = bool(problem.get("retryable", False))


class MotionLoopClient:
    """Makes characters and episodes on a server.

    Args:
        url: of the server, e.g. http://127.0.0.1:8080.
        token: bearer token, where the server wants one.
    """

    def __init__(self, url: str, token: str | None = None, timeout_s: float = TIMEOUT_S):
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._http = httpx.Client(base_url=url, headers=headers, timeout=timeout_s)

    def __enter__(self) -> MotionLoopClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    # --- characters ---

    def create_character(self, **spec: Any) -> CharacterInfo:
        """Make a character: scene, planner, tracker, pacing, seed."""
        return CharacterInfo.model_validate(self._json("POST", "/v1/characters", spec))

    def character(self, character_id: str) -> CharacterInfo:
        """A character with its present state."""
        return CharacterInfo.model_validate(self._json("GET", f"/v1/characters/{character_id}"))

    def characters(self) -> list[CharacterInfo]:
        """All characters."""
        items = self._json("GET", "/v1/characters")["items"]
        return [CharacterInfo.model_validate(item) for item in items]

    def command(
        self,
        character_id: str,
        text: str | None = None,
        target_m: Sequence[float] | None = None,
        joint: str = "traj",
        **more: Any,
    ) -> int:
        """Tell it what to do; returns the tick at which the command was taken."""
        body: dict[str, Any] = {"text": text, **more}
        if target_m is not None:
            body["target"] = {"joint": joint, "position_m": list(target_m)}
        return int(self._json("POST", f"/v1/characters/{character_id}/commands", body)["tick"])

    def step(self, character_id: str, ticks: int) -> StateInfo:
        """Let a lockstep character go on."""
        return StateInfo.model_validate(self._json("POST", f"/v1/characters/{character_id}/steps", {"ticks": ticks}))

    def push(self, character_id: str, body: str, impulse_ns: Sequence[float]) -> None:
        """Push a body, newton seconds in the world frame."""
        self._json("POST", f"/v1/characters/{character_id}/impulses", {"body": body, "impulse_ns": list(impulse_ns)})

    def delete_character(self, character_id: str) -> None:
        """End a character."""
        self._send("DELETE", f"/v1/characters/{character_id}")

    # --- episodes ---

    def start_episode(self, spec: Mapping[str, Any]) -> str:
        """Start an episode; returns its id."""
        return str(self._json("POST", "/v1/episodes", spec)["id"])

    def episode(self, episode_id: str) -> EpisodeInfo:
        """An episode as it is now."""
        return EpisodeInfo.model_validate(self._json("GET", f"/v1/episodes/{episode_id}"))

    def cancel_episode(self, episode_id: str) -> None:
        """Cancel it, or delete it when it is over."""
        self._send("DELETE", f"/v1/episodes/{episode_id}")

    def events(self, episode_id: str, timeout_s: float = 120.0) -> Iterator[EventInfo]:
        """Events until the episode ends; UnavailableError when none comes for `timeout_s`."""
        try:
            with self._http.stream("GET", f"/v1/episodes/{episode_id}/events", timeout=timeout_s) as response:
                _raise_problem(response)
                for line in response.iter_lines():
                    if line.startswith("data: "):
                        yield EventInfo.model_validate_json(line.removeprefix("data: "))
        except httpx.TransportError as error:
            raise UnavailableError(f"the event stream broke: {error or type(error).__name__}") from error

    def motion(self, episode_id: str, suffix: str) -> bytes:
        """The recorded motion as `npz`, `bvh` or `csv`."""
        return self._send("GET", f"/v1/episodes/{episode_id}/motion.{suffix}").content

    def video(self, episode_id: str) -> bytes:
        """The episode as MP4."""
        return self._send("GET", f"/v1/episodes/{episode_id}/video.mp4", timeout_s=VIDEO_TIMEOUT_S).content

    # --- services ---

    def services(self) -> dict[str, Any]:
        """What is in use."""
        return dict(self._json("GET", "/v1/services"))

    def swap(self, kind: str, endpoint: str | None = None, plugin: str | None = None) -> dict[str, Any]:
        """Exchange the planner or the tracker."""
        return dict(self._json("PUT", f"/v1/services/{kind}", {"endpoint": endpoint, "plugin": plugin}))

    def ready(self) -> bool:
        """Whether the server and both services answer."""
        try:
            return self._http.get("/readyz").status_code == httpx.codes.OK
        except httpx.TransportError:
            return False

    def _json(self, method: str, path: str, body: Mapping[str, Any] | None = None) -> Any:
        return self._send(method, path, body).json()

    def _send(
        self, method: str, path: str, body: Mapping[str, Any] | None = None, timeout_s: float | None = None
    ) -> httpx.Response:
        timeout = httpx.USE_CLIENT_DEFAULT if timeout_s is None else timeout_s
        try:
            response = self._http.request(method, path, json=body, timeout=timeout)
        except httpx.TransportError as error:
            where = f"{self._http.base_url}".rstrip("/")
            raise UnavailableError(f"no server at {where}: {error or type(error).__name__}") from error
        _raise_problem(response)
        return response


def _raise_problem(response: httpx.Response) -> None:
    if response.is_success:
        return
    response.read()
    try:
        problem = response.json()
    except json.JSONDecodeError:
        problem = {"detail": response.text[:200]}
    raise ServerProblem(response.status_code, problem if isinstance(problem, dict) else {"detail": str(problem)})
