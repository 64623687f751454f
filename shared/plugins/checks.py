"""What every plan request and every plan must hold, whoever planned."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from pydantic import ValidationError

from shared.errors import IncompatiblePeerError, InvalidInputError, SimulationError
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import PlannerSpec, TrackerSpec
from shared.plugins.registry import current_name
from shared.protocol.control import Welcome
from shared.protocol.errors import invalid_input_from
from shared.protocol.messages import CONDITIONS, Plan, PlanRequest

Spec = TypeVar("Spec", PlannerSpec, TrackerSpec)
FLOOR_JOINT = "traj"
MAX_TARGET_DISTANCE_M = 30.0
MAX_SPEED_MPS = 30.0


def planner_spec(declared: Mapping[str, object]) -> PlannerSpec:
    """What a planner declared in the handshake; raises IncompatiblePeerError that names what the loop cannot run."""
    return _declared(PlannerSpec, declared)


def tracker_spec(welcome: Welcome, plugin: str | None = None) -> TrackerSpec:
    """What a tracker (None: the default one) declared; raises IncompatiblePeerError for an unfit or unknown one."""
    name = current_name(plugin or welcome.default_plugin)
    for declared in welcome.plugins:
        if declared.get("name") == name:
            return _declared(TrackerSpec, declared)
    raise IncompatiblePeerError(
        f"there is no tracker {name!r}", field="plugin", allowed=", ".join(str(p.get("name")) for p in welcome.plugins)
    )


def _declared(kind: type[Spec], declared: Mapping[str, object]) -> Spec:
    try:
        return kind.model_validate(declared)
    except ValidationError as problem:
        error = invalid_input_from(problem)
        raise IncompatiblePeerError(
            f"{declared.get('name')!r} declares {error.message}", field=error.field, allowed=error.allowed
        ) from problem


def fit_request(request: PlanRequest, spec: PlannerSpec) -> PlanRequest:
    """The request as the planner takes it: the prefix cut to the frames it wants.

    Raises InvalidInputError that names the field for what no planner can do, or this one cannot.
    """
    if request.fps != spec.fps:
        raise InvalidInputError(
            f"{spec.name} plans at {spec.fps} fps, not {request.fps}", field="fps", allowed=str(spec.fps)
        )
    frames = len(request.prefix_positions_w_m)
    if frames < spec.prefix_frames:
        raise InvalidInputError(
            f"the prefix has {frames} frames", field="prefix_positions_w_m", allowed=f">= {spec.prefix_frames} frames"
        )
    if request.horizon_frames > spec.plan_frames:
        raise InvalidInputError(
            f"{spec.name} plans at most {spec.plan_frames} frames, not {request.horizon_frames}",
            field="horizon_frames",
            allowed=f"1..{spec.plan_frames}",
        )
    root = request.prefix_positions_w_m[-1, 0]
    joints = (*CANONICAL.names, FLOOR_JOINT)
    for number, target in enumerate(request.targets):
        if target.joint not in joints:
            raise InvalidInputError(
                f"unknown joint {target.joint!r}", field=f"targets.{number}.joint", allowed=", ".join(joints)
            )
        distance_m = float(np.linalg.norm(np.array(target.position_w_m[:2]) - root[:2]))
        if distance_m > MAX_TARGET_DISTANCE_M or abs(target.position_w_m[2]) > MAX_TARGET_DISTANCE_M:
            raise InvalidInputError(
                f"the target is {distance_m:.1f} m away",
                field=f"targets.{number}.position_w_m",
                allowed=f"at most {MAX_TARGET_DISTANCE_M:g} m from the character",
            )
    if frames == spec.prefix_frames:
        return request
    cut = {
        name: getattr(request, name)[-spec.prefix_frames :]
        for name in ("prefix_positions_w_m", "prefix_rotations_6d", "prefix_velocities_w_mps")
    }
    return request.model_copy(update={**cut, "context_frames": min(request.context_frames, spec.prefix_frames)})


def asked_conditions(request: PlanRequest) -> tuple[str, ...]:
    """Which of CONDITIONS a request holds."""
    asked = {
        "text": request.text is not None,
        "target": bool(request.targets),
        "heading": request.heading is not None,
        "velocity": request.desired_velocity_w_mps is not None,
        "facing": request.facing_rad is not None,
        "keyframes": bool(request.keyframe_mask.any()),
        "keyframe_rotations": bool(request.keyframe_rotation_mask.any()),
        "obstacles": len(request.obstacle_radius_m) > 0,
    }
    return tuple(name for name in CONDITIONS if asked[name])


def ignored_conditions(request: PlanRequest, spec: PlannerSpec) -> tuple[str, ...]:
    """What a request asks that the planner does not declare to honour."""
    return tuple(name for name in asked_conditions(request) if name not in spec.conditions)


def check_plan(request: PlanRequest, plan: Plan) -> None:
    """Raise SimulationError for a plan that is no answer to the request, or nothing a body could do."""
    positions = plan.positions_w_m
    given = (len(positions), plan.fps, plan.start_tick, plan.skeleton)
    asked = (request.horizon_frames, request.fps, request.start_tick, CANONICAL.id)
    if given != asked:
        raise SimulationError(
            "{} gave {} frames at {} fps from tick {} of {}; asked were {} at {} from {} of {}".format(
                plan.planner, *given, *asked
            )
        )
    if not (np.isfinite(positions).all() and np.isfinite(plan.rotations_6d).all()):
        raise SimulationError(f"{plan.planner} gave non-finite values", field="positions_w_m")
    whole = np.concatenate([request.prefix_positions_w_m[-1:], positions])
    speed = float(np.linalg.norm(np.diff(whole, axis=0), axis=-1).max()) * plan.fps
    if speed > MAX_SPEED_MPS:
        raise SimulationError(
            f"{plan.planner} gave a joint {speed:.1f} m/s", field="positions_w_m", allowed=f"<= {MAX_SPEED_MPS:g} m/s"
        )
