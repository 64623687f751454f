"""Round trips, golden bytes, schemas, and what the codec makes of damage."""

from __future__ import annotations

import contextlib
import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from shared.errors import IncompatiblePeerError, InvalidInputError, MalformedMessageError, MotionLoopError
from shared.protocol.arrays import array_specs
from shared.protocol.base import Message
from shared.protocol.codec import MAX_FRAMES, MAX_HEADER_BYTES, UNKNOWN_ID, decode, encode, message_id_of
from shared.protocol.control import Envelope
from shared.protocol.messages import (
    LOG_HZ,
    MESSAGES,
    Look,
    Plan,
    PlanRequest,
    SetObject,
    SetScene,
    Snapshot,
    StateFrame,
    Step,
    Track,
)
from shared.protocol.rates import PLANNER_RATES, first_start_by, frame_of_tick, start_spacing
from shared.protocol.schemas import schema_texts
from tests.protocol.samples import GOLDEN, SAMPLES, packed, sample_envelope, unpacked

SCHEMAS = Path(__file__).resolve().parents[2] / "docs" / "schemas"


def same(a: Message, b: Message) -> None:
    arrays = array_specs(type(a))
    assert type(a) is type(b)
    assert a.model_dump(exclude=set(arrays)) == b.model_dump(exclude=set(arrays))
    for name, spec in arrays.items():
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
        assert getattr(b, name).dtype == np.dtype(spec.dtype)


def remade(frames: list[bytes], **changes: object) -> list[bytes]:
    """Frames whose header has other values and a right checksum."""
    header = {**json.loads(frames[1]), **changes}
    text = json.dumps(header).encode()
    return [frames[0][:4] + zlib.crc32(text).to_bytes(4, "little"), text, *frames[2:]]


def step_frames() -> list[bytes]:
    return encode(sample_envelope(Step(ticks=3)), Step(ticks=3))


def plan_frames() -> list[bytes]:
    plan = next(sample for sample in SAMPLES if isinstance(sample, Plan))
    return encode(sample_envelope(plan), plan)


def test_there_is_a_sample_of_every_message() -> None:
    assert {sample.type for sample in SAMPLES} == set(MESSAGES)
    assert {path.stem for path in GOLDEN.glob("*.bin")} == set(MESSAGES)


@pytest.mark.parametrize("sample", SAMPLES, ids=lambda sample: sample.type)
def test_golden_bytes_read_and_written(sample: Message) -> None:
    """A change here is a new protocol version (docs/protocol.md)."""
    golden = (GOLDEN / f"{sample.type}.bin").read_bytes()
    assert packed(encode(sample_envelope(sample), sample)) == golden
    envelope, message = decode(unpacked(golden))
    assert envelope == sample_envelope(sample)
    same(sample, message)


def test_schemas_are_current() -> None:
    """Run `python -m shared.protocol.schemas docs/schemas` after a change of messages."""
    assert {path.name: path.read_text(encoding="utf-8") for path in SCHEMAS.glob("*.json")} == schema_texts()


finite = st.floats(-1e6, 1e6, width=32)


@given(
    frames=st.integers(1, 8).flatmap(
        lambda t: st.tuples(
            hnp.arrays("<f4", (t, 22, 3), elements=finite), hnp.arrays("<f4", (t, 22, 6), elements=finite)
        )
    ),
    seed=st.integers(0, 2**63 - 1),
    timings=st.dictionaries(st.text(max_size=8), st.floats(allow_nan=False, allow_infinity=False), max_size=3),
)
def test_any_plan_survives(frames: tuple[np.ndarray, np.ndarray], seed: int, timings: dict[str, float]) -> None:
    plan = Plan(
        planner="p", start_tick=3, positions_w_m=frames[0], rotations_6d=frames[1], seed=seed, timings_ms=timings
    )
    envelope = Envelope(type="Plan", message_id="12345678")
    back_envelope, back = decode(encode(envelope, plan))
    assert back_envelope == envelope
    same(plan, back)


@given(text=st.text(max_size=300))
def test_any_text_survives(text: str) -> None:
    one = np.zeros((1, 22, 3))
    try:
        request = PlanRequest(
            start_tick=0, prefix_positions_w_m=one, prefix_rotations_6d=np.zeros((1, 22, 6)),
            prefix_velocities_w_mps=one, text=text,
        )  # fmt: skip
    except ValueError:  # lone surrogates are no text
        return
    same(request, decode(encode(sample_envelope(request), request))[1])


