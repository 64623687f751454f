"""The conformance suite: does a planner, or a service at an endpoint, keep the contract?

Used by tests, by `motionloop conformance ENDPOINT` and as the probe before a hot swap. The probes are few and short
(a few plans; a second of simulation), so that a swap takes no longer than a plan or two.
"""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import zmq

from shared.errors import IncompatiblePeerError, MotionLoopError
from shared.motion.characters import BUILDS, build
from shared.motion.ik import clip_from_positions, standing_clip
from shared.motion.skeleton import CANONICAL
from shared.plugins.checks import check_plan, planner_spec, tracker_spec
from shared.plugins.interfaces import Planner, PlannerSpec, TrackerSpec
from shared.protocol.messages import (
    CONDITIONS,
    LOG_HZ,
    PLANNER_FPS,
    SERVO_TARGETS,
    TICK_HZ,
    CloseCharacter,
    CreateCharacter,
    GetTicks,
    JointTarget,
    Observe,
    Plan,
    PlanRequest,
    StateFrame,
    Step,
    TickRange,
    Track,
    TrackReply,
)
from shared.protocol.rates import first_start_by
from shared.protocol.security import CurveKeys
from shared.protocol.transport import ServiceClient

MAX_SEAM_M = 0.25
"""No joint may be farther than this from its place in the last prefix frame one frame later."""
MAX_BONE_ERROR_M = 0.005
START_TICK = 30
"""A second: a frame at every rate that a planner may have."""


@dataclass(frozen=True)
class CheckResult:
    """Outcome of one check; `detail` says what was found where it failed."""

    name: str
    passed: bool
    detail: str = ""


class PlannerProbe(Protocol):
    """A planner as the suite sees it: what it says of itself, and one plan at a time."""

    spec: PlannerSpec

    def plan(self, request: PlanRequest) -> Plan:
        """One plan; raises what the planner, or its service, raises."""
        ...


class LocalProbe:
    """A Planner in this process, behind the checks that a service makes."""

    def __init__(self, planner: Planner):
        self.spec = planner.spec
        self._planner = planner

    def plan(self, request: PlanRequest) -> Plan:
        """One plan in a batch of its own."""
        return self._planner.plan([request])[0]


class EndpointProbe:
    """One planner of a service."""

    def __init__(self, client: ServiceClient, plugin: str | None, timeout_s: float):
        welcome = client.connect(timeout_s)
        name = plugin or welcome.default_plugin
        specs = [entry for entry in welcome.plugins if entry.get("name") == name]
        if not specs:
            raise IncompatiblePeerError(f"{client.peer.endpoint} has no planner {name!r}", field="plugin")
        self.spec = planner_spec(specs[0])
        self._client = client
        self._timeout_s = timeout_s

    def plan(self, request: PlanRequest) -> Plan:
        """One plan over the wire."""
        named = request.model_copy(update={"planner": self.spec.name})
        return self._client.ask(named, Plan, "conformance", timeout_s=self._timeout_s)


def sample_request(
    spec: PlannerSpec, *, at_w_m: tuple[float, float] = (0.0, 0.0), heading_rad: float = 0.0, **fields: Any
) -> PlanRequest:
    """A request whose prefix is quiet standing at a place, with other fields as given."""
    clip = standing_clip(spec.prefix_frames, spec.fps, heading_rad=heading_rad)
    return PlanRequest(
        start_tick=int(fields.pop("start_tick", START_TICK)),
        fps=spec.fps,
        prefix_positions_w_m=clip.positions_w_m + np.array([*at_w_m, 0.0]),
        prefix_rotations_6d=clip.rotations_6d,
        prefix_velocities_w_mps=np.zeros_like(clip.positions_w_m),
        **fields,
    )


