"""Rules of kinds, and of first movements after a change, on hand-made motion."""

from __future__ import annotations

import numpy as np
import pytest

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.motion.rotations import matrix_about_z
from shared.motion.skeleton import CANONICAL
from shared.tasks.first_movement import first_movement
from shared.tasks.interface import Trace
from shared.tasks.kinds import KINDS, judge, reversals

STAND = standing_clip(1, 30).positions_w_m[0]
TICKS = 150
TIME = np.arange(TICKS) / 30


def body(ahead_mps: float = 0.0, left_mps: float = 0.0, yaw_radps: float = 0.0, ticks: int = TICKS) -> np.ndarray:
    """(T, 22, 3) a standing body carried along, its speeds as it sees them."""
    time = np.arange(ticks) / 30
    turn = np.stack([matrix_about_z(yaw) for yaw in yaw_radps * time])
    out = np.einsum("tij,kj->tki", turn, STAND)
    way = np.einsum("tij,j->ti", turn, np.array([ahead_mps, left_mps, 0.0])) / 30
    return out + np.cumsum(way, axis=0)[:, None]


def moved(joint: str, offset: np.ndarray, base: np.ndarray | None = None) -> np.ndarray:
    """A body one of whose joints is moved by (T, 3) or (3,)."""
    out = (body() if base is None else base).copy()
    out[:, CANONICAL.index(joint)] += offset
    return out


def swinging(side: str, swing_m: float, height_m: float = 0.7) -> np.ndarray:
    """A wrist lifted by `height_m` that swings `swing_m` from end to end at 1.2 Hz."""
    swing = 0.5 * swing_m * np.sin(2 * np.pi * 1.2 * TIME)
    return moved(f"{side}_wrist", np.stack([np.zeros(TICKS), swing, np.full(TICKS, height_m)], axis=-1))


def punching(side: str, reach_m: float, ticks: int = 6, base: np.ndarray | None = None) -> np.ndarray:
    """A wrist that begins at its shoulder and shoots ahead to `reach_m` from it."""
    out = (body() if base is None else base).copy()
    shoulder, wrist = CANONICAL.indices(f"{side}_shoulder", f"{side}_wrist")
    way = np.interp(np.arange(len(out)), [60, 60 + ticks], [0.1, reach_m])
    out[:, wrist] = out[:, shoulder] + np.stack([way, 0 * way, 0 * way], axis=-1)
    return out


def kicking(side: str, ahead_m: float, up_m: float) -> np.ndarray:
    out = body()
    ankle = CANONICAL.index(f"{side}_ankle")
    share = np.interp(np.arange(TICKS), [60, 68, 76, 84], [0, 1, 1, 0])
    out[:, ankle] += share[:, None] * [ahead_m, 0.0, up_m]
    return out


def down(metres: float) -> np.ndarray:
    out = body()
    out[60:, :16] -= [0, 0, metres]
    return out