@given(which=st.integers(0, 10**6), position=st.integers(0, 10**9), bit=st.integers(0, 7))
def test_a_flipped_bit_is_noticed(which: int, position: int, bit: int) -> None:
    frames = plan_frames()
    index = which % len(frames)
    damaged = bytearray(frames[index])
    damaged[position % len(damaged)] ^= 1 << bit
    with pytest.raises(MalformedMessageError):
        decode([*frames[:index], bytes(damaged), *frames[index + 1 :]])


@given(which=st.integers(0, 3), keep=st.floats(0, 0.999))
def test_a_truncated_frame_is_noticed(which: int, keep: float) -> None:
    frames = plan_frames()
    frames[which] = frames[which][: int(keep * len(frames[which]))]
    with pytest.raises(MalformedMessageError):
        decode(frames)


@given(st.lists(st.binary(max_size=40), max_size=6))
def test_noise_is_refused(frames: list[bytes]) -> None:
    with pytest.raises(MalformedMessageError):
        decode(frames)
    assert message_id_of(frames) == UNKNOWN_ID


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
)
header_keys = st.sampled_from(["type", "body", "arrays", "message_id", "deadline_unix_s", "character_id", "extra"])


@given(value=json_values, key=header_keys)
def test_a_strange_header_is_refused_or_read(value: object, key: str) -> None:
    """Whatever stands in a header, only errors of our own tree come out."""
    with contextlib.suppress(MalformedMessageError, InvalidInputError):
        decode(remade(plan_frames(), **{key: value}))


def test_deep_nesting_is_refused() -> None:
    text = b"[" * 100_000
    with pytest.raises(MalformedMessageError):
        decode([b"MLP\x01" + zlib.crc32(text).to_bytes(4, "little"), text])


def test_missing_and_surplus_frames_are_refused() -> None:
    frames = plan_frames()
    for wrong in (frames[:1], frames[:-1], [*frames, b""], [*frames, *[b""] * MAX_FRAMES]):
        with pytest.raises(MalformedMessageError):
            decode(wrong)


def test_a_huge_header_is_refused_unread() -> None:
    with pytest.raises(MalformedMessageError, match="header of"):
        decode([step_frames()[0], b" " * (MAX_HEADER_BYTES + 1)])


def test_sizes_are_checked_before_anything_is_made() -> None:
    """A table that claims terabytes is refused by its shape; no such array is ever asked for."""
    frames = plan_frames()
    table = json.loads(frames[1])["arrays"]
    table[0]["shape"] = [2**40, 22, 3]
    with pytest.raises(InvalidInputError) as caught:
        decode(remade(frames, arrays=table))
    assert caught.value.field == "positions_w_m"
    assert "T" in (caught.value.allowed or "")


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"shape": [3, 21, 3]}, "positions_w_m"),
        ({"shape": [3, 66]}, "positions_w_m"),
        ({"dtype": "<f8"}, "positions_w_m"),
        ({"dtype": "|O"}, "positions_w_m"),
        ({"shape": [-1, 22, 3]}, "positions_w_m"),
        ({"shape": [2, 22, 3]}, "positions_w_m"),
        ({"name": "nose"}, "arrays"),
        ({"name": "rotations_6d"}, "rotations_6d"),
    ],
)
def test_a_wrong_row_of_the_table_is_named(change: dict[str, object], field: str) -> None:
    frames = plan_frames()
    table = json.loads(frames[1])["arrays"]
    table[0] = {**table[0], **change}
    with pytest.raises(MotionLoopError) as caught:
        decode(remade(frames, arrays=table))
    assert caught.value.code in ("malformed_message", "invalid_input")
    assert caught.value.field == field


def test_non_finite_values_are_refused_by_name() -> None:
    frames = plan_frames()
    raw = np.frombuffer(frames[2], "<f4").copy()
    raw[5] = np.nan
    header = json.loads(frames[1])
    header["arrays"][0]["crc32"] = zlib.crc32(raw.tobytes())
    with pytest.raises(InvalidInputError, match="finite") as caught:
        decode(remade([*frames[:2], raw.tobytes(), *frames[3:]], **header))
    assert caught.value.field == "positions_w_m"


def test_a_bad_field_is_named_with_what_is_allowed() -> None:
    with pytest.raises(InvalidInputError) as caught:
        decode(remade(step_frames(), body={"ticks": 0}))
    assert caught.value.field == "ticks"
    assert caught.value.allowed == ">= 1"


def test_another_protocol_version_is_refused_by_number() -> None:
    with pytest.raises(IncompatiblePeerError, match="version 3, this side speaks 2"):
        decode(remade(step_frames(), protocol_version=3))