def check_planner(probe: PlannerProbe) -> list[CheckResult]:
    """All checks of a planner."""
    checks: tuple[tuple[str, Callable[[PlannerProbe], None]], ...] = (
        ("spec", _spec),
        ("plan", _plan),
        ("rotations", _rotations),
        ("seam", _seam),
        ("horizon", _horizon),
        ("determinism", _determinism),
        ("conditions", _conditions),
    )
    return [_result(name, lambda check=check: check(probe)) for name, check in checks]  # type: ignore[misc]


def check_planner_endpoint(
    endpoint: str,
    plugin: str | None = None,
    *,
    timeout_s: float = 10.0,
    context: zmq.Context[Any] | None = None,
    curve: CurveKeys | None = None,
) -> list[CheckResult]:
    """All checks of a planner behind a service, and that the service refuses bad requests."""
    with ServiceClient(endpoint, "planner", plugin=plugin, context=context, curve=curve, name="conformance") as client:
        try:
            probe = EndpointProbe(client, plugin, timeout_s)
        except MotionLoopError as error:
            return [CheckResult("handshake", False, error.message)]
        results = [CheckResult("handshake", True), *check_planner(probe)]
        results.append(_result("bad requests", lambda: _bad_plan_requests(probe)))
        return results


def check_tracker_endpoint(
    endpoint: str,
    plugin: str | None = None,
    *,
    timeout_s: float = 10.0,
    context: zmq.Context[Any] | None = None,
    curve: CurveKeys | None = None,
) -> list[CheckResult]:
    """Checks of a tracker behind a service, on a character of their own that is closed in the end."""
    with ServiceClient(endpoint, "tracker", plugin=plugin, context=context, curve=curve, name="conformance") as client:
        character_id = f"conformance-{uuid.uuid4().hex[:12]}"
        try:
            spec = tracker_spec(client.connect(timeout_s), plugin)
            character = "human" if spec.characters is None else (*spec.characters, "human")[0]
            create = CreateCharacter(character=character, tracker=spec.name)
            client.ask(create, StateFrame, character_id, timeout_s=timeout_s)
        except MotionLoopError as error:
            return [CheckResult("handshake", False, error.message)]
        try:
            return [
                CheckResult("handshake", True),
                _result("spec", lambda: _tracker_spec(spec)),
                _result("stands", lambda: _stands(client, character_id, timeout_s)),
                _result("log", lambda: _log(client, character_id, timeout_s)),
                _result("actions", lambda: _actions(client, character_id, spec, timeout_s)),
                _result("bad requests", lambda: _bad_track(client, character_id, timeout_s)),
            ]
        finally:
            client.request(CloseCharacter(), character_id, timeout_s=timeout_s)


def require(results: Iterable[CheckResult]) -> None:
    """Raise IncompatiblePeerError that names the checks that failed, if any."""
    failed = [f"{result.name} ({result.detail})" for result in results if not result.passed]
    if failed:
        raise IncompatiblePeerError(f"conformance: {'; '.join(failed)}")


class _CheckFailed(Exception):
    """A check found the contract broken."""


def _result(name: str, check: Callable[[], None]) -> CheckResult:
    try:
        check()
    except _CheckFailed as failure:
        return CheckResult(name, False, str(failure))
    except MotionLoopError as error:
        return CheckResult(name, False, f"{error.code}: {error.message}")
    return CheckResult(name, True)


def _expect(condition: bool, otherwise: str) -> None:
    if not condition:
        raise _CheckFailed(otherwise)


# --- planner --------------------------------------------------------------------------------------------------------


def _spec(probe: PlannerProbe) -> None:
    spec = probe.spec
    _expect(spec.skeleton == CANONICAL.id, f"skeleton {spec.skeleton!r}, not {CANONICAL.id!r}")
    planner_spec(dict(spec))
    unknown = set(spec.conditions) - set(CONDITIONS)
    _expect(not unknown, f"unknown conditions {sorted(unknown)}, allowed {CONDITIONS}")


def _frames(probe: PlannerProbe) -> int:
    return min(40, probe.spec.plan_frames)


