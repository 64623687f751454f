"""Time keeping: hand-computed for the rules, a real clock for the thread (bounds only, nothing tight)."""

from __future__ import annotations

import threading

import numpy as np
import numpy.typing as npt
import pytest

from shared.protocol.control import Ok
from shared.protocol.messages import (
    CloseCharacter,
    CreateCharacter,
    ResetCharacter,
    SetPacing,
    StateFrame,
    Step,
    TrackReply,
)
from shared.protocol.transport import ServiceClient, StateSubscriber
from tests.tracker_service.support import standing_plan, track
from tracker_service.service.realtime import PERIOD_S, keep_time
from tracker_service.service.service import TrackerService
from tracker_service.simulation.reference import ReferenceBuffer


@pytest.mark.parametrize(
    ("late_periods", "missed", "next_periods"),
    [
        (0.1, 0, 1),  # in time
        (0.99, 0, 1),  # late by less than a tick is not missed
        (1.5, 1, 1),  # missed, the next is due at once
        (5.5, 1, 1),  # behind by four and a half: caught up tick by tick
        (7.5, 7, 7),  # behind by six and a half: itself and six skipped ones are missed
        (40.5, 40, 40),
    ],
)
def test_missed_and_skipped_ticks(late_periods: float, missed: int, next_periods: int) -> None:
    due = keep_time(10.0, 10.0 + late_periods * PERIOD_S, catch_up_ticks=6)
    assert due.missed_ticks == missed
    assert due.next_due_s == pytest.approx(10.0 + next_periods * PERIOD_S)


def create(client: ServiceClient, character_id: str) -> StateFrame:
    return client.ask(CreateCharacter(pacing="realtime"), StateFrame, character_id, timeout_s=20.0)


def frames_until(subscriber: StateSubscriber, character_id: str, tick: int) -> StateFrame:
    for _ in range(400):
        frame = subscriber.latest(timeout_s=5.0).get(character_id)
        if frame is not None and frame.tick >= tick:
            return frame
    raise AssertionError(f"tick {tick} never came")


def test_runs_by_itself_follows_a_plan_and_outlives_it(service: TrackerService, client: ServiceClient) -> None:
    subscriber = StateSubscriber(service.state_endpoint, "rt")
    frame = create(client, "rt")
    reply = client.ask(track(0, standing_plan(10)), TrackReply, "rt")
    assert reply.accepted
    assert reply.tick < 9
    frame = frames_until(subscriber, "rt", 45)
    assert frame.pacing == "realtime"
    assert frame.plan_end_tick == 15
    paused = client.ask(SetPacing(pacing="realtime", paused=True), StateFrame, "rt")
    assert paused.paused
    subscriber.latest(timeout_s=0.2)
    assert subscriber.latest(timeout_s=0.2) == {}
    resumed = client.ask(SetPacing(pacing="realtime"), StateFrame, "rt")
    assert resumed.tick == paused.tick
    frames_until(subscriber, "rt", paused.tick + 3)
    client.ask(ResetCharacter(position_w_m=(1.0, 2.0), heading_rad=0.5), StateFrame, "rt")
    lockstep = client.ask(SetPacing(pacing="lockstep"), StateFrame, "rt")
    after = client.ask(Step(ticks=2), StateFrame, "rt")
    assert after.tick == lockstep.tick + 2
    assert client.request(CloseCharacter(), "rt") == Ok()
    subscriber.close()


def test_a_blocked_character_holds_up_no_other(service: TrackerService, client: ServiceClient) -> None:
    create(client, "slow")
    create(client, "quick")
    slow = service.character("slow")
    subscriber = StateSubscriber(service.state_endpoint, "quick")
    with slow._lock:
        blocked_at = slow.tick
        reached = threading.Event()

        def watch() -> None:
            frames_until(subscriber, "quick", service.character("quick").tick + 15)
            reached.set()

        thread = threading.Thread(target=watch)
        thread.start()
        assert reached.wait(20.0)
        assert slow.tick == blocked_at
    thread.join()
    subscriber.close()


@pytest.mark.parametrize("reset", [False, True])
def test_ticks_go_on_while_a_plan_is_prepared(
    reset: bool, service: TrackerService, client: ServiceClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    client.ask(CreateCharacter(tracker="kinematic"), StateFrame, f"busy-{reset}")
    hosted = service.character(f"busy-{reset}")
    simulation = hosted.simulation
    prepare, begun, go_on = simulation.prepared_reference, threading.Event(), threading.Event()

    def slowly(start_tick: int, positions: npt.NDArray[np.floating], fps: int) -> ReferenceBuffer:
        prepared = prepare(start_tick, positions, fps)
        begun.set()
        assert go_on.wait(20.0)
        return prepared

    monkeypatch.setattr(simulation, "prepared_reference", slowly)
    replies: list[TrackReply] = []
    thread = threading.Thread(target=lambda: replies.append(hosted.track(track(0, standing_plan(40)))))
    thread.start()
    assert begun.wait(20.0)
    assert hosted.advance(3).tick == 3, "not held up by the plan"
    if reset:
        hosted.reset((1.0, 0.0), None)
        assert hosted.frame().plan_end_tick == 3
    go_on.set()
    thread.join(20.0)
    assert [(reply.accepted, reply.entered_tick) for reply in replies] == [(True, 3)]
    assert hosted.frame().plan_end_tick == 60
    if reset:  # the plan came on top of the new stand, which was not undone
        assert simulation.reference.at(3).pos_w_m[0, 0, 0] == pytest.approx(1.0, abs=0.01)
