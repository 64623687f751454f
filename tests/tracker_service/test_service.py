"""Characters over real sockets, with real physics."""

from __future__ import annotations

import numpy as np
import pytest

from shared.motion.skeleton import CANONICAL
from shared.plugins.conformance import check_tracker_endpoint, require
from shared.protocol.control import Health, HealthReport, Ok
from shared.protocol.messages import (
    CloseCharacter,
    CreateCharacter,
    Impulse,
    Look,
    Observe,
    ResetCharacter,
    Restore,
    SetScene,
    SetTracker,
    Snapshot,
    StateFrame,
    TakeSnapshot,
    TickRange,
    TrackReply,
)
from shared.protocol.transport import ServiceClient, StateSubscriber
from tests.tracker_service.support import same, standing_plan, step, ticks, track
from tracker_service.policy.baselines import PdTracker
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid


def create(client: ServiceClient, character_id: str, **changes: object) -> StateFrame:
    message = CreateCharacter(tracker="pd", **changes)
    return client.ask(message, StateFrame, character_id, timeout_s=20.0)


def test_welcome_names_what_there_is(service: TrackerService, client: ServiceClient) -> None:
    welcome = client.connect()
    names = [plugin["name"] for plugin in welcome.plugins]
    assert {"pd", "kinematic"} <= set(names)
    assert welcome.default_plugin == names[0]
    assert welcome.state_endpoint == service.state_endpoint


def test_create_step_track_observe_close(client: ServiceClient) -> None:
    first = create(client, "life", position_w_m=(1.0, -2.0), heading_rad=np.pi / 2)
    assert (first.tick, first.pacing, first.scene, first.fallen) == (0, "lockstep", "flat", False)
    np.testing.assert_allclose(first.body_pos_w_m[0, :2], (1.0, -2.0), atol=1e-6)
    left_hip, right_hip = (first.body_pos_w_m[CANONICAL.index(n)] for n in ("left_hip", "right_hip"))
    assert left_hip[0] < right_hip[0] - 0.1, "facing +Y, the left side is toward -X"
    plan = standing_plan(40, xy_m=(1.0, -2.0))
    plan[..., :2] = np.stack([-(plan[..., 1] + 2.0) + 1.0, (plan[..., 0] - 1.0) - 2.0], axis=-1)  # turned to face +Y
    assert client.ask(track(0, plan), TrackReply, "life").entered_tick == 0
    after = step(client, "life", 30)
    assert after.tick == 30
    assert after.plan_end_tick == 60
    assert not after.fallen
    assert after.tracking_error_m < 0.08
    assert after.contacts.sum() >= 2
    seen = client.ask(Observe(), StateFrame, "life")
    np.testing.assert_array_equal(seen.body_pos_w_m, after.body_pos_w_m)
    assert client.ask(CloseCharacter(), Ok, "life") == Ok()


def test_kinematic_shows_the_plan_itself(client: ServiceClient) -> None:
    client.ask(CreateCharacter(tracker="kinematic"), StateFrame, "show", timeout_s=20.0)
    plan = standing_plan(40)
    client.ask(track(0, plan), TrackReply, "show")
    step(client, "show", 45)
    shown = ticks(client, "show", 15, 45, 20).body_pos_w_m
    np.testing.assert_allclose(shown, plan[9:29], atol=0.02)
    log = ticks(client, "show", 0, 45, 60)
    np.testing.assert_allclose(log.body_pos_w_m, log.reference_pos_w_m, atol=2e-3)


def test_rates_pick_recorded_samples(client: ServiceClient) -> None:
    create(client, "rates")
    client.ask(track(0, standing_plan(60)), TrackReply, "rates")
    step(client, "rates", 61)
    full = ticks(client, "rates", 0, 61, 60)
    assert len(full.body_pos_w_m) == 122
    for rate, stride in ((30, 2), (20, 3)):
        part = ticks(client, "rates", 0, 61, rate)
        for name in ("body_pos_w_m", "body_quat_w", "body_linvel_w_mps", "contacts", "reference_pos_w_m"):
            np.testing.assert_array_equal(getattr(part, name), getattr(full, name)[::stride])
    now = ticks(client, "rates", 61, 62, 30)
    np.testing.assert_array_equal(now.body_pos_w_m[0], client.ask(Observe(), StateFrame, "rates").body_pos_w_m)
    before = ticks(client, "rates", -15, 6, 20)
    assert len(before.body_pos_w_m) == 14
    np.testing.assert_array_equal(before.body_pos_w_m[:11], np.repeat(full.body_pos_w_m[:1], 11, axis=0))


