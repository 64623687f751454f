"""A bank of recorded closed-loop plans: what the tracker was really asked to follow (DESIGN 9).

Trackers trained on recorded motion alone have never seen a planner's plans, nor the junctions where a plan begins at
what the body had just done. Characters are driven here with ever new texts and points; the references that the
tracker's log holds are kept in pieces, each until the body was lost or the character reset.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from orchestrator.core.agenda import task_seed
from orchestrator.core.character import CharacterSpec
from orchestrator.core.command import Command, CommandGoal
from orchestrator.core.episode import EpisodeRunner
from orchestrator.core.events import EventLog
from orchestrator.core.loop import GoalSource, trace_of
from orchestrator.core.services import Services
from orchestrator.core.session import Session
from orchestrator.core.settings import LOCKSTEP, LoopSettings
from orchestrator.evaluation.commands import ALL, DEFAULT, KindsOption
from orchestrator.evaluation.rows import Measured
from orchestrator.evaluation.tasks import episode_spec
from shared.data.props import Seat
from shared.errors import UnavailableError
from shared.motion.resampling import resample
from shared.protocol.messages import TICK_HZ, Plan, StateFrame
from shared.scenes.placing import mark_place
from shared.scenes.schema import Scene
from shared.tasks.builtin import ReachTask
from shared.tasks.interface import BodyView, Trace
from shared.tasks.object_specs import StrikeSpec
from shared.tasks.places import USUAL_HALF_SIZE_M
from shared.tasks.rules import leaning
from shared.tasks.specs import ReachSpec
from shared.tasks.strike import GOING_RAD

Array = npt.NDArray[np.float32]

SEGMENT_S = (1.5, 5.0)
REACH_SHARE = 0.3
KIND_SHARES: dict[KindsOption, dict[str, float]] = {
    "default": {"walk": 0.1, "run": 0.3, "turn": 0.15, "wave": 0.1, "jump": 0.25, "stand": 0.1},
    "all": {
        "walk": 0.08, "run": 0.15, "turn": 0.06, "wave": 0.05, "jump": 0.15, "stand": 0.08, "squat": 0.17,
        "punch": 0.06, "kick": 0.12, "step_back": 0.05, "step_side": 0.03,
    },
}  # fmt: skip
"""What is hardest to perform is met most."""
UP_TEXT, UP_TICKS = "a person gets up from the floor.", 4 * TICK_HZ
REACH_TEXTS = ("a person is walking.", "a person walks forward.", "a person is jogging.")
REACH_TEXT_SHARES = (0.6, 0.3, 0.1)
LEADS_TICKS = (0, 12)
"""Plans that start now (lockstep) and plans that are joined ahead of need (realtime) make different junctions."""
LOST_M = 0.3
GONE_M = 1.0
LEAST_TICKS = 45
RESET_S = 1.0
TASKS_LOST_M = 0.6
"""Where a task fails its plan is kept for a while after the body was lost: that is what is to be learnt."""
EDGE_M = Seat((0.0, 0.0, 0.0), 0.0).size_m[0] / 2
"""The place to sit that trackers are trained with lies so far behind a seat's front edge."""
BESIDE, BESIDE_M, BESIDE_TICKS = "beside", 1.4, 45
"""So near to what is struck plans are kept, and so many of their ticks: later a body that is held up is far behind."""
SEAT_MARK = "seat_centre"
WIDE_M = 0.5


def pieces(reference_w_m: Array, error_m: Array, fallen: npt.NDArray[np.bool_], lost_m: float = LOST_M) -> list[Array]:
    """Stretches (T, 22, 3) of a reference (N, 22, 3) during which the body was with it, of at least 1.5 s.

    Args:
        error_m: (N,) mean joint distance of the body to its reference. fallen: (N,).
        lost_m: a body farther from it was not.
    """
    good = (error_m < lost_m) & ~fallen
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    return [
        reference_w_m[start:stop]
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        if stop - start >= LEAST_TICKS
    ]