@pytest.mark.parametrize("kind", ["Hello", "Step"])
def test_a_peer_of_version_1_is_refused_by_name(kind: str) -> None:
    """Bytes that version 1 sent."""
    frames = unpacked((GOLDEN.parent / "golden_v1" / f"{kind}.bin").read_bytes())
    with pytest.raises(IncompatiblePeerError, match="protocol version 1, this side speaks 2") as caught:
        decode(frames)
    assert (caught.value.field, caught.value.allowed) == ("protocol_version", "2")
    assert message_id_of(frames) == "0123456789abcdef", "so that the refusal reaches it"


@pytest.mark.parametrize("fps", [4, 7, 25, 50, 61, 120])
def test_a_rate_that_the_log_does_not_hold_is_refused_by_name(fps: int) -> None:
    one = np.zeros((1, 22, 3))
    with pytest.raises(ValueError, match=f"{fps} fps does not divide 120; allowed: 5, 6, 8, 10, 12, 15, 20, 24, 30"):
        Track(start_tick=0, fps=fps, positions_w_m=one, rotations_6d=np.zeros((1, 22, 6)))


@given(fps=st.sampled_from(PLANNER_RATES), tick=st.integers(0, 10**6))
def test_plans_start_where_ticks_are_frames(fps: int, tick: int) -> None:
    is_frame = tick * fps % 30 == 0
    assert (tick % start_spacing(fps) == 0) == is_frame
    if is_frame:
        assert frame_of_tick(tick, fps) * (LOG_HZ // fps) == 4 * tick, "it is the tick's own sample of the log"
    else:
        with pytest.raises(InvalidInputError) as caught:
            frame_of_tick(tick, fps)
        assert caught.value.field == "start_tick"
    start = first_start_by(tick, fps)
    assert start >= tick > start - start_spacing(fps)


def test_actions_name_their_space_and_objects_something_to_do() -> None:
    one = np.zeros((1, 22, 3))
    with pytest.raises(InvalidInputError) as actions:
        Track(start_tick=0, positions_w_m=one, rotations_6d=np.zeros((1, 22, 6)), actions=np.zeros((2, 5)))
    assert actions.value.field == "action_space"
    with pytest.raises(InvalidInputError) as idle:
        SetObject(name="bag")
    assert "linvel_w_mps" in (idle.value.allowed or "")


def test_a_scene_is_a_name_or_a_small_document() -> None:
    for scene in ("the moon", "", {"bodies": "x" * 70_000}):
        with pytest.raises(ValueError, match="scene document of at most 65536 bytes"):
            SetScene(scene=scene)
    assert SetScene(scene={"bodies": []}).scene == {"bodies": []}


def test_a_look_holds_the_present_state() -> None:
    """What a StateFrame says and what a Look says of the same moment are one."""
    state = next(sample for sample in SAMPLES if isinstance(sample, StateFrame))
    ticks = next(sample for sample in SAMPLES if isinstance(sample, Look))
    again = Look.of(state, ticks).state()
    assert again.model_dump(include={"tick", "pacing", "tracker", "scene", "plan_end_tick"}) == state.model_dump(
        include={"tick", "pacing", "tracker", "scene", "plan_end_tick"}
    )
    np.testing.assert_array_equal(again.body_pos_w_m, ticks.body_pos_w_m[-1])
    np.testing.assert_array_equal(again.object_angvel_w_radps, ticks.object_vel_w[-1, :, 3:])
    np.testing.assert_array_equal(again.contact_body, [2])
    np.testing.assert_array_equal(again.contact_object, [1])


def test_letters_must_agree() -> None:
    with pytest.raises(InvalidInputError) as caught:
        Track(start_tick=0, positions_w_m=np.zeros((4, 22, 3)), rotations_6d=np.zeros((5, 22, 6)))
    assert caught.value.field == "rotations_6d"
    assert caught.value.allowed == "T = 4, as positions_w_m"


def test_what_json_cannot_hold_is_not_sent() -> None:
    snapshot = Snapshot(tick=0, meta={"x": float("nan")}, state=np.zeros(1), buffers=np.zeros(1, "|u1"))
    with pytest.raises(InvalidInputError, match="JSON"):
        encode(sample_envelope(snapshot), snapshot)


def test_decoded_arrays_cannot_be_changed() -> None:
    _, plan = decode(plan_frames())
    assert isinstance(plan, Plan)
    with pytest.raises(ValueError, match="read-only"):
        plan.positions_w_m[0] = 0
