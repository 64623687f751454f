"""The bank of recorded plans, made over the real services."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from orchestrator.core.command import CommandGoal
from orchestrator.core.services import Services, connect
from orchestrator.core.supervise import Stack
from orchestrator.evaluation.bank import (
    BESIDE_TICKS,
    KIND_SHARES,
    LEAST_TICKS,
    choose_goal,
    pieces,
    plans_beside,
    record_bank,
    record_tasks,
    seat_of,
)
from orchestrator.evaluation.commands import ALL
from shared.motion.ik import clip_from_positions, standing_clip
from shared.protocol.messages import Plan, StateFrame
from shared.scenes.files import load_scene
from shared.tasks.interface import Trace
from shared.tasks.world import World
from tests.orchestrator.support import light


def test_pieces_end_where_the_body_was_lost_or_fell() -> None:
    reference = np.arange(200, dtype=np.float32)[:, None, None] * np.ones((200, 22, 3), np.float32)
    error = np.zeros(200, np.float32)
    fallen = np.zeros(200, dtype=bool)
    error[60] = 1.0
    fallen[100:110] = True
    found = pieces(reference, error, fallen)
    # 0..59 is long enough, 61..99 (39 ticks) is not, 110..199 is.
    assert [(int(p[0, 0, 0]), len(p)) for p in found] == [(0, 60), (110, 90)]
    assert LEAST_TICKS == 45


def recorded(folder: Path, record: Callable[[Services], Awaitable[dict[str, Any]]]) -> dict[str, Any]:
    """What a recording on a planner that stands and a tracker without physics returns."""
    stack = Stack(light(folder), lambda line: None)

    async def run() -> dict[str, Any]:
        planner, tracker = stack.start_services()[:2]
        services = Services(await connect(planner, "planner", "stand"), await connect(tracker, "tracker", "kinematic"))
        try:
            return await record(services)
        finally:
            await services.close()

    try:
        return asyncio.run(run())
    finally:
        stack.stop()


def test_a_bank_holds_the_references_of_the_loop(tmp_path: Path) -> None:
    result = recorded(tmp_path, lambda on: record_bank(on, tmp_path / "bank", minutes=0.4, seed=3, parallel=2))
    files = sorted((tmp_path / "bank").glob("*.npz"))
    assert len(files) == result["pieces"] == 2
    height_m = float(standing_clip(1, 30).positions_w_m[0, :, 2].max())
    for path in files:
        with np.load(path) as data:
            positions = data["positions_w_m"]
        assert positions.shape[1:] == (22, 3)
        assert len(positions) >= 350
        # The planner stands and the tracker moves without physics: the reference stands all the time, on soft knees.
        assert np.abs(positions[..., 2].max(axis=1) - height_m).max() < 0.03


def test_all_kinds_of_commands_are_asked_for(tmp_path: Path) -> None:
    assert set(KIND_SHARES["all"]) == set(ALL)
    assert sum(KIND_SHARES["all"].values()) == pytest.approx(1.0)
    rng = np.random.default_rng(0)
    state = cast(StateFrame, SimpleNamespace(tick=0, body_pos_w_m=standing_clip(1, 30).positions_w_m[0], fallen=False))
    goals = [choose_goal(rng, state, "all") for _ in range(900)]
    asked = {goal.command.text for goal in goals if isinstance(goal, CommandGoal)}
    assert asked == {text for sentences in ALL.values() for _, text in sentences}


def test_a_bank_of_tasks_holds_what_was_planned_and_where_the_seat_is(tmp_path: Path) -> None:
    result = recorded(tmp_path, lambda on: record_tasks(on, tmp_path / "bank", ["sit", "halt"], 2, seed=3))
    files = sorted(path.name for path in (tmp_path / "bank").glob("*.npz"))
    assert files == ["halt_3_0000_0.npz", "halt_3_0001_0.npz", "sit_3_0000_0.npz", "sit_3_0001_0.npz"]
    assert (result["pieces"], result["episodes"]) == (4, 4)
    for name in files:
        with np.load(tmp_path / "bank" / name) as data:
            assert ("seat" in data) is name.startswith("sit")
            if "seat" in data:
                _, _, top, _, sofa = data["seat"]
                assert sofa == 1.0
                assert 0.15 < top < 0.65


def test_the_place_to_sit_is_behind_the_edge_where_the_body_is_lowest() -> None:
    (sofa,) = (scene := load_scene("sofa")).bodies
    scene = scene.model_copy(update={"bodies": (sofa.model_copy(update={"random": None}),)})
    body = np.repeat(standing_clip(3, 30).positions_w_m[:1], 3, axis=0)
    body[1] += [0.0, 0.7, -0.4]
    seat = seat_of(scene, body)
    assert seat is not None
    # The sofa stands at (-1.4, 0) and looks along X: its edge is at -1.4 + 0.1 + 0.33.
    np.testing.assert_allclose(seat, [-0.97 - 0.2, 0.7, 0.344, 0.0, 1.0], atol=1e-6)
    assert seat_of(load_scene("flat"), body) is None


def test_plans_beside_what_stands_are_kept_from_the_bodys_pose_on() -> None:
    stand = standing_clip(90, 30).positions_w_m
    pose = np.zeros((90, 1, 7))
    pose[..., 0], pose[..., 3] = 1.0, 1.0
    pose[60:, 0, 3:] = [np.cos(0.5), 0.0, np.sin(0.5), 0.0]  # over: leaning by a radian
    none = np.zeros(0, dtype=np.int64)
    world = World(("bag",), pose, np.zeros((90, 1, 6)), none, none, none, np.zeros(0))
    trace = Trace(0, stand, np.zeros(90, dtype=bool), world)
    ahead = np.repeat(stand[:1], 40, axis=0) + np.array([0.5, 0.0, 0.0])
    turns = clip_from_positions(ahead, 20, rebuild=True).rotations_6d
    plans = [
        Plan(planner="own", start_tick=tick, positions_w_m=ahead.astype(np.float32), rotations_6d=turns)
        for tick in (15, 75)
    ]
    ((piece, bag),) = plans_beside(plans, trace, "bag")
    np.testing.assert_allclose(bag, [1.0, 0.0, 0.0, 0.0, 1.0], atol=1e-6)
    assert piece.shape == (BESIDE_TICKS, 22, 3)
    np.testing.assert_allclose(piece[0], stand[15], atol=1e-6)
    np.testing.assert_allclose(piece[-1], ahead[-1], atol=1e-6)
    pose[..., 0] = 5.0
    assert plans_beside(plans, Trace(0, stand, trace.fallen, world), "bag") == []
    assert plans_beside(plans, Trace(0, stand, trace.fallen), "bag") == []
