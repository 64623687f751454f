"""A user's command, and what it asks of the planner at every plan while it holds."""

from __future__ import annotations

from math import atan2, hypot
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator, model_validator

from shared.errors import InvalidInputError
from shared.motion.rotations import matrix_from_quat, matrix_to_6d
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.tasks.approach import TRAJ, Approach
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, Obstacle, PlanGoal
from shared.tasks.specs import MAX_TARGET_DISTANCE_M, Coordinate, Guidance, ReachSpec, ReachTuning, Text
from shared.text.wording import STAND_TEXT

JOINTS = (*CANONICAL.names, TRAJ)
HEADING_S = 1.5
VELOCITY_AHEAD_S = 1.0
MAX_SPEED_MPS = 8.0
Part = Annotated[FiniteFloat, Field(ge=-1, le=1)]
Speed = Annotated[FiniteFloat, Field(ge=-MAX_SPEED_MPS, le=MAX_SPEED_MPS)]


def _known_joint(joint: str) -> str:
    if joint not in JOINTS:
        raise ValueError(f"unknown joint {joint!r}; allowed: {', '.join(JOINTS)}")
    return joint


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Target(_Model):
    """Where a joint should go. `traj` is the root on the floor: its height is ignored."""

    joint: str = TRAJ
    position_m: tuple[Coordinate, Coordinate, Coordinate]

    _joint = field_validator("joint")(_known_joint)


class Keyframe(_Model):
    """Joints that should be at places, or turned against their parents (the pelvis: in the world), `in_s` seconds after
    the command."""

    in_s: Annotated[FiniteFloat, Field(ge=0, le=10)]
    positions_m: dict[str, tuple[Coordinate, Coordinate, Coordinate]] = {}
    rotations_wxyz: dict[str, tuple[Part, Part, Part, Part]] = {}

    @field_validator("positions_m", "rotations_wxyz")
    @classmethod
    def _joints(cls, value: dict[str, tuple[float, ...]]) -> dict[str, tuple[float, ...]]:
        for joint, numbers in value.items():
            if joint not in CANONICAL.names:
                raise ValueError(f"unknown joint {joint!r}; allowed: {', '.join(CANONICAL.names)}")
            if len(numbers) == 4 and not any(numbers):
                raise ValueError(f"{joint} has no rotation; allowed: a quaternion w, x, y, z")
        return value

    @model_validator(mode="after")
    def _says_something(self) -> Keyframe:
        if not self.positions_m and not self.rotations_wxyz:
            raise ValueError("a keyframe without joints; allowed: positions_m, rotations_wxyz or both")
        return self

    def rotations_6d(self) -> dict[str, tuple[float, ...]]:
        """Its rotations as a PlanGoal has them."""
        return {
            joint: tuple(float(v) for v in matrix_to_6d(matrix_from_quat(quat)))
            for joint, quat in self.rotations_wxyz.items()
        }


class Avoid(_Model):
    """A sphere to keep away from: where it is at the command, and how it moves."""

    position_m: tuple[Coordinate, Coordinate, Coordinate]
    velocity_mps: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    radius_m: Annotated[FiniteFloat, Field(gt=0, le=20)]

    def at(self, seconds: float) -> Obstacle:
        """Where it is so long after the command."""
        x, y, z = (p + v * seconds for p, v in zip(self.position_m, self.velocity_mps, strict=True))
        return Obstacle((x, y, z), self.velocity_mps, self.radius_m)


