"""What tasks see: stretches joined as they come, with the objects around and what was touched."""

from __future__ import annotations

import asyncio
import uuid

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.core.loop import CharacterLoop, view_of
from orchestrator.core.services import Services, connect
from orchestrator.core.settings import LOCKSTEP
from shared.errors import InvalidInputError
from shared.protocol.messages import FLOOR, CreateCharacter, StateFrame
from shared.tasks.growing import GrowingTrace
from shared.tasks.interface import BodyView, Trace, joined
from shared.tasks.world import World
from tests.orchestrator.test_planner_specs import gliding, hosting
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings


def stretch(start: int, ticks: int, objects: tuple[str, ...] = ("bag",)) -> Trace:
    """Places and impulses of a row are its tick; a foot is on the floor, a fist on the first object."""
    tick = np.arange(start, start + ticks, dtype=np.float64)
    wide = len(objects)
    world = World(
        objects,
        np.repeat(tick[:, None, None], wide, axis=1) * np.ones(7),
        np.zeros((ticks, wide, 6)),
        np.repeat(np.arange(ticks), 2),
        np.tile([10, 21], ticks),
        np.tile([FLOOR, 0], ticks),
        np.repeat(tick, 2) * np.tile([1.0, 0.5], ticks),
    )
    return Trace(start, tick[:, None, None] * np.ones((1, 22, 3)), tick % 2 == 0, world)


def same(a: Trace, b: Trace) -> None:
    assert a.start_tick == b.start_tick
    np.testing.assert_array_equal(a.pos_w_m, b.pos_w_m)
    np.testing.assert_array_equal(a.fallen, b.fallen)
    assert a.world is not None
    assert b.world is not None
    for name in ("pose_w", "velocity_w", "contact_row", "contact_body", "contact_object", "contact_impulse_ns"):
        np.testing.assert_array_equal(getattr(a.world, name), getattr(b.world, name))


@given(lengths=st.lists(st.integers(0, 300), min_size=1, max_size=8).filter(any), early=st.integers(0, 5))
def test_a_growing_trace_is_its_stretches_joined(lengths: list[int], early: int) -> None:
    """Rows from before its start are left out, and what was given out earlier does not change."""
    growing, begin = GrowingTrace(100), 100 - early
    first = None
    for length in lengths:
        growing.add(stretch(begin, length))
        begin += length
        if first is None and len(growing):
            first = growing.trace(), len(growing)
    whole = stretch(100 - early, sum(lengths)).since(100)
    if not len(whole):
        assert len(growing.trace()) == 0
        return
    same(growing.trace(), whole)
    assert first is not None
    np.testing.assert_array_equal(first[0].pos_w_m, whole.pos_w_m[: first[1]])


def test_parts_are_joined_and_cut_with_what_was_touched() -> None:
    whole = stretch(0, 30)
    same(joined([stretch(0, 10), stretch(10, 20)]), whole)
    same(whole.since(12), stretch(12, 18))
    assert len(whole.since(40)) == 0
    assert joined([stretch(0, 5), Trace(5, np.zeros((2, 22, 3)), np.zeros(2, bool))]).world is None
    assert joined([stretch(0, 5), stretch(5, 5, ("crate",))]).world is None, "another scene"
    other = GrowingTrace(0)
    other.add(stretch(0, 5))
    other.add(stretch(5, 5, ("crate",)))
    other.add(stretch(10, 5))
    assert other.trace().world is None
    assert len(other) == 15


def test_impulses_by_object_and_limb() -> None:
    world = stretch(0, 4).world
    assert world is not None
    np.testing.assert_array_equal(world.impulse_ns("bag"), [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_array_equal(world.impulse_ns("bag", ("left_wrist",)), np.zeros(4))
    np.testing.assert_array_equal(world.impulse_ns("floor", ("left_foot",)), [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(world.position_m("bag")[:, 0], [0, 1, 2, 3])
    with pytest.raises(InvalidInputError) as caught:
        world.position_m("seat")
    assert (caught.value.field, caught.value.allowed) == ("object", "bag")


def test_a_task_sees_a_real_scene() -> None:
    """Standing a second beside a bag: its place, and the body's weight on the floor through the feet."""

    async def look(planner: str, tracker: str) -> tuple[BodyView, Trace, Trace]:
        services = Services(await connect(planner, "planner"), await connect(tracker, "tracker"))
        loop = CharacterLoop(str(uuid.uuid4()), services, LOCKSTEP, seed=1)
        try:
            await loop.ask_tracker(StateFrame, CreateCharacter(scene="bag", tracker="pd"))
            await loop.step(30)
            state, seen = await loop.look(11)
            return view_of(state), seen, await loop.trace(11, 31)
        finally:
            await services.close()

    settings = TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", trackers=("pd",))
    with TrackerService(settings) as tracker, hosting(gliding(fps=20, prefix_frames=1, plan_frames=40)) as planner:
        view, seen, logged = asyncio.run(look(planner.endpoint, tracker.endpoint))
    same(seen, logged)
    assert (seen.start_tick, len(seen)) == (11, 20)
    assert seen.world is not None
    (name,) = view.objects
    np.testing.assert_allclose(view.objects[name][:3], seen.world.position_m(name)[-1], atol=1e-6)
    carried_n = seen.world.impulse_ns("floor").mean() * 30
    assert carried_n == pytest.approx(72.0 * 9.81, rel=0.1)
    assert seen.world.impulse_ns(name).max() == 0.0
