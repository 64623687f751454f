"""The table of all messages, version 2, and their names in one place. Definitions: `planning` (planner), `tracking` and
`states` (tracker), `control` (every service); rates: `rates`.
"""

from __future__ import annotations

from shared.protocol.base import Message
from shared.protocol.control import ErrorReply, Health, HealthReport, Hello, Ok, Welcome
from shared.protocol.planning import (
    CONDITIONS,
    MAX_PLAN_FRAMES,
    MAX_PREFIX_FRAMES,
    MAX_TEXT_CHARS,
    HeadingTarget,
    JointTarget,
    Plan,
    PlanRequest,
    ReadText,
    Seed,
    TextRead,
    Tick,
    Vec3,
)
from shared.protocol.rates import LOG_HZ, PHYSICS_HZ, PLANNER_FPS, TICK_HZ
from shared.protocol.states import FLOOR, Look, StateFacts, StateFrame, TickRange
from shared.protocol.tracking import (
    SERVO_TARGETS,
    CloseCharacter,
    CreateCharacter,
    GetTicks,
    Impulse,
    Observe,
    Pacing,
    Quat,
    Render,
    ResetCharacter,
    Restore,
    SceneRef,
    SetObject,
    SetPacing,
    SetScene,
    SetTracker,
    Snapshot,
    Step,
    TakeSnapshot,
    Track,
    TrackReply,
    Video,
)

__all__ = [
    "CONDITIONS",
    "FLOOR",
    "LOG_HZ",
    "MAX_PLAN_FRAMES",
    "MAX_PREFIX_FRAMES",
    "MAX_TEXT_CHARS",
    "MESSAGES",
    "PHYSICS_HZ",
    "PLANNER_FPS",
    "SERVO_TARGETS",
    "TICK_HZ",
    "CloseCharacter",
    "CreateCharacter",
    "GetTicks",
    "HeadingTarget",
    "Impulse",
    "JointTarget",
    "Look",
    "Observe",
    "Pacing",
    "Plan",
    "PlanRequest",
    "Quat",
    "ReadText",
    "Render",
    "ResetCharacter",
    "Restore",
    "SceneRef",
    "Seed",
    "SetObject",
    "SetPacing",
    "SetScene",
    "SetTracker",
    "Snapshot",
    "StateFacts",
    "StateFrame",
    "Step",
    "TakeSnapshot",
    "TextRead",
    "Tick",
    "TickRange",
    "Track",
    "TrackReply",
    "Vec3",
    "Video",
]  # fmt: skip

MESSAGES: dict[str, type[Message]] = {
    cls.type: cls
    for cls in (
        Hello, Welcome, Health, HealthReport, ErrorReply, Ok, PlanRequest, Plan, ReadText, TextRead,
        CreateCharacter, CloseCharacter, SetScene, SetObject, SetTracker, SetPacing, ResetCharacter, Track, TrackReply,
        Step, Observe, StateFrame, Look, GetTicks, TickRange, Impulse, TakeSnapshot, Snapshot, Restore, Render, Video,
    )
}  # fmt: skip
