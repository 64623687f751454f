"""What a task is: it looks at the character, says what the planner should be asked for, and when it is over.

A task is told how the body is (`BodyView`) and answers with a `PlanGoal`; afterwards it judges the recorded `Trace`.
It never talks to a service, so the same task runs in episodes, in evaluation and in a user's own script.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from shared.motion.heading import hips_heading
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import TICK_HZ, HeadingTarget, JointTarget
from shared.scenes.schema import Scene
from shared.tasks.world import World, worlds_joined

Array = npt.NDArray[np.float64]
Status = Literal["running", "done", "failed"]
Posture = Literal["upright", "seated", "from_floor"]

_PELVIS = CANONICAL.index("pelvis")


@dataclass(frozen=True)
class BodyView:
    """The character at a tick.

    Attributes:
        pos_w_m: (22, 3) joint positions in the world.
        fallen: whether it has.
        scale: its size against the canonical body's.
        objects: (7,) position and quaternion of every object of the scene, by name.
        mass_kg: of the body.
        scene: the scene with its marks; None where nobody knows it, and after the start of a task.
    """

    tick: int
    pos_w_m: Array
    fallen: bool = False
    scale: float = 1.0
    objects: Mapping[str, Array] = field(default_factory=dict)
    mass_kg: float = 72.0
    scene: Scene | None = None

    @property
    def pelvis_xy_m(self) -> Array:
        """(2,) where the pelvis is over the floor."""
        return self.pos_w_m[_PELVIS, :2]

    @property
    def heading_rad(self) -> float:
        """Direction the hips face."""
        return float(hips_heading(self.pos_w_m))


@dataclass(frozen=True)
class Obstacle:
    """A sphere to keep away from: where it is when the plan starts, how it moves, how large it is."""

    position_w_m: tuple[float, float, float]
    velocity_w_mps: tuple[float, float, float]
    radius_m: float


RISE_PLANNER = "rise"
"""Plug-in that knows ways up from lying; see PlanGoal.planner."""


@dataclass(frozen=True)
class PlanGoal:
    """What the planner is asked for, in the character's own world. Every part is optional.

    Attributes:
        facing_rad: which way to face all along; `heading` holds at a tick.
        obstacles: what to keep away from.
        keyframe_ticks: K poses to pass through; keyframe_joints, keyframe_positions_w_m: which joints at which places;
            keyframe_rotations_6d: K or none, rotations of joints against their parents, the pelvis' in the world.
        guidance: on the text; None leaves it to the loop's settings, and those to the planner: the one rule there is.
            What was used stands in the plan.
        may_be_low: being low is asked for and is no fall; None: as the text says.
        planner: plug-in to ask, where the service has it; None, or one that it lacks: the character's own.
        hold_ticks: the plan is performed at least so long before the next one, where the loop would plan oftener: a
            motion that must not be begun anew again and again.
        replan_ticks: the next plan is asked for after so many ticks, where the loop would plan later but for those
            settings that plan seldom on purpose: what happens in between changes what is to be done.
        candidates: so many plans are asked for, with seeds of their own, and the one of most `worth` is performed.
        worth: of (T, 22, 3) positions in the character's own world and their rate; the first plan where it is None.
    """

    text: str | None = None
    targets: tuple[JointTarget, ...] = ()
    heading: HeadingTarget | None = None
    desired_velocity_w_mps: tuple[float, float] | None = None
    facing_rad: float | None = None
    obstacles: tuple[Obstacle, ...] = ()
    keyframe_ticks: tuple[int, ...] = ()
    keyframe_joints: tuple[tuple[str, ...], ...] = ()
    keyframe_positions_w_m: tuple[tuple[tuple[float, float, float], ...], ...] = ()
    keyframe_rotations_6d: tuple[Mapping[str, tuple[float, ...]], ...] = ()
    guidance: float | None = None
    may_be_low: bool | None = None
    planner: str | None = None
    hold_ticks: int = 0
    replan_ticks: int | None = None
    candidates: int = 1
    worth: Callable[[npt.NDArray[np.float64], float], float] | None = None

    def scaled(self, factor: float) -> PlanGoal:
        """The same in a world whose lengths are `factor` times as large: places, speeds and radii are, angles and times
        stay."""
        if factor == 1.0:
            return self

        def point(place: tuple[float, float, float]) -> tuple[float, float, float]:
            x, y, z = place
            return (x * factor, y * factor, z * factor)

        velocity = self.desired_velocity_w_mps
        return replace(
            self,
            targets=tuple(each.model_copy(update={"position_w_m": point(each.position_w_m)}) for each in self.targets),
            desired_velocity_w_mps=None if velocity is None else (velocity[0] * factor, velocity[1] * factor),
            obstacles=tuple(
                Obstacle(point(each.position_w_m), point(each.velocity_w_mps), each.radius_m * factor)
                for each in self.obstacles
            ),
            keyframe_positions_w_m=tuple(tuple(map(point, places)) for places in self.keyframe_positions_w_m),
        )


@dataclass(frozen=True)
class Trace:
    """What happened at every control tick from `start_tick` on: T ticks at 30 Hz.

    Attributes:
        pos_w_m: (T, 22, 3) joint positions.
        fallen: (T,) bool.
        world: the scene's objects at the same ticks and what the body touched; None where nobody looked.
    """

    start_tick: int
    pos_w_m: Array
    fallen: npt.NDArray[np.bool_]
    world: World | None = None

    def __len__(self) -> int:
        return len(self.pos_w_m)

    def view(self, i: int) -> BodyView:
        """Row i as a BodyView."""
        return BodyView(self.start_tick + i, self.pos_w_m[i], bool(self.fallen[i]))

    def since(self, tick: int) -> Trace:
        """The rows from `tick` on; none where it ends before that."""
        skip = max(0, tick - self.start_tick)
        world = None if self.world is None else self.world.rows(skip)
        return Trace(self.start_tick + skip, self.pos_w_m[skip:], self.fallen[skip:], world)

    def until(self, tick: int) -> Trace:
        """The rows up to and with `tick`; none where it begins after that."""
        keep = max(0, tick + 1 - self.start_tick)
        world = None if self.world is None else self.world.rows(0, keep)
        return Trace(self.start_tick, self.pos_w_m[:keep], self.fallen[:keep], world)

    @property
    def duration_s(self) -> float:
        """Time covered, T / 30."""
        return len(self) / TICK_HZ


def joined(parts: Sequence[Trace]) -> Trace:
    """Traces that follow one another as one; at least one of them."""
    return Trace(
        parts[0].start_tick,
        np.concatenate([part.pos_w_m for part in parts]),
        np.concatenate([part.fallen for part in parts]),
        worlds_joined([part.world for part in parts if len(part)]),
    )


@dataclass(frozen=True)
class Verdict:
    """Success by the three rules (DESIGN 7), when strict success was reached, and what was measured.

    Attributes:
        seconds: from the start of the task until its strict goal was met, or its whole duration.
        measures: named numbers, SI units in the names.
    """

    strict: bool
    paper: bool
    code: bool
    fell: bool
    seconds: float
    measures: dict[str, float]


class Task(Protocol):
    """One thing to do. `start` is called once, then `goal` at every plan and `status` with every new stretch.

    A class that names this one as its base has `upright`, `posture` and `props` as most tasks need them.
    """

    @property
    def kind(self) -> str:
        """Name of the task type."""
        ...

    @property
    def label(self) -> str:
        """Short text for people."""
        ...

    @property
    def time_limit_s(self) -> float:
        """After this it has failed."""
        ...

    @property
    def upright(self) -> bool:
        """Whether lying on the floor means that it went wrong, whatever the plan says."""
        return True

    @property
    def posture(self) -> Posture:
        """How it ends: on its feet, or seated. `from_floor`: it begins lying, and tells falls from that itself."""
        return "upright"

    def props(self, view: BodyView) -> Mapping[str, Array]:
        """Objects that have to be put somewhere before it starts, as (7,) poses: a bag that lies is set up again."""
        return {}

    def start(self, view: BodyView) -> None:
        """Fix whatever depends on where the character is, and on the scene."""
        ...

    def goal(self, view: BodyView, plan_tick: int) -> PlanGoal:
        """What to ask the planner for in a plan that starts at `plan_tick`."""
        ...

    def status(self, trace: Trace) -> Status:
        """Whether the task is over, given everything since its start."""
        ...

    def judge(self, trace: Trace) -> Verdict:
        """The verdict over everything from its start to the end of the settling time."""
        ...
