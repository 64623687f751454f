"""What conformance accepts, the loop can run: any rate, prefix, length and period of a planner, over real sockets."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from orchestrator.core.drivers import LockstepDriver
from orchestrator.core.loop import CharacterLoop
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import LOCKSTEP
from orchestrator.core.swap import swap
from planner_service.service.service import PlannerService
from planner_service.service.settings import PlannerSettings
from shared.errors import IncompatiblePeerError, InvalidInputError
from shared.plugins.conformance import LocalProbe, check_planner, check_planner_endpoint, require
from shared.plugins.interfaces import Planner, PlannerSpec
from shared.plugins.registry import PLANNERS, PluginRegistry
from shared.protocol.control import Ok
from shared.protocol.messages import (
    SERVO_TARGETS,
    CloseCharacter,
    CreateCharacter,
    JointTarget,
    Plan,
    PlanRequest,
    StateFrame,
)
from shared.protocol.rates import PLANNER_RATES, start_spacing
from shared.tasks.interface import BodyView, PlanGoal, Trace, joined
from tests.docs.test_examples import load
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid

OWN_RATE = load(Path(__file__).resolve().parents[2] / "examples" / "own_rate" / "own_rate.py")
GOAL_M = np.array([0.9, -0.4])
TICKS = 90


@pytest.fixture(scope="module")
def tracker() -> Iterator[TrackerService]:
    with TrackerService(TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("kinematic",))) as running:
        yield running


def gliding(**fields: object) -> Planner:
    """A planner that glides to its target, with a spec like this."""
    spec = PlannerSpec.model_validate(
        {"name": "own", "version": "1", "skeleton": "human22", "conditions": ("target",), **fields}
    )
    planner: Planner = OWN_RATE.OwnRatePlanner(spec, OWN_RATE.turning)
    return planner


def hosting(planner: Planner, endpoint: str = "tcp://127.0.0.1:0") -> PlannerService:
    registry: PluginRegistry[Planner] = PluginRegistry(PLANNERS, {planner.spec.name: lambda: planner}, ("own",))
    return PlannerService(PlannerSettings(endpoint=endpoint, max_wait_ms=0), registry=registry)


def goal(view: BodyView, plan_tick: int) -> PlanGoal:
    """The place to be at in two seconds from the beginning."""
    place = (float(GOAL_M[0]), float(GOAL_M[1]), 0.0)
    return PlanGoal(targets=(JointTarget(joint="traj", position_w_m=place, arrival_tick=max(60, plan_tick + 1)),))


async def drive(planner: str, tracker: str, then: str | None = None) -> tuple[Trace, int]:
    """Ninety ticks under `goal`, `then` planning from the thirtieth on: what happened, and how many plans were made."""
    services = Services(await connect(planner, "planner"), await connect(tracker, "tracker"))
    loop = CharacterLoop(str(uuid.uuid4()), services, LOCKSTEP, seed=1)
    try:
        driver = LockstepDriver(loop, await loop.ask_tracker(StateFrame, CreateCharacter()))
        parts, tick = [], 0
        while tick < TICKS:
            if then is not None and tick >= 30:
                await services.planner.client.close()
                services.planner, then = await connect(then, "planner"), None
            cycle = await driver.cycle(goal)
            assert cycle.planner_error is None
            assert all(plan.accepted for plan in cycle.plans)
            parts.append(cycle.trace)
            tick = cycle.state.tick
        await loop.ask_tracker(Ok, CloseCharacter())
        return joined(parts), loop.plans_made
    finally:
        await services.close()


@settings(max_examples=10)
@given(
    fps=st.sampled_from(PLANNER_RATES),
    prefix=st.integers(1, 60),
    plan=st.integers(4, 200),
    replan=st.none() | st.integers(1, 200),
)
@example(fps=8, prefix=60, plan=4, replan=1)
@example(fps=60, prefix=1, plan=4, replan=None)
@example(fps=40, prefix=60, plan=200, replan=200)
def test_what_conformance_accepts_the_loop_can_run(
    tracker: TrackerService, fps: int, prefix: int, plan: int, replan: int | None
) -> None:
    planner = gliding(fps=fps, prefix_frames=prefix, plan_frames=plan, replan_frames=replan)
    require(check_planner(LocalProbe(planner)))
    with hosting(planner) as service:
        trace, plans = asyncio.run(drive(service.endpoint, tracker.endpoint))
    assert len(trace) >= TICKS
    np.testing.assert_allclose(trace.pos_w_m[-1, 0, :2], GOAL_M, atol=0.02)
    steps_m = np.linalg.norm(np.diff(trace.pos_w_m[:, 0, :2], axis=0), axis=-1)
    assert steps_m.max() < 1.4 * np.linalg.norm(GOAL_M) / 60, "an even glide: no frame is lost or shown twice"
    if replan is not None:
        starts_every = start_spacing(fps)
        lasts_ticks = min(plan, max(2 * fps, replan)) * 30 // fps  # two seconds, or its own period, if it can
        period = max(min(replan * 30 // fps, lasts_ticks) // starts_every, 1) * starts_every
        assert plans == -(-TICKS // period)


@pytest.mark.parametrize(("before", "after"), [(20, 30), (60, 8), (5, 40)])
def test_a_planner_of_another_rate_takes_over_on_the_way(tracker: TrackerService, before: int, after: int) -> None:
    old, new = (gliding(fps=fps, prefix_frames=fps // 4, plan_frames=3 * fps) for fps in (before, after))
    with hosting(old) as first, hosting(new) as second:
        trace, _ = asyncio.run(drive(first.endpoint, tracker.endpoint, then=second.endpoint))
    np.testing.assert_allclose(trace.pos_w_m[-1, 0, :2], GOAL_M, atol=0.02)
    steps_m = np.linalg.norm(np.diff(trace.pos_w_m[:, 0, :2], axis=0), axis=-1)
    assert steps_m.max() < 1.5 * np.linalg.norm(GOAL_M) / 60
    assert steps_m[20:55].min() > 0.5 * np.linalg.norm(GOAL_M) / 60, "it never stops on the way"


def test_a_planner_that_comes_back_as_another_is_taken_as_it_is(tracker: TrackerService) -> None:
    """Restarted with another rate and prefix at the same address: the loop goes on by what it says then."""

    async def go(address: str) -> tuple[np.ndarray, list[str | None], list[int]]:
        services = Services(await connect(address, "planner"), await connect(tracker.endpoint, "tracker"))
        loop = CharacterLoop(str(uuid.uuid4()), services, LOCKSTEP, seed=1)
        troubles, rates = [], []
        try:
            driver = LockstepDriver(loop, await loop.ask_tracker(StateFrame, CreateCharacter()))
            for cycle_number in range(8):
                if cycle_number == 2:
                    running[0].stop()
                    running.append(hosting(new, address).start())
                cycle = await driver.cycle(goal)
                troubles.append(cycle.planner_error)
                if cycle.plans and loop.last_plan is not None:
                    rates.append(loop.last_plan.fps)
            return np.asarray(cycle.state.body_pos_w_m)[0, :2], troubles, rates
        finally:
            await services.close()

    old, new = gliding(fps=20, prefix_frames=20, plan_frames=40), gliding(fps=30, prefix_frames=5, plan_frames=60)
    running = [hosting(old).start()]
    try:
        place, troubles, rates = asyncio.run(go(running[0].endpoint))
    finally:
        for service in running:
            service.stop()
    assert [trouble for trouble in troubles if trouble is not None] == [troubles[2]]
    assert "another one" in (troubles[2] or "")
    assert (rates[:2], set(rates[2:])) == ([20, 20], {30})
    np.testing.assert_allclose(place, GOAL_M, atol=0.02)


@pytest.mark.parametrize(
    ("wrong", "field", "allowed"),
    [
        ({"fps": 25}, "fps", "20, 24, 30"),
        ({"fps": 120}, "fps", "20, 24, 30"),
        ({"prefix_frames": 61}, "prefix_frames", "<= 60"),
        ({"plan_frames": 3}, "plan_frames", ">= 4"),
    ],
)
def test_what_the_loop_cannot_run_conformance_refuses_by_name(
    tracker: TrackerService, wrong: dict[str, int], field: str, allowed: str
) -> None:
    planner = gliding(fps=20, prefix_frames=20, plan_frames=40)
    planner.spec = planner.spec.model_copy(update=wrong)  # type: ignore[misc]  # as a service of others may declare
    with hosting(planner) as service:
        (refused,) = check_planner_endpoint(service.endpoint)
        assert (refused.name, refused.passed) == ("handshake", False)
        assert field in refused.detail
        for refusing in (drive, swap_in):
            with pytest.raises(IncompatiblePeerError) as caught:
                asyncio.run(refusing(service.endpoint, tracker.endpoint))
            assert caught.value.field == field
            assert allowed in (caught.value.allowed or "")


async def swap_in(planner: str, tracker: str) -> None:
    """Put the planner in a slot that holds another."""
    with hosting(gliding(fps=20, prefix_frames=1, plan_frames=4)) as present:
        services = Services(await connect(present.endpoint, "planner"), await connect(tracker, "tracker"))
        kept = services.planner
        try:
            await swap(services, "planner", planner, None)
        finally:
            assert services.planner is kept
            await services.close()


class Puppeteer:
    """A planner that holds still and says what the servos should do, half a second at a time."""

    def __init__(self, space: str, hinges: int):
        self._inner = gliding(fps=30, prefix_frames=1, plan_frames=30, replan_frames=15, conditions=("text",))
        self.spec = self._inner.spec
        self._space, self._hinges = space, hinges

    def plan(self, requests: list[PlanRequest]) -> list[Plan]:
        return [self._with_actions(plan) for plan in self._inner.plan(requests)]

    def _with_actions(self, plan: Plan) -> Plan:
        ticks = np.arange(plan.start_tick, plan.start_tick + 60)
        actions = np.repeat(0.01 * ticks[:, None], self._hinges, axis=1)
        if plan.start_tick >= 30:
            return plan
        return plan.model_copy(update={"actions": actions.astype("<f4"), "action_space": self._space})


async def pull(planner: str, tracker: str) -> np.ndarray:
    """(46, H) servo targets of a second and a half, by the log."""
    services = Services(await connect(planner, "planner"), await connect(tracker, "tracker"))
    loop = CharacterLoop(str(uuid.uuid4()), services, LOCKSTEP, seed=1)
    try:
        driver = LockstepDriver(loop, await loop.ask_tracker(StateFrame, CreateCharacter(tracker="pd")))
        for _ in range(3):
            await driver.cycle(lambda view, tick: PlanGoal(text="x"))
        return np.asarray((await loop.ticks(0, 46, 30)).servo_target_rad)
    finally:
        await services.close()


def test_actions_reach_the_servos_and_a_plan_without_them_ends_them() -> None:
    """The plans at ticks 0 and 15 have two seconds of targets; the third has none: `pd` follows its pose again."""
    with TrackerService(TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("pd",))) as tracker:
        with hosting(Puppeteer(SERVO_TARGETS, len(humanoid(HUMAN).hinges))) as planner:
            targets = asyncio.run(pull(planner.endpoint, tracker.endpoint))
        chosen = 0.01 * np.arange(46)[:, None] * np.ones(targets.shape[1])
        np.testing.assert_allclose(targets[1:31], chosen[:30], atol=1e-6)
        assert np.abs(np.diff(targets[36:], axis=0)).max() < 0.003, "the plan holds its pose, the chunk would go on"
        with (
            hosting(Puppeteer("codes", 4)) as alien,
            pytest.raises(InvalidInputError, match="takes no actions in the space 'codes'"),
        ):
            asyncio.run(pull(alien.endpoint, tracker.endpoint))