DONE = {
    "walk": body(0.5),
    "walk_back": body(-0.3),
    "walk_left": body(0.0, 0.3),
    "walk_right": body(0.5, 0.0, -0.3),
    "step_back": body(-0.06),
    "step_left": body(0.0, 0.06),
    "step_right": body(0.0, -0.06),
    "run": body(2.2),
    "turn_left": body(yaw_radps=0.3),
    "turn_right": body(yaw_radps=-0.3),
    "wave_left": swinging("left", 0.2),
    "wave_right": swinging("right", 0.2),
    "jump": np.where((np.arange(TICKS) // 10 == 5)[:, None, None], body() + [0, 0, 0.1], body()),
    "stand": body(),
    "squat": down(0.3),
    "punch_left": punching("left", 0.5),
    "punch_right": punching("right", 0.5),
    "kick_left": kicking("left", 0.5, 0.4),
    "kick_right": kicking("right", 0.5, 0.4),
}


def done(kind: str, motion: np.ndarray) -> bool:
    return judge(kind, Trace(0, motion, np.zeros(len(motion), np.bool_))).done


@pytest.mark.parametrize("kind", list(DONE))
def test_a_kind_is_done_by_its_motion_and_not_by_those_of_the_other_side_or_standing(kind: str) -> None:
    assert done(kind, DONE[kind])
    if kind != "stand":
        assert not done(kind, DONE["stand"])
    other = kind.replace("left", "r?ght").replace("right", "left").replace("r?ght", "right")
    if other != kind:
        assert not done(kind, DONE[other])
        assert done(kind.partition("_")[0], DONE[kind]) or kind.startswith("walk")


@pytest.mark.parametrize(
    ("kind", "motion"),
    [
        ("walk", body(-0.5)),
        ("walk", body(0.0, 0.5)),
        ("walk", body(2.5)),
        ("walk_back", body(-0.1)),
        ("walk_back", body(-0.3, 0.4)),
        ("walk_left", body(0.5)),
        ("run", body(1.5)),
        ("run", body(-2.2)),
        ("turn_left", body(yaw_radps=0.15)),
        ("wave_right", swinging("right", 0.1)),
        ("wave_right", swinging("right", 0.2, height_m=0.0)),
        ("jump", np.where((np.arange(TICKS) // 10 == 5)[:, None, None], body() + [0, 0, 0.04], body())),
        ("stand", body(0.1)),
        ("stand", down(0.6)),
        ("squat", down(0.2)),
        ("squat", down(0.9) - np.where(TIME[:, None, None] > 2, 0.4, 0.0) * [0, 0, 1.0]),
        ("punch_right", punching("right", 0.3)),
        ("punch_right", punching("right", 0.5, ticks=30)),
        ("kick_right", kicking("right", 0.5, 0.2)),
        ("kick_right", kicking("right", 0.1, 0.4)),
        ("kick_right", kicking("right", -0.5, 0.4)),
        ("kick_right", kicking("right", 0.5, 0.4) + [0, 0, 0.1]),
    ],
)
def test_what_falls_short_is_not_done(kind: str, motion: np.ndarray) -> None:
    assert not done(kind, motion)


def test_a_wave_needs_three_reversals() -> None:
    """At 1.2 Hz it turns round at 0.21, 0.63 and 1.04 s; a turn is known once it is 12 cm back."""
    wave = swinging("right", 0.3)
    assert not done("wave_right", wave[:32])
    assert done("wave_right", wave[:42])


def test_reversals_by_hand() -> None:
    assert reversals(np.array([0.0, 0.1, -0.1, 0.1, -0.1]), 0.15) == 2
    assert reversals(np.array([0.0, 0.1, -0.1, 0.1, -0.1]), 0.25) == 0
    assert reversals(np.array([0.0, 0.3, 0.25, 0.6, 0.1]), 0.2) == 1
    assert reversals(np.linspace(0, 5, 50), 0.1) == 0


def test_kinds_have_names_and_short_motion_is_nothing() -> None:
    assert done("other", body())
    assert not done("stand", body(ticks=20))
    for kind in KINDS:
        assert isinstance(done(kind, body()), bool)
    with pytest.raises(InvalidInputError) as caught:
        done("fly", body())
    assert "walk_back" in str(caught.value.allowed)


def after(kind: str, before: np.ndarray, motion: np.ndarray) -> float | None:
    """Second of the first movement where `motion` goes on from the end of `before`."""
    joined = motion + (before[-1, 0] - motion[0, 0]) * [1, 1, 0]
    return first_movement(kind, before, np.concatenate([before[-1:], joined[1:]]), 30).after_s


def test_first_movements_are_timed_from_the_change() -> None:
    still, second = body(ticks=60), slice(0, 31)
    assert 0.0 < (after("walk", still, body(1.0)[second]) or 0.0) <= 0.2
    assert after("walk", still, body(0.2)[second]) is None
    assert after("run", body(1.0, ticks=60), body(1.0)[second]) is None
    assert after("run", body(1.0, ticks=60), body(1.6)[second]) is not None
    assert after("walk", body(2.5, ticks=60), body(2.5)[second]) is None
    assert after("walk", body(2.5, ticks=60), body(1.5)[second]) is not None
    assert after("stand", body(2.5, ticks=60), body(2.4)[second]) is None
    assert after("stand", body(2.5, ticks=60), body(1.0)[second]) is not None
    assert after("walk_back", still, body(-0.3)[second]) is not None
    turned = after("turn_left", still, body(yaw_radps=0.5)[second])
    assert turned == pytest.approx(np.radians(15) / 0.5, abs=0.04)
    assert after("turn_right", still, body(yaw_radps=0.5)[second]) is None


def test_first_movements_of_limbs_are_beyond_what_the_limb_did_before() -> None:
    still, second = body(ticks=60), slice(58, 89)
    punch = punching("right", 0.5)
    assert after("punch_right", punch[:59], punch[second]) is not None
    assert after("punch_left", punch[:59], punch[second]) is None
    rows = np.arange(90)
    swung = moved("right_wrist", np.stack([0.2 * np.sin(rows / 2), 0 * rows, 0 * rows], -1), body(ticks=90))
    assert after("punch_right", swung[:60], swung[59:]) is None, "arms that swing as before do not punch"
    raised = moved("left_wrist", np.interp(np.arange(31), [5, 20], [0, 0.4])[:, None] * [0, 0, 1], body(ticks=31))
    assert after("wave_left", still, raised) == pytest.approx((5 + 15 * 0.15 / 0.4) / 30, abs=0.04)
    assert after("wave_right", still, raised) is None
    dipped = body(ticks=31) - np.interp(np.arange(31), [0, 15], [0, 0.1])[:, None, None] * [0, 0, 1.0]
    assert after("squat", still, dipped) == pytest.approx(12 / 30, abs=0.04)
    assert (after("jump", still, dipped) or 1.0) < 0.3
    with pytest.raises(InvalidInputError):
        after("fly", still, dipped)


def test_who_runs_begins_what_is_done_on_the_spot_by_slowing() -> None:
    run = body(2.5, ticks=60)
    assert after("squat", run, body(2.5)[:31]) is None
    assert after("squat", run, body(1.5)[:31]) is not None
    assert after("squat", body(0.8, ticks=60), body(0.2)[:31]) is None