async def record_bank(
    services: Services,
    out: Path,
    minutes: float,
    seed: int,
    parallel: int = 8,
    planner: str | None = None,
    tracker: str | None = None,
    progress: Callable[[int, int, dict[str, Any]], None] | None = None,
    kinds: KindsOption = "default",
) -> dict[str, Any]:
    """Record `minutes` of simulated time into `out`, one .npz a stretch between resets.

    Each file holds `positions_w_m` (T, 22, 3) at 30 Hz. Files of an earlier run with other seeds are left alone.

    Returns:
        {pieces, minutes, falls, segments}.
    """
    out.mkdir(parents=True, exist_ok=True)
    ticks_each = round(minutes * 60 * TICK_HZ / parallel)
    total = {"pieces": 0, "ticks": 0, "falls": 0, "segments": 0}

    def keep(stream: int, found: list[Array], fell: bool, segments: int) -> None:
        for piece in found:
            name = f"{tracker or services.tracker.plugin_name}_{seed}_{stream}_{total['pieces']:05d}.npz"
            np.savez_compressed(out / name, positions_w_m=piece)
            total["pieces"] += 1
            total["ticks"] += len(piece)
        total["falls"] += int(fell)
        total["segments"] += segments
        if progress is not None:
            progress(min(total["ticks"], ticks_each * parallel), ticks_each * parallel, {"strict": not fell})

    async with asyncio.TaskGroup() as group:
        for stream in range(parallel):
            settings = LOCKSTEP.model_copy(update={"plan_lead_ticks": LEADS_TICKS[stream % len(LEADS_TICKS)]})
            group.create_task(
                _stream(services, stream, task_seed(seed, stream), ticks_each, settings, planner, tracker, keep, kinds)
            )
    return {
        "pieces": total["pieces"],
        "minutes": round(total["ticks"] / TICK_HZ / 60, 2),
        "falls": total["falls"],
        "segments": total["segments"],
    }


def seat_of(scene: Scene, reference_w_m: Array) -> Array | None:
    """(5,) x, y and height of where a reference (T, 22, 3) sits on a scene's seat, its heading, and 1 for a sofa; None
    without a seat."""
    if SEAT_MARK not in scene.marks:
        return None
    place = mark_place(scene, SEAT_MARK)
    out = np.array([np.cos(place.heading_rad), np.sin(place.heading_rad)])
    left = np.array([-out[1], out[0]])
    half = place.half_size_m or USUAL_HALF_SIZE_M
    pelvis = reference_w_m[:, 0]
    aside = float((pelvis[np.argmin(pelvis[:, 2]), :2] - place.position_w_m[:2]) @ left)
    aside = float(np.clip(aside, -half[1], half[1]))
    xy = place.position_w_m[:2] + out * (half[0] - EDGE_M) + left * aside
    return np.array([*xy, place.position_w_m[2], place.heading_rad, float(half[1] > WIDE_M)], dtype=np.float32)


def plans_beside(plans: Sequence[Plan], trace: Trace, bag: str) -> list[tuple[Array, Array]]:
    """Plans made within reach of an object that stood, as pieces (T, 22, 3) at 30 Hz from the body's own pose on, each
    with (5,) x and y of the object and the way its axis pointed as the plan began."""
    if trace.world is None:
        return []
    position, axis = trace.world.position_m(bag), trace.world.axis(bag)
    out = []
    for plan in plans:
        row = plan.start_tick - trace.start_tick
        if not 0 <= row < len(trace) or trace.fallen[row] or axis[row, 2] < np.cos(GOING_RAD):
            continue
        body = trace.pos_w_m[row]
        if np.linalg.norm(body[0, :2] - position[row, :2]) < BESIDE_M:
            frames = np.concatenate([body[None], plan.positions_w_m])
            piece = resample(frames, plan.fps, TICK_HZ)[:BESIDE_TICKS].astype(np.float32)
            out.append((piece, np.append(position[row, :2], axis[row]).astype(np.float32)))
    return out