def _plan(probe: PlannerProbe) -> None:
    request = sample_request(probe.spec, horizon_frames=_frames(probe))
    check_plan(request, probe.plan(request))


def _rotations(probe: PlannerProbe) -> None:
    plan = probe.plan(sample_request(probe.spec, horizon_frames=_frames(probe)))
    positions = np.asarray(plan.positions_w_m, dtype=np.float64)
    bones = np.linalg.norm(positions - positions[:, np.maximum(CANONICAL.parents, 0)], axis=-1)
    error_m = float(np.abs(bones - CANONICAL.bone_lengths_m).max())
    _expect(error_m < MAX_BONE_ERROR_M, f"bones change their length by {error_m * 1000:.1f} mm")
    columns = np.asarray(plan.rotations_6d, dtype=np.float64).reshape(*plan.rotations_6d.shape[:2], 2, 3)
    gram = columns @ np.swapaxes(columns, -1, -2)
    _expect(bool(np.allclose(gram, np.eye(2), atol=1e-3)), "rotations are not two orthonormal columns")


def _seam(probe: PlannerProbe) -> None:
    request = sample_request(probe.spec, at_w_m=(3.0, -2.0), heading_rad=2.0, horizon_frames=_frames(probe))
    first = probe.plan(request).positions_w_m[0]
    jump_m = float(np.linalg.norm(first - request.prefix_positions_w_m[-1], axis=-1).max())
    _expect(jump_m < MAX_SEAM_M, f"the plan begins {jump_m:.2f} m away from where the prefix ends")


def _horizon(probe: PlannerProbe) -> None:
    for frames in {1, _frames(probe)}:
        plan = probe.plan(sample_request(probe.spec, horizon_frames=frames))
        _expect(len(plan.positions_w_m) == frames, f"{len(plan.positions_w_m)} frames for a horizon of {frames}")


def _determinism(probe: PlannerProbe) -> None:
    request = sample_request(probe.spec, horizon_frames=_frames(probe), seed=7)
    first, second = probe.plan(request), probe.plan(request)
    apart_m = float(np.abs(first.positions_w_m - second.positions_w_m).max())
    _expect(apart_m < 1e-4, f"the same request with the same seed gave plans {apart_m:.4f} m apart")


def _conditions(probe: PlannerProbe) -> None:
    frames = _frames(probe)
    arrival = START_TICK + frames * TICK_HZ // probe.spec.fps
    request = sample_request(
        probe.spec,
        horizon_frames=frames,
        text="a person walks forward",
        targets=[JointTarget(joint="traj", position_w_m=(1.0, 0.0, 0.0), arrival_tick=arrival)],
    )
    check_plan(request, probe.plan(request))


def _bad_plan_requests(probe: PlannerProbe) -> None:
    far = JointTarget(joint="traj", position_w_m=(99.0, 0.0, 0.0), arrival_tick=60)
    unknown = JointTarget(joint="tail", position_w_m=(1.0, 0.0, 0.0), arrival_tick=60)
    for field, target in (("position_w_m", far), ("joint", unknown)):
        request = sample_request(probe.spec, targets=[target], horizon_frames=1)
        _refused(lambda request=request: probe.plan(request), field)  # type: ignore[misc]


def _refused(action: Callable[[], object], field: str) -> None:
    try:
        action()
    except MotionLoopError as error:
        _expect(error.code == "invalid_input", f"a bad {field} is refused as {error.code}, not invalid_input")
        _expect(field in (error.field or ""), f"the refusal of a bad {field} names {error.field!r}")
        _expect(bool(error.allowed), f"the refusal of a bad {field} does not say what is allowed")
        return
    raise _CheckFailed(f"a bad {field} is accepted")


# --- tracker --------------------------------------------------------------------------------------------------------


