"""Success rules on hand-made motion."""

from __future__ import annotations

import numpy as np
import pytest

from shared.motion.heading import hips_heading
from shared.motion.ik import standing_clip
from shared.motion.rotations import matrix_about_z
from shared.motion.skeleton import CANONICAL
from shared.tasks import rules
from shared.tasks.interface import Trace
from shared.tasks.obey import kind_of, obeyed

STAND = standing_clip(1, 30).positions_w_m[0]


def trace(ticks: int) -> Trace:
    return Trace(1, np.repeat(STAND[None], ticks, axis=0), np.zeros(ticks, dtype=bool))


def moving(ticks: int, speed_mps: float) -> Trace:
    out = trace(ticks)
    out.pos_w_m[:, :, 0] += (np.arange(ticks) * speed_mps / 30)[:, None]
    return out


def path(*distances_m: float) -> np.ndarray:
    return np.array([[d, 0.0] for d in distances_m])


def test_reach_is_strict_when_held_and_safe() -> None:
    xy = np.concatenate([np.repeat(path(2.0), 10, 0), np.repeat(path(0.2), 60, 0)])
    upright = np.zeros(70, dtype=bool)
    out = rules.reach(xy, upright, (0.0, 0.0))
    assert (out.strict, out.paper, out.code, out.met_tick) == (True, True, True, 10)
    # A fall up to one second after the half second of holding spoils it; later it does not.
    for tick, strict in ((9, False), (54, False), (55, False), (56, True)):
        fallen = upright.copy()
        fallen[tick] = True
        assert rules.reach(xy, fallen, (0.0, 0.0)).strict is strict, tick


def test_reach_touched_once_counts_for_paper_and_code_only() -> None:
    xy = np.concatenate([np.repeat(path(1.0), 10, 0), path(0.29), np.repeat(path(1.0), 30, 0)])
    out = rules.reach(xy, np.zeros(41, dtype=bool), (0.0, 0.0))
    assert (out.strict, out.paper, out.code, out.met_tick) == (False, True, True, None)
    fallen = np.zeros(41, dtype=bool)
    fallen[5] = True
    out = rules.reach(xy, fallen, (0.0, 0.0))
    assert (out.paper, out.code) == (False, True)


def test_reach_passing_by_and_back_is_still_within_half_a_second_later() -> None:
    inside = np.zeros(60, dtype=bool)
    inside[[10, 25]] = True
    assert rules.first_held(inside) == 10
    assert rules.first_held(inside[:25]) is None


def test_reversals_count_swings_above_the_threshold() -> None:
    assert rules.reversals(np.array([0, 0.1, 0.0, 0.1, 0.0]), 0.05) == 3
    assert rules.reversals(np.array([0, 0.1, 0.07, 0.12, 0.11]), 0.05) == 0
    assert rules.reversals(np.array([]), 0.05) == 0


def test_heading_and_turn_are_signed_and_unwrapped() -> None:
    angles = np.linspace(0, 1.5 * np.pi, 40)
    turning = np.einsum("tij,kj->tki", matrix_about_z(angles), STAND)
    np.testing.assert_allclose(hips_heading(turning)[10], angles[10], atol=1e-9)
    assert rules.turned_rad(turning) == pytest.approx(1.5 * np.pi)
    assert rules.turned_rad(turning[::-1]) == pytest.approx(-1.5 * np.pi)


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("a person walks forward.", "walk"), ("Run!", "run"), ("a person is walking and waving", "wave"),
        ("turn left", "turn"), ("someone jumps up", "jump"), ("a person is standing still.", "stand"),
        ("hopping on one leg", "jump"), ("a person dances", "other"), ("someone runs and jumps", "jump"),
    ],
)  # fmt: skip
def test_kind_of_a_sentence(text: str, kind: str) -> None:
    assert kind_of(text) == kind


def test_walk_needs_a_metre_and_a_half() -> None:
    assert obeyed("walk", moving(150, 0.4)).obeyed
    slow = obeyed("walk", moving(150, 0.25))
    assert not slow.obeyed
    assert slow.measures["travelled_m"] == pytest.approx(0.25 * 135 / 30)


def test_run_needs_its_speed() -> None:
    assert obeyed("run", moving(150, 1.9)).obeyed
    assert not obeyed("run", moving(150, 1.7)).obeyed


def test_turn_needs_sixty_degrees_to_the_named_side() -> None:
    angles = np.deg2rad(np.linspace(0, 70, 150))
    left = Trace(1, np.einsum("tij,kj->tki", matrix_about_z(angles), STAND), np.zeros(150, dtype=bool))
    assert obeyed("turn left", left).obeyed
    assert obeyed("turn around", left).obeyed
    assert not obeyed("turn right", left).obeyed


def test_wave_needs_a_raised_wrist_and_two_reversals() -> None:
    def waving(height_m: float, swings: float) -> Trace:
        out = trace(150)
        shoulder, wrist = CANONICAL.index("right_shoulder"), CANONICAL.index("right_wrist")
        out.pos_w_m[:, wrist] = out.pos_w_m[:, shoulder] + [0.1, -0.2, height_m]
        out.pos_w_m[:, wrist, 1] += 0.1 * np.sin(np.linspace(0, 2 * np.pi * swings, 150))
        return out

    assert obeyed("wave", waving(0.3, 3)).obeyed
    assert not obeyed("wave", waving(-0.1, 3)).obeyed
    assert not obeyed("wave", waving(0.3, 0.4)).obeyed


def test_jump_needs_both_feet_up() -> None:
    both, one = trace(60), trace(60)
    both.pos_w_m[20:30, :, 2] += 0.06
    one.pos_w_m[20:30, CANONICAL.indices("left_foot", "left_ankle"), 2] += 0.3
    assert obeyed("jump", both).obeyed
    assert not obeyed("jump", one).obeyed


def test_stand_may_take_two_seconds_to_stop() -> None:
    out = moving(150, 1.0)
    out.pos_w_m[60:] = out.pos_w_m[60]
    assert obeyed("stand still", out).obeyed
    assert not obeyed("stand still", moving(150, 0.1)).obeyed


def test_a_body_on_the_floor_is_lying_after_three_tenths_of_a_second_whatever_the_plan_says() -> None:
    standing = np.repeat(CANONICAL.rest_positions_m[None], 30, axis=0)
    assert not rules.lying(standing).any()
    fallen = standing.copy()
    fallen[10:] = fallen[10:, :, [2, 1, 0]]  # flat along X
    assert np.flatnonzero(rules.lying(fallen))[0] == 10 + rules.DOWN_TICKS - 1
    brief = standing.copy()
    brief[10:18] = fallen[10]
    assert not rules.lying(brief).any()


def test_leaning_begins_a_fifth_below_the_standing_head() -> None:
    bent = CANONICAL.rest_positions_m.copy()
    assert not rules.leaning(bent)
    bent[CANONICAL.index("head"), 2] *= 0.79
    assert rules.leaning(bent)
