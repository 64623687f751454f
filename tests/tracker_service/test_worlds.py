"""Scenes, objects, characters and broken trackers over real sockets."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from shared.errors import ConflictError, InvalidInputError, NotFoundError
from shared.motion.characters import build
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import TrackerObservation, TrackerSpec
from shared.protocol.control import Ok
from shared.protocol.messages import (
    CreateCharacter,
    Observe,
    ResetCharacter,
    Restore,
    SetObject,
    SetPacing,
    SetScene,
    SetTracker,
    Snapshot,
    StateFrame,
    TakeSnapshot,
    TrackReply,
)
from shared.protocol.transport import ServiceClient, StateSubscriber
from tests.tracker_service.support import same, standing_plan, step, ticks, track
from tracker_service.policy.baselines import PdTracker
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid

TABLE = {
    "bodies": [
        {"name": "table", "shape": "box", "size_m": [0.4, 0.6, 0.36], "position_w_m": [2, 0, 0.36]},
        {"name": "red", "shape": "sphere", "size_m": [0.1], "mass_kg": 0.5, "position_w_m": [2, 0.3, 0.82]},
        {"name": "blue", "shape": "sphere", "size_m": [0.1], "mass_kg": 0.5, "position_w_m": [2, -0.3, 1.5]},
    ]
}


class Broken:
    """A tracker that drives by the reference until it is told to raise."""

    def __init__(self) -> None:
        human = humanoid(HUMAN)
        self._pd = PdTracker(human.damping / human.stiffness, human.skeleton.id)
        self.spec = TrackerSpec(name="broken", version="1", skeleton="human22", fps=30)
        self.victims: set[str] = set()

    def reset(self, character_ids: Sequence[str]) -> None:
        self._pd.reset(character_ids)

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> npt.NDArray[np.floating]:
        if self.victims & set(character_ids):
            raise ZeroDivisionError("by a plug-in")
        return self._pd.act(character_ids, observations)


@pytest.fixture
def broken() -> Broken:
    return Broken()


@pytest.fixture
def own(tmp_path: Path, broken: Broken) -> Iterator[TrackerService]:
    """A service with a folder of scenes of its own and a tracker that may break."""
    (tmp_path / "den.yaml").write_text("name: den\nmarks: {exit: {position_w_m: [1, 0, 0]}}")
    (tmp_path / "odd.yaml").write_text(
        "name: odd\nbodies:\n  - {name: a, shape: box, size_m: [1], position_w_m: [0, 0, 0]}"
    )
    settings = TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", spool_dir=tmp_path / "spool", scenes=tmp_path)
    human = humanoid(HUMAN)
    factories = {"pd": lambda: PdTracker(human.damping / human.stiffness, human.skeleton.id), "broken": lambda: broken}
    with TrackerService(settings, trackers=factories) as running:
        yield running


@pytest.fixture
def mine(own: TrackerService) -> Iterator[ServiceClient]:
    with ServiceClient(own.endpoint, "tracker") as connected:
        yield connected


def test_an_inline_scene_is_simulated_and_logged(client: ServiceClient) -> None:
    create = CreateCharacter(tracker="pd", scene=TABLE)
    first = client.ask(create, StateFrame, "inline", timeout_s=20.0)
    assert (first.scene, first.objects) == ("inline", ["table", "red", "blue"])
    after = step(client, "inline", 30)
    assert after.object_pos_w_m[2, 2] == pytest.approx(0.82, abs=0.02), "it fell on the table"
    log = ticks(client, "inline", 0, 31, 30)
    np.testing.assert_array_equal(log.object_pose_w[-1, :, :3], after.object_pos_w_m)
    np.testing.assert_array_equal(log.object_vel_w[-1, :, :3], after.object_linvel_w_mps)
    falling = log.object_vel_w[6, 2, 2]
    assert falling == pytest.approx(-9.81 * 0.2, rel=0.03)


def test_contacts_of_a_tick_are_the_sum_of_its_steps(client: ServiceClient) -> None:
    client.ask(CreateCharacter(tracker="pd", scene=TABLE), StateFrame, "touch", timeout_s=20.0)
    after = step(client, "touch", 20)
    assert set(after.contact_object.tolist()) == {-1}
    names = {CANONICAL.names[body] for body in after.contact_body}
    assert names <= {"left_ankle", "left_foot", "right_ankle", "right_foot"}
    fine, coarse = ticks(client, "touch", 0, 21, 120), ticks(client, "touch", 0, 21, 30)
    for tick in range(1, 21):
        steps = (fine.contact_sample > 4 * (tick - 1)) & (fine.contact_sample <= 4 * tick)
        whole = coarse.contact_sample == tick
        assert coarse.contact_impulse_ns[whole].sum() == pytest.approx(fine.contact_impulse_ns[steps].sum(), rel=1e-5)
    last = coarse.contact_sample == 20
    np.testing.assert_array_equal(coarse.contact_impulse_ns[last], after.contact_impulse_ns)
    np.testing.assert_array_equal(coarse.contact_body[last], after.contact_body)


def test_an_object_is_moved_while_it_runs(client: ServiceClient) -> None:
    client.ask(CreateCharacter(tracker="pd", scene=TABLE), StateFrame, "move", timeout_s=20.0)
    step(client, "move", 3)
    moved = SetObject(name="red", position_w_m=(0.0, 3.0, 1.0), linvel_w_mps=(1.0, 0.0, 0.0))
    frame = client.ask(moved, StateFrame, "move")
    assert frame.tick == 3
    log = ticks(client, "move", 0, 4, 30)
    assert frame.contact_impulse_ns.sum() > 10.0, "what was touched in the tick was touched all the same"
    np.testing.assert_array_equal(log.contact_impulse_ns[log.contact_sample == 3], frame.contact_impulse_ns)
    np.testing.assert_allclose(frame.object_pos_w_m[1], [0, 3, 1])
    np.testing.assert_allclose(frame.object_linvel_w_mps[1], [1, 0, 0])
    np.testing.assert_allclose(ticks(client, "move", 3, 4, 30).object_pose_w[0, 1, :3], [0, 3, 1], atol=1e-6)
    after = step(client, "move", 9)
    assert after.object_pos_w_m[1, 0] == pytest.approx(0.3, abs=0.01)
    with pytest.raises(InvalidInputError, match="table is fixed") as caught:
        client.ask(SetObject(name="table", linvel_w_mps=(1.0, 0.0, 0.0)), StateFrame, "move")
    assert caught.value.field == "linvel_w_mps"
    with pytest.raises(InvalidInputError, match="unknown object 'green'") as caught:
        client.ask(SetObject(name="green", position_w_m=(0.0, 0.0, 0.0)), StateFrame, "move")
    assert caught.value.allowed == "table, red, blue"


def test_a_snapshot_carries_its_scene(client: ServiceClient) -> None:
    client.ask(CreateCharacter(tracker="pd", scene=TABLE), StateFrame, "origin", timeout_s=20.0)
    client.ask(track(0, standing_plan(40), may_be_low=True), TrackReply, "origin")
    step(client, "origin", 9)
    client.ask(SetObject(name="table", position_w_m=(3.0, 0.0, 0.36)), StateFrame, "origin")
    shot = client.ask(TakeSnapshot(), Snapshot, "origin")
    restore = Restore(tick=shot.tick, meta=shot.meta, state=shot.state, buffers=shot.buffers)
    client.ask(restore, StateFrame, "copy", timeout_s=20.0)
    first, second = step(client, "origin", 15), step(client, "copy", 15)
    assert same(first, second.model_copy(update={"character_id": "origin"}))
    np.testing.assert_allclose(second.object_pos_w_m[0], [3, 0, 0.36])
    assert same(ticks(client, "origin", 0, 25, 60), ticks(client, "copy", 0, 25, 60))
    client.ask(SetScene(scene="flat"), StateFrame, "copy")
    with pytest.raises(ConflictError, match="in scene 'flat'"):
        client.ask(restore, StateFrame, "copy")


def test_the_seed_draws_a_scene(client: ServiceClient) -> None:
    places = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        frame = client.ask(CreateCharacter(tracker="pd", scene="bag", seed=seed), StateFrame, f"seed-{name}")
        places.append(frame.object_pos_w_m[0])
    np.testing.assert_array_equal(places[0], places[1])
    assert not np.array_equal(places[0], places[2])


def test_a_folder_of_ones_own(mine: ServiceClient) -> None:
    assert mine.ask(CreateCharacter(tracker="pd", scene="den"), StateFrame, "den").scene == "den"
    with pytest.raises(NotFoundError) as unknown:
        mine.ask(SetScene(scene="moon"), StateFrame, "den")
    assert {"den", "flat", "bag"} <= set(str(unknown.value.allowed).split(", "))
    with pytest.raises(InvalidInputError, match=r"odd\.yaml line 3: .*a box takes 3 sizes"):
        mine.ask(SetScene(scene="odd"), StateFrame, "den")
    with pytest.raises(InvalidInputError, match="is not a body"):
        mine.ask(SetScene(scene={"marks": {"x": {"body": "y", "position_b_m": [0, 0, 0]}}}), StateFrame, "den")
    assert mine.ask(Observe(), StateFrame, "den").scene == "den"


def test_a_child_is_hosted_and_follows_a_plan_of_its_size(client: ServiceClient) -> None:
    frame = client.ask(CreateCharacter(character="child", tracker="kinematic"), StateFrame, "child")
    assert frame.character == "child"
    plan = standing_plan(40) * build("child").world_scale
    with pytest.raises(InvalidInputError) as caught:
        client.ask(track(0, plan), TrackReply, "child")
    assert (caught.value.field, caught.value.allowed) == ("skeleton", "child22")
    assert client.ask(track(0, plan, skeleton="child22"), TrackReply, "child").accepted
    after = step(client, "child", 30)
    assert after.tracking_error_m < 0.01
    assert after.body_pos_w_m[CANONICAL.index("head"), 2] == pytest.approx(1.05, abs=0.06)
    with pytest.raises(InvalidInputError, match="unknown character 'giant'"):
        client.ask(CreateCharacter(character="giant"), StateFrame, "giant")


def test_a_tracker_that_raises_is_a_visible_failure_in_lockstep(mine: ServiceClient, broken: Broken) -> None:
    for name in ("bad", "good"):
        mine.ask(CreateCharacter(tracker="broken"), StateFrame, name)
    broken.victims = {"bad"}
    failed = step(mine, "bad", 9)
    assert failed.tick == 9
    assert "failed in act at tick 0: ZeroDivisionError: by a plug-in" in str(failed.failure)
    assert step(mine, "bad", 1).failure is not None, "it stays until something is done about it"
    assert step(mine, "good", 9).failure is None
    broken.victims = set()
    mine.ask(track(12, standing_plan(20)), TrackReply, "bad")
    assert step(mine, "bad", 3).failure is None
    broken.victims = {"bad"}
    assert step(mine, "bad", 1).failure is not None
    assert mine.ask(ResetCharacter(), StateFrame, "bad").failure is None
    assert step(mine, "bad", 1).failure is not None
    mine.ask(SetTracker(tracker="pd"), Ok, "bad")
    assert step(mine, "bad", 1).failure is None


def test_a_tracker_that_raises_does_not_stop_a_realtime_clock(
    own: TrackerService, mine: ServiceClient, broken: Broken
) -> None:
    broken.victims = {"bad"}
    watching = StateSubscriber(own.state_endpoint, "bad", "good")
    try:
        for name in ("bad", "good"):
            mine.ask(CreateCharacter(tracker="broken", pacing="realtime"), StateFrame, name)
        latest: dict[str, StateFrame] = {}
        while min((latest[name].tick if name in latest else 0) for name in ("bad", "good")) < 5:
            fresh = watching.latest(20.0)
            assert fresh, "the clocks stand still"
            latest.update(fresh)
    finally:
        watching.close()
    assert "ZeroDivisionError" in str(latest["bad"].failure)
    assert latest["good"].failure is None


def test_a_tick_that_breaks_is_a_visible_failure_and_the_clock_goes_on(
    own: TrackerService, mine: ServiceClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    mine.ask(CreateCharacter(tracker="pd"), StateFrame, "bug")
    simulation = own.character("bug").simulation
    real, calls = simulation.step, []

    def breaks_at_the_third(count: int) -> object:
        calls.append(count)
        if len(calls) == 3:
            raise KeyError("a bug")
        return real(count)

    monkeypatch.setattr(simulation, "step", breaks_at_the_third)
    with caplog.at_level(logging.ERROR):
        frame = step(mine, "bug", 5)
    assert (frame.tick, frame.failure is not None) == (3, True), "two ticks, then reset to the next one divisible by 3"
    assert "KeyError: 'a bug'" in str(frame.failure)
    mine.ask(SetPacing(pacing="realtime"), StateFrame, "bug")
    mine.ask(SetPacing(pacing="lockstep"), StateFrame, "bug")
    assert step(mine, "bug", 5).failure is None