async def record_tasks(
    services: Services,
    out: Path,
    tasks: Sequence[str],
    episodes: int,
    seed: int,
    parallel: int = 8,
    planner: str | None = None,
    tracker: str | None = None,
    progress: Callable[[int, int, dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Record episodes of `eval tasks`, every second with sizes and heights varied, one .npz a stretch.

    Beside `positions_w_m` each file of a scene with a seat holds `seat` (5,), see `seat_of`. Of what is struck the
    plans made beside it are pieces too, `bag` (5,) with them, see `plans_beside`.

    Returns:
        {pieces, minutes, episodes, done}.

    Raises:
        UnavailableError: an episode could not be begun.
    """
    out.mkdir(parents=True, exist_ok=True)
    total = {"pieces": 0, "ticks": 0, "episodes": 0, "done": 0}
    gate = asyncio.Semaphore(parallel)

    async def one(task: str, index: int) -> None:
        spec = episode_spec((task, index), Measured(seed, "closed_loop", planner, tracker, index % 2 == 1))
        runner = EpisodeRunner(str(uuid.uuid4()), spec, services, EventLog())
        plans: list[Plan] = []
        runner.session.loop.on_plan.append(plans.append)
        async with gate:
            outcome = await runner.run()
            if not runner.session.created:
                raise UnavailableError(f"{task} {index} did not begin: {outcome.reason}")
            try:
                log = await runner.session.loop.ticks(0, runner.tick, TICK_HZ, reference=True)
            finally:
                await runner.session.close()
        reference = np.asarray(log.reference_pos_w_m, dtype=np.float32)
        found = pieces(reference, np.asarray(log.tracking_error_m), np.asarray(log.fallen, dtype=bool), TASKS_LOST_M)
        struck, scene = spec.tasks[-1], spec.scene
        bag = scene.marks[struck.mark].body if isinstance(struck, StrikeSpec) and isinstance(scene, Scene) else None
        if bag is not None:
            for number, (piece, place) in enumerate(plans_beside(plans, trace_of(log), bag)):
                name = f"{BESIDE}_{seed}_{index:04d}_{number}.npz"
                np.savez_compressed(out / name, positions_w_m=piece, bag=place)
                total["pieces"] += 1
                total["ticks"] += len(piece)
        seat = seat_of(spec.scene, reference) if isinstance(spec.scene, Scene) else None
        for number, piece in enumerate(found):
            known: dict[str, Any] = {} if seat is None else {"seat": seat}
            np.savez_compressed(out / f"{task}_{seed}_{index:04d}_{number}.npz", positions_w_m=piece, **known)
            total["pieces"] += 1
            total["ticks"] += len(piece)
        total["episodes"] += 1
        total["done"] += outcome.success
        if progress is not None:
            progress(total["episodes"], episodes * len(tasks), {"strict": outcome.success})

    async with asyncio.TaskGroup() as group:
        for task in tasks:
            for index in range(episodes):
                group.create_task(one(task, index))
    return {
        "pieces": total["pieces"], "minutes": round(total["ticks"] / TICK_HZ / 60, 2), "episodes": total["episodes"],
        "done": total["done"],
    }  # fmt: skip


def choose_goal(rng: np.random.Generator, state: StateFrame, kinds: KindsOption = "default") -> GoalSource:
    """A random text of the kinds of `eval text`, or a walk to a random point, with its own seed."""
    if rng.random() < REACH_SHARE:
        text = str(rng.choice(REACH_TEXTS, p=REACH_TEXT_SHARES))
        task = ReachTask(ReachSpec(text=text), int(rng.integers(1 << 31)))
        task.start(BodyView(state.tick, np.asarray(state.body_pos_w_m, dtype=np.float64), state.fallen))
        return task.goal
    shares = KIND_SHARES[kinds]
    kind = str(rng.choice(list(shares), p=list(shares.values())))
    texts = DEFAULT[kind] if kinds == "default" else [text for _, text in ALL[kind]]
    return CommandGoal(Command(text=str(rng.choice(texts))), state.tick)


async def _stream(
    services: Services, stream: int, seed: int, ticks: int, settings: LoopSettings, planner: str | None,
    tracker: str | None, keep: Callable[[int, list[Array], bool, int], None], kinds: KindsOption,
) -> None:  # fmt: skip
    rng = np.random.default_rng(seed)
    lost_m = LOST_M if kinds == "default" else TASKS_LOST_M
    heading = float(rng.uniform(-np.pi, np.pi))
    spec = CharacterSpec(pacing="lockstep", seed=seed, planner=planner, tracker=tracker, loop=settings)
    session = Session(str(uuid.uuid4()), spec, services, EventLog(), heading)
    state = await session.start()
    goal: GoalSource = CommandGoal(Command(text="a person is standing still."), state.tick)
    since, until, segments = state.tick, state.tick + TICK_HZ, 0
    while state.tick < ticks:
        if state.tick >= until:
            if kinds == "all" and leaning(state.body_pos_w_m):
                # Who has sat down on the floor is not asked to run from there.
                goal, until = CommandGoal(Command(text=UP_TEXT), state.tick), state.tick + UP_TICKS
            else:
                goal = choose_goal(rng, state, kinds)
                until = state.tick + round(rng.uniform(*SEGMENT_S) * TICK_HZ)
            segments += 1
            session.replan_now()
        state = (await session.cycle(goal)).state
        # A plan can walk on while the body lies there on purpose, until none of its plans is taken any more.
        lost = bool(state.fallen) or state.tracking_error_m > GONE_M
        if lost or state.tick - since >= 30 * TICK_HZ or state.tick >= ticks:
            log = await session.loop.ticks(since, state.tick, TICK_HZ, reference=True)
            reference = np.asarray(log.reference_pos_w_m, dtype=np.float32)
            found = pieces(reference, np.asarray(log.tracking_error_m), np.asarray(log.fallen, dtype=bool), lost_m)
            keep(stream, found, lost, segments)
            segments = 0
            if lost:
                state = await session.reset()
                goal = CommandGoal(Command(text="a person is standing still."), state.tick)
                until = state.tick + round(RESET_S * TICK_HZ)
            since = state.tick
    await session.close()