def test_velocity_is_that_of_the_positions(client: ServiceClient) -> None:
    create(client, "velocity")
    client.ask(track(0, standing_plan(60, sway_rad=0.6)), TrackReply, "velocity")
    step(client, "velocity", 60)
    log = ticks(client, "velocity", 30, 60, 60)
    central = (log.body_pos_w_m[2:] - log.body_pos_w_m[:-2]) * 30.0
    speed = np.linalg.norm(central, axis=-1)
    error = np.linalg.norm(central - log.body_linvel_w_mps[1:-1], axis=-1)
    assert speed[:, CANONICAL.index("left_wrist")].max() > 1.0
    assert np.sqrt((error**2).mean()) < 0.07 * np.sqrt((speed**2).mean())


def test_the_log_leaves_memory_and_can_be_read(service: TrackerService, client: ServiceClient) -> None:
    create(client, "long")
    step(client, "long", 150)
    recorder = service.character("long").recorder
    assert recorder.spilled_chunks >= 5
    assert list(recorder.spool_dir.glob("*.npz"))
    once, again = ticks(client, "long", 0, 151), ticks(client, "long", 0, 151)
    assert len(once.body_pos_w_m) == 301
    assert same(once, again)
    client.ask(CloseCharacter(), Ok, "long")
    assert not recorder.spool_dir.exists()


def test_snapshot_goes_on_bit_for_bit(client: ServiceClient) -> None:
    create(client, "origin", seed=3)
    client.ask(track(0, standing_plan(60)), TrackReply, "origin")
    client.ask(Impulse(body="spine3", impulse_w_ns=(10.0, 5.0, 0.0)), Ok, "origin")
    step(client, "origin", 31)
    client.ask(Impulse(body="spine3", impulse_w_ns=(0.0, -8.0, 0.0)), Ok, "origin")
    shot = client.ask(TakeSnapshot(), Snapshot, "origin")
    step(client, "origin", 60)
    expected = ticks(client, "origin", 0, 92)
    restore = Restore(tick=shot.tick, meta=shot.meta, state=shot.state, buffers=shot.buffers)
    for target in ("copy", "origin"):
        assert client.ask(restore, StateFrame, target, timeout_s=10.0).tick == 31
        step(client, target, 60)
        assert same(ticks(client, target, 0, 92), expected), target


def test_an_impulse_moves_the_body_and_a_strong_one_fells_it(client: ServiceClient) -> None:
    for name in ("still", "pushed"):
        create(client, name)
    client.ask(Impulse(body="spine3", impulse_w_ns=(36.0, 0.0, 0.0)), Ok, "pushed")
    still, pushed = (step(client, name, 1) for name in ("still", "pushed"))
    gained = pushed.body_linvel_w_mps - still.body_linvel_w_mps
    assert gained[CANONICAL.index("spine3"), 0] > 0.2
    client.ask(Impulse(body="spine3", impulse_w_ns=(200.0, 0.0, 0.0)), Ok, "pushed")
    assert step(client, "pushed", 75).fallen
    frame = client.ask(ResetCharacter(), StateFrame, "pushed")
    assert not frame.fallen
    assert frame.tick >= 76
    assert frame.body_pos_w_m[CANONICAL.index("head"), 2] > 1.4
    assert frame.body_pos_w_m[0, 0] > 0.3, "it stands up where it lay"
    assert not step(client, "pushed", 9).fallen
    log = ticks(client, "pushed", 0, frame.tick + 10, 30)
    assert len(log.body_pos_w_m) == frame.tick + 10, "the clock has no holes"
    np.testing.assert_array_equal(log.body_pos_w_m[frame.tick], frame.body_pos_w_m)


def test_swapping_trackers_and_scenes_keeps_clock_and_log(client: ServiceClient) -> None:
    create(client, "swap")
    step(client, "swap", 6)
    client.ask(SetTracker(tracker="kinematic"), Ok, "swap")
    frame = step(client, "swap", 6)
    assert frame.tracker == "kinematic"
    assert frame.tracking_error_m < 1e-3
    frame = client.ask(SetScene(scene="flat"), StateFrame, "swap")
    assert frame.tick == 12
    assert frame.tracker == "kinematic"
    assert len(ticks(client, "swap", 0, 13, 30).body_pos_w_m) == 13