def _tracker_spec(spec: TrackerSpec) -> None:
    unknown = set(spec.characters or ()) - set(BUILDS)
    _expect(not unknown, f"unknown characters {sorted(unknown)}, allowed {tuple(BUILDS)}")
    _expect(spec.characters != (), "it drives no character")
    latent = [space for space in spec.action_spaces if space != SERVO_TARGETS]
    _expect(len(latent) <= 1, f"{len(latent)} spaces beside {SERVO_TARGETS}: {latent}, allowed one")


def _holding(state: StateFrame, frames: int = 40, **fields: Any) -> Track:
    """A plan of staying as it is, from the next tick on that is a frame."""
    body = build(state.character)
    still = np.repeat(np.asarray(state.body_pos_w_m)[None], frames, axis=0)
    clip = clip_from_positions(still, PLANNER_FPS, body.skeleton, rebuild=True)
    return Track(
        start_tick=first_start_by(state.tick, PLANNER_FPS),
        skeleton=body.skeleton_id,
        **{"positions_w_m": clip.positions_w_m, "rotations_6d": clip.rotations_6d, **fields},
    )


def _stands(client: ServiceClient, character_id: str, timeout_s: float) -> None:
    state = client.ask(Observe(), StateFrame, character_id, timeout_s=timeout_s)
    reply = client.ask(_holding(state), TrackReply, character_id, timeout_s=timeout_s)
    _expect(reply.accepted, f"a plan of standing still is dropped: {reply.reason}")
    after = client.ask(Step(ticks=30), StateFrame, character_id, timeout_s=timeout_s)
    _expect(after.tick == state.tick + 30, f"30 ticks lead from tick {state.tick} to {after.tick}")
    _expect(not after.fallen and after.failure is None, f"it cannot stand for a second: {after.failure or 'fallen'}")


def _log(client: ServiceClient, character_id: str, timeout_s: float) -> None:
    for rate_hz in (TICK_HZ, 24, LOG_HZ):
        asked = GetTicks(start_tick=0, stop_tick=30, rate_hz=rate_hz)
        ticks = client.ask(asked, TickRange, character_id, timeout_s=timeout_s)
        _expect(len(ticks.body_pos_w_m) == rate_hz, f"{len(ticks.body_pos_w_m)} samples of a second at {rate_hz} Hz")
        steps_m = np.linalg.norm(np.diff(ticks.body_pos_w_m, axis=0), axis=-1)
        _expect(float(steps_m.max()) < 0.5, f"a body moves {steps_m.max():.2f} m within {1 / rate_hz:.3f} s")


def _actions(client: ServiceClient, character_id: str, spec: TrackerSpec, timeout_s: float) -> None:
    state = client.ask(Observe(), StateFrame, character_id, timeout_s=timeout_s)
    targets = np.repeat(np.asarray(state.hinge_pos_rad)[None], 3, axis=0)
    alien = _holding(state, actions=targets, action_space="conformance-alien")
    _refused(lambda: client.request(alien, character_id, timeout_s=timeout_s), "action_space")
    if SERVO_TARGETS in spec.action_spaces:
        held = _holding(state, actions=targets, action_space=SERVO_TARGETS)
        reply = client.ask(held, TrackReply, character_id, timeout_s=timeout_s)
        _expect(reply.accepted, f"a plan with servo targets is dropped: {reply.reason}")
        narrow = _holding(state, actions=targets[:, 1:], action_space=SERVO_TARGETS)
        _refused(lambda: client.request(narrow, character_id, timeout_s=timeout_s), "actions")


def _bad_track(client: ServiceClient, character_id: str, timeout_s: float) -> None:
    state = client.ask(Observe(), StateFrame, character_id, timeout_s=timeout_s)
    away = np.asarray(_holding(state).positions_w_m) + np.arange(40)[:, None, None] * 50.0
    bad = _holding(state, positions_w_m=away)
    _refused(lambda: client.request(bad, character_id, timeout_s=timeout_s), "positions_w_m")
    after = client.ask(Observe(), StateFrame, character_id, timeout_s=timeout_s)
    _expect(after.plan_end_tick == state.plan_end_tick, "a refused plan has changed the character")
