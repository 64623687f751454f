"""Bad input gets an error that names field and allowed values, and changes nothing; failing physics is survived."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq

from shared.errors import ConflictError, InvalidInputError, MotionLoopError, NotFoundError, OverloadedError
from shared.motion.skeleton import CANONICAL
from shared.plugins.interfaces import TrackerObservation, TrackerSpec
from shared.protocol.base import Message
from shared.protocol.codec import decode, encode
from shared.protocol.control import Envelope, ErrorReply
from shared.protocol.messages import (
    SERVO_TARGETS,
    CreateCharacter,
    GetTicks,
    Impulse,
    Observe,
    Render,
    ResetCharacter,
    Restore,
    SetPacing,
    SetScene,
    SetTracker,
    Snapshot,
    StateFrame,
    Step,
    TakeSnapshot,
    TrackReply,
)
from shared.protocol.transport import ServiceClient
from tests.tracker_service.support import standing_plan, step, ticks, track
from tracker_service.policy.baselines import PdTracker
from tracker_service.service.log_tail import split_buffers
from tracker_service.service.service import TrackerService
from tracker_service.service.settings import TrackerServiceSettings
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid


def far(frames: int = 5) -> np.ndarray[Any, Any]:
    return standing_plan(frames) + np.array([50.0, 0.0, 0.0])


def jerky() -> np.ndarray[Any, Any]:
    plan = standing_plan(5)
    plan[3, CANONICAL.index("left_wrist"), 2] += 2.0
    return plan


CASES: list[tuple[str, Message, type[MotionLoopError], str, str]] = [
    ("unknown scene", SetScene(scene="moon"), NotFoundError, "scene", "flat"),
    ("unknown tracker", SetTracker(tracker="psychic"), InvalidInputError, "tracker", "pd"),
    ("another skeleton", track(0, standing_plan(5), skeleton="robot"), InvalidInputError, "skeleton", "human22"),
    ("a joint far away", track(0, far()), InvalidInputError, "positions_w_m", "within"),
    ("too fast", track(0, jerky()), InvalidInputError, "positions_w_m", "30 m/s"),
    ("no frames", track(0, np.zeros((0, 22, 3))), InvalidInputError, "positions_w_m", "1 to"),
    ("far ahead", track(300, standing_plan(5)), InvalidInputError, "start_tick", "<="),
    (
        "actions of the wrong width",
        track(0, standing_plan(5), actions=np.zeros((3, 7)), action_space=SERVO_TARGETS),
        InvalidInputError,
        "actions",
        "(A,",
    ),
    (
        "actions of another tracker",
        track(0, standing_plan(5), actions=np.zeros((3, 7)), action_space="latent"),
        InvalidInputError,
        "action_space",
        "servo_targets",
    ),
    (
        "a snapshot of version 1",
        Restore(tick=0, meta={"character": "human"}, state=np.zeros(1), buffers=np.zeros(1, "|u1")),
        InvalidInputError,
        "meta.format",
        "2",
    ),
    ("unknown body", Impulse(body="tail", impulse_w_ns=(1, 0, 0)), InvalidInputError, "body", "left_wrist"),
    ("too strong", Impulse(body="pelvis", impulse_w_ns=(9e3, 0, 0)), InvalidInputError, "impulse_w_ns", "<="),
    ("the future", GetTicks(start_tick=0, stop_tick=99), InvalidInputError, "stop_tick", "<="),
    ("backwards", GetTicks(start_tick=2, stop_tick=1), InvalidInputError, "start_tick", "<= 1"),
    ("too much", GetTicks(start_tick=-(10**6), stop_tick=1), InvalidInputError, "stop_tick", "20000"),
    ("an empty video", Render(start_tick=5, stop_tick=5), InvalidInputError, "stop_tick", "6 to"),
    ("a video of the future", Render(stop_tick=99), InvalidInputError, "stop_tick", "<="),
    ("a second one", CreateCharacter(), ConflictError, "character_id", ""),
    (
        "a snapshot of nothing",
        Restore(tick=0, meta={"format": 2}, state=np.zeros(1), buffers=np.zeros(1, "|u1")),
        InvalidInputError,
        "meta.character",
        "name",
    ),
]


@pytest.fixture
def victim(service: TrackerService, client: ServiceClient) -> str:
    """A lockstep character at tick 4."""
    if "victim" not in service._characters:
        client.ask(CreateCharacter(tracker="pd"), StateFrame, "victim", timeout_s=20.0)
        step(client, "victim", 4)
    return "victim"


@pytest.mark.parametrize(("message", "error", "field", "allowed"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
def test_bad_input(
    client: ServiceClient, victim: str, message: Message, error: type[MotionLoopError], field: str, allowed: str
) -> None:
    before = client.ask(TakeSnapshot(), Snapshot, victim)
    with pytest.raises(error) as caught:
        client.request(message, victim, timeout_s=10.0)
    assert caught.value.field == field
    assert allowed in (caught.value.allowed or "")
    after = client.ask(TakeSnapshot(), Snapshot, victim)
    np.testing.assert_array_equal(before.state, after.state)
    assert before.meta == after.meta


def test_messages_refuse_what_is_not_finite_or_misshapen() -> None:
    plan = standing_plan(5)
    plan[2, 3, 1] = np.nan
    with pytest.raises(ValueError, match="finite"):
        track(0, plan)
    with pytest.raises(ValueError, match="shape"):
        track(0, standing_plan(5)[:, :21], rotations_6d=np.zeros((5, 22, 6)))
    with pytest.raises(InvalidInputError, match="rotations_6d has T = 4"):
        track(0, standing_plan(5), rotations_6d=np.zeros((4, 22, 6)))
    with pytest.raises(InvalidInputError, match="between two frames at 20 fps") as caught:
        track(1, standing_plan(5))
    assert (caught.value.field, caught.value.allowed) == ("start_tick", "multiples of 3")


def raw_track(service: TrackerService, client: ServiceClient, character_id: str, shape: list[int]) -> Message:
    """The reply to a plan whose header names another shape, sent as bytes; no honest client can make one."""
    envelope = Envelope(
        type="Track", message_id="wrong-shape", character_id=character_id, instance_id=client.connect().instance_id
    )
    frames = encode(envelope, track(0, standing_plan(5)))
    header = json.loads(frames[1])
    header["arrays"][0]["shape"] = shape
    text = json.dumps(header).encode()
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.DEALER)
    try:
        socket.linger = 0
        socket.connect(service.endpoint)
        socket.send_multipart([frames[0][:4] + zlib.crc32(text).to_bytes(4, "little"), text, *frames[2:]])
        assert socket.poll(10_000), "no reply"
        return decode(socket.recv_multipart())[1]
    finally:
        socket.close()
        context.term()


@pytest.mark.parametrize("shape", [[5, 22, 2], [5, 21, 3], [110, 3], [5, 22, 3, 1]])
def test_a_plan_of_the_wrong_shape_on_the_wire(
    service: TrackerService, client: ServiceClient, victim: str, shape: list[int]
) -> None:
    before = client.ask(TakeSnapshot(), Snapshot, victim)
    reply = raw_track(service, client, victim, shape)
    assert isinstance(reply, ErrorReply)
    assert (reply.code, reply.field) == ("invalid_input", "positions_w_m")
    assert "(T, 22, 3)" in (reply.allowed or "")
    after = client.ask(TakeSnapshot(), Snapshot, victim)
    np.testing.assert_array_equal(before.state, after.state)
    np.testing.assert_array_equal(before.buffers, after.buffers)


def test_unknown_character_and_none(client: ServiceClient) -> None:
    with pytest.raises(NotFoundError) as caught:
        client.request(Observe(), "nobody")
    assert caught.value.field == "character_id"
    with pytest.raises(InvalidInputError) as missing:
        client.request(Step(ticks=1))
    assert missing.value.field == "character_id"


def test_a_realtime_character_is_not_stepped(client: ServiceClient, victim: str) -> None:
    client.request(SetPacing(pacing="realtime", paused=True), victim)
    with pytest.raises(ConflictError) as caught:
        client.request(Step(ticks=1), victim)
    assert caught.value.allowed == "lockstep"
    client.request(SetPacing(pacing="lockstep"), victim)


def test_a_damaged_snapshot_changes_nothing(client: ServiceClient, victim: str) -> None:
    shot = client.ask(TakeSnapshot(), Snapshot, victim)
    size = int(str(shot.meta["tail_bytes"]))
    for buffers in (shot.buffers[:100], np.concatenate([shot.buffers[:size], shot.buffers[size : size + 900]])):
        with pytest.raises(InvalidInputError) as caught:
            client.request(Restore(tick=shot.tick, meta=shot.meta, state=shot.state, buffers=buffers), victim)
        assert caught.value.field == "buffers"
        with pytest.raises(InvalidInputError):
            client.request(Restore(tick=shot.tick, meta=shot.meta, state=shot.state, buffers=buffers), "never-made")
    again = client.ask(TakeSnapshot(), Snapshot, victim)
    np.testing.assert_array_equal(shot.state, again.state)
    with pytest.raises(NotFoundError):
        client.request(Observe(), "never-made")


@pytest.mark.parametrize("name", ["tail_bytes", "first_sample", "seed"])
def test_a_number_no_integer_holds_is_a_damage(client: ServiceClient, victim: str, name: str) -> None:
    """Other languages write Infinity; ours refuses to."""
    shot = client.ask(TakeSnapshot(), Snapshot, victim)
    with pytest.raises(InvalidInputError, match="damaged"):
        split_buffers({**shot.meta, name: float("inf")}, shot.buffers)


class _BreaksOnce(PdTracker):
    """A PD tracker whose targets are not numbers at one tick."""

    def __init__(self) -> None:
        human = humanoid(HUMAN)
        super().__init__(human.damping / human.stiffness, human.skeleton.id)
        self.acts = 0

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> Any:
        self.acts += 1
        targets = super().act(character_ids, observations)
        return targets * np.nan if self.acts == 11 else targets

    spec = TrackerSpec(name="pd", version="1", skeleton="human22", fps=30, action_spaces=(SERVO_TARGETS,))


@pytest.fixture
def fragile(tmp_path: Path) -> Iterator[ServiceClient]:
    """A client of a service with room for one character, whose tracker fails at the eleventh tick."""
    settings = TrackerServiceSettings(endpoint="tcp://127.0.0.1:0", spool_dir=tmp_path, max_characters=1)
    trackers: dict[str, Callable[[], Any]] = {"pd": _BreaksOnce}
    with TrackerService(settings, trackers=trackers) as running, ServiceClient(running.endpoint, "tracker") as client:
        yield client


def test_failing_physics_is_dumped_and_reset(fragile: ServiceClient, tmp_path: Path) -> None:
    fragile.ask(CreateCharacter(), StateFrame, "hurt", timeout_s=20.0)
    fragile.ask(track(0, standing_plan(40)), TrackReply, "hurt")
    frame = step(fragile, "hurt", 30)
    assert frame.tick == 12, "it stopped at the failure and stood up at the next tick divisible by 3"
    assert frame.failure is not None
    assert "non-finite" in frame.failure
    assert not frame.fallen
    (dump,) = (tmp_path / "motionloop-dumps").glob("*.npz")
    with np.load(dump, allow_pickle=False) as data:
        about = json.loads(str(data["about"]))
        assert about["failed_tick"] == 10
        assert about["tick"] == 0
        assert len(data["state"]) > 50
    after = step(fragile, "hurt", 10)
    assert after.tick == 22
    assert after.failure is None
    assert np.isfinite(ticks(fragile, "hurt", 0, 23).body_pos_w_m).all()
    with pytest.raises(OverloadedError) as full:
        fragile.request(CreateCharacter(), "one-too-many")
    assert full.value.retryable
    fragile.request(ResetCharacter(), "hurt")