def test_late_plans(client: ServiceClient) -> None:
    create(client, "late")
    step(client, "late", 20)
    entered = client.ask(track(12, standing_plan(40)), TrackReply, "late")
    assert (entered.accepted, entered.entered_tick) == (True, 20)
    before = client.ask(Observe(), StateFrame, "late").plan_end_tick
    dropped = client.ask(track(9, standing_plan(60)), TrackReply, "late")
    assert not dropped.accepted
    assert "late" in (dropped.reason or "")
    over = client.ask(track(15, standing_plan(3)), TrackReply, "late")
    assert not over.accepted
    assert "ends" in (over.reason or "")
    assert client.ask(Observe(), StateFrame, "late").plan_end_tick == before


def test_a_plan_is_welcome_however_long_there_was_none(client: ServiceClient) -> None:
    """A planner that was away for longer than the reference holds (20 s) can be followed again."""
    client.ask(CreateCharacter(tracker="kinematic"), StateFrame, "long", timeout_s=20.0)
    step(client, "long", 900)
    assert client.ask(track(900, standing_plan(40)), TrackReply, "long").entered_tick == 900
    after = step(client, "long", 60)
    assert after.plan_end_tick == 960
    np.testing.assert_allclose(ticks(client, "long", 915, 945, 20).body_pos_w_m, standing_plan(40)[9:29], atol=0.02)


def test_frames_are_published(service: TrackerService, client: ServiceClient) -> None:
    create(client, "seen")
    subscriber = StateSubscriber(service.state_endpoint, "seen")
    frames: dict[str, StateFrame] = {}
    for _ in range(50):
        frame = step(client, "seen", 1)
        frames = subscriber.latest(timeout_s=0.1)
        if frames:
            break
    assert set(frames) == {"seen"}
    assert frames["seen"].tick == frame.tick
    subscriber.close()


def test_health_counts(client: ServiceClient) -> None:
    create(client, "healthy")
    report = client.ask(Health(), HealthReport)
    assert report.status == "ok"
    assert int(report.detail["characters"]) >= 1


def test_the_former_name_of_a_tracker_is_understood(client: ServiceClient, caplog: pytest.LogCaptureFixture) -> None:
    frame = client.ask(CreateCharacter(tracker="ppo"), StateFrame, "by-its-old-name")
    assert frame.tracker == "learned"
    assert any("'ppo' is called 'learned'" in record.getMessage() for record in caplog.records)
    client.ask(CloseCharacter(), Ok, "by-its-old-name")


def test_a_look_is_the_state_and_the_ticks_since(client: ServiceClient) -> None:
    client.ask(CreateCharacter(tracker="pd", scene="bag"), StateFrame, "looked", timeout_s=20.0)
    step(client, "looked", 920)
    state = client.ask(Observe(), StateFrame, "looked")
    seen = client.ask(Observe(since_tick=911), Look, "looked")
    assert same(seen.state(), state), "objects, contacts and all"
    log = ticks(client, "looked", 911, 921, 30)
    assert all(np.array_equal(getattr(seen, name), getattr(log, name)) for name in TickRange.model_fields)
    nothing_new = client.ask(Observe(since_tick=921), Look, "looked")
    assert (nothing_new.start_tick, len(nothing_new.fallen)) == (920, 1), "the present tick is always there"
    long_ago = client.ask(Observe(since_tick=0), Look, "looked")
    assert (long_ago.start_tick, len(long_ago.fallen)) == (21, 900)


@pytest.mark.parametrize("name", ["pd", "kinematic", "learned"])
def test_the_built_in_trackers_keep_the_contract(service: TrackerService, name: str) -> None:
    require(check_tracker_endpoint(service.endpoint, name))


def test_conformance_finds_what_a_tracker_declares_wrongly() -> None:
    class Boastful(PdTracker):
        def __init__(self) -> None:
            human = humanoid(HUMAN)
            super().__init__(human.damping / human.stiffness, human.skeleton.id)
            spaces = {"characters": ("human", "giant"), "action_spaces": ("codes", "other-codes")}
            self.spec = self.spec.model_copy(update=spaces)

    settings = TrackerServiceSettings(endpoint="tcp://127.0.0.1:0")
    with TrackerService(settings, trackers={"pd": Boastful}) as boasting:
        failed = [result for result in check_tracker_endpoint(boasting.endpoint) if not result.passed]
    assert [result.name for result in failed] == ["spec"]
    assert "giant" in failed[0].detail