class Command(_Model):
    """What a character should do from now on; it holds until the next command.

    Attributes:
        text: in words; None with a target walks there.
        target: where a joint should go.
        heading_rad: which way to face, 0 along +X, anticlockwise; with a velocity all along.
        velocity_mps: (x, y) in the world.
        keyframes: poses to pass through.
        avoid: what to keep away from.
        guidance: how strongly the text counts (classifier-free guidance); None for the planner's default.
        replan: `now` plans at once, `next` with the next regular plan.
    """

    text: Text | None = None
    target: Target | None = None
    heading_rad: Annotated[FiniteFloat, Field(ge=-100, le=100)] | None = None
    velocity_mps: tuple[Speed, Speed] | None = None
    keyframes: Annotated[list[Keyframe], Field(max_length=64)] = []
    avoid: Annotated[list[Avoid], Field(max_length=64)] = []
    guidance: Guidance | None = None
    replan: Literal["now", "next"] = "now"

    def check_reachable(self, view: BodyView) -> None:
        """Raise InvalidInputError for a target farther than 30 m from the character."""
        if self.target is None:
            return
        x, y, _ = self.target.position_m
        distance = hypot(x - view.pelvis_xy_m[0], y - view.pelvis_xy_m[1])
        if distance > MAX_TARGET_DISTANCE_M:
            raise InvalidInputError(
                f"the target is {distance:.1f} m from the character",
                field="target.position_m",
                allowed=f"within {MAX_TARGET_DISTANCE_M:g} m",
            )


STAND = Command(text=STAND_TEXT)


class CommandGoal:
    """Turns a command into plan goals; keeps what counts down from plan to plan."""

    def __init__(self, command: Command, issued_tick: int, tuning: ReachTuning | None = None):
        self.command = command
        self._issued_tick = issued_tick
        self._tuning = tuning or ReachTuning()
        self._walk: ReachTask | None = None
        self._approach: Approach | None = None

    def __call__(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """The goal of a plan that starts at `plan_tick`."""
        command = self.command
        if command.target is not None and command.target.joint == TRAJ:
            base = self._walk_goal(command.target, view, plan_tick)
        else:
            base = PlanGoal(text=command.text, targets=self._joint_target(view, plan_tick), guidance=command.guidance)
        heading, velocity, targets = base.heading, command.velocity_mps, base.targets
        if velocity is not None and not targets:
            ahead = view.pelvis_xy_m + np.array(velocity) * VELOCITY_AHEAD_S
            arrival = plan_tick + round(VELOCITY_AHEAD_S * TICK_HZ)
            targets = (JointTarget(joint=TRAJ, position_w_m=(ahead[0], ahead[1], 0.0), arrival_tick=arrival),)
            if hypot(*velocity) > 0.1:
                heading = HeadingTarget(heading_rad=atan2(velocity[1], velocity[0]), arrival_tick=arrival)
        if command.heading_rad is not None:
            arrival = max(self._issued_tick + round(HEADING_S * TICK_HZ), plan_tick + TICK_HZ // 2)
            heading = HeadingTarget(heading_rad=command.heading_rad, arrival_tick=arrival)
        due = [(self._issued_tick + round(frame.in_s * TICK_HZ), frame) for frame in command.keyframes]
        due = [(tick, frame) for tick, frame in due if tick > plan_tick]
        return PlanGoal(
            text=base.text,
            targets=targets,
            heading=heading,
            desired_velocity_w_mps=velocity,
            facing_rad=command.heading_rad if velocity is not None else None,
            obstacles=tuple(sphere.at((plan_tick - self._issued_tick) / TICK_HZ) for sphere in command.avoid),
            keyframe_ticks=tuple(tick for tick, _ in due),
            keyframe_joints=tuple(tuple(frame.positions_m) for _, frame in due),
            keyframe_positions_w_m=tuple(tuple(frame.positions_m.values()) for _, frame in due),
            keyframe_rotations_6d=tuple(frame.rotations_6d() for _, frame in due),
            guidance=command.guidance,
        )

    def _walk_goal(self, target: Target, view: BodyView, plan_tick: int) -> PlanGoal:
        if self._walk is None:
            x, y, _ = target.position_m
            words = {} if self.command.text is None else {"text": self.command.text}
            spec = ReachSpec.model_validate(
                {"position_m": (x, y), "guidance": self.command.guidance, "tuning": self._tuning, **words}
            )
            self._walk = ReachTask(spec, seed=0)
            self._walk.start(view)
        return self._walk.goal(view, plan_tick)

    def _joint_target(self, view: BodyView, plan_tick: int) -> tuple[JointTarget, ...]:
        target = self.command.target
        if target is None:
            return ()
        if self._approach is None:
            self._approach = Approach(target.joint, self._tuning)
        here = view.pos_w_m[CANONICAL.index(target.joint)]
        return (self._approach.target(here, np.array(target.position_m), plan_tick, view.scale),)
