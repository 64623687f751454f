"""Which part of a planned body is at an object first, on motion made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.scenes.files import load_scene, parse_scene
from shared.tasks.touching import CLUMSY, RADII_M, Tipping, Upright, worth_of_blow

STAND = standing_clip(1, 20).positions_w_m[0]
BAG = Upright.of(load_scene("bag").bodies[0], np.array([0.6, 0.0]))
FIST = ("right_wrist",)


def moving(joint: str, to_m: tuple[float, float, float], frames: int = 11) -> np.ndarray:
    """Someone who stands and moves one joint alone, evenly."""
    out = np.repeat(STAND[None], frames, axis=0)
    share = np.linspace(0, 1, frames)[:, None]
    out[:, CANONICAL.index(joint)] += share * (np.array(to_m) - STAND[CANONICAL.index(joint)])
    return out


def worth(motion: np.ndarray, limb: tuple[str, ...] = FIST, solid: Upright = BAG, speed_worth: float = 0.2) -> float:
    return worth_of_blow(motion, 20.0, 1.0, solid, limb, speed_worth)


def test_every_joint_has_a_radius() -> None:
    assert {name.split("_")[-1] for name in CANONICAL.names} == set(RADII_M)


def test_a_limb_that_is_there_alone_is_worth_more_than_one_and_more_the_faster_it_is() -> None:
    slow, fast = worth(moving("right_wrist", (0.6, 0.0, 1.3))), worth(moving("right_wrist", (0.6, 0.0, 1.3), frames=5))
    way = np.linalg.norm(np.array([0.6, 0.0, 1.3]) - STAND[CANONICAL.index("right_wrist")])
    # Alone to the end: the whole lead; 0.2 for each metre a second.
    assert slow == pytest.approx(2.0 + 0.2 * way / 0.5)
    assert fast == pytest.approx(2.0 + 0.2 * way / 0.2)
    assert worth(moving("right_wrist", (0.6, 0.0, 1.3), frames=5), speed_worth=0.0) == pytest.approx(2.0)


def test_a_foot_at_the_base_spoils_it_and_counts_only_as_low_as_the_base_is() -> None:
    both = moving("right_wrist", (0.6, 0.0, 1.3), 21)
    early = moving("right_foot", (0.4, 0.0, 0.05), 5)[:, CANONICAL.index("right_foot")]
    both[:5, CANONICAL.index("right_foot")] = early
    both[5:, CANONICAL.index("right_foot")] = early[-1]
    assert worth(both) == CLUMSY
    raised = both.copy()
    raised[:, CANONICAL.index("right_foot"), 2] += 0.3  # above the base, 0.2 m from the axis: 0.17 and 0.07 m are more
    assert worth(raised) == CLUMSY
    raised[:, CANONICAL.index("right_foot"), 0] -= 0.1
    assert worth(raised) > 1.0


def test_what_touches_nothing_is_worth_the_less_the_farther_it_is() -> None:
    near, far = worth(moving("right_wrist", (0.3, 0.0, 1.3))), worth(moving("right_wrist", (0.2, 0.0, 1.3)))
    assert near == pytest.approx(-(0.3 - 0.17 - RADII_M["wrist"]))
    assert far == pytest.approx(near - 0.1)


def test_boxes_and_balls_are_as_wide_as_their_corners_and_as_high_as_they_are() -> None:
    scene = parse_scene(
        "name: s\nbodies: [{name: post, position_w_m: [0, 0, 0], mass_kg: 9, parts: ["
        "{shape: box, size_m: [0.3, 0.4, 0.5], position_b_m: [0, 0, 0.5]},"
        " {shape: sphere, size_m: [0.2], position_b_m: [0.1, 0, 1.2]}]}]"
    )
    post = Upright.of(scene.bodies[0], np.array([1.0, 0.0]))
    np.testing.assert_allclose(post.cylinders_m, [[0.5, 0.0, 1.0], [0.3, 1.0, 1.4]])
    gap = post.gap_m(np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 1.2], [0.0, 0.0, 2.0]]), np.array([0.1, 0.1, 0.1]))
    np.testing.assert_allclose(gap, [0.4, 0.6, np.inf])


def test_the_bag_goes_down_by_itself_past_its_edge_or_with_the_speed_to_get_there() -> None:
    bag = Tipping.of(load_scene("bag").bodies[0])
    # 12 kg in the base at 0.06 m and 51 kg at 0.995 m, on a base of 0.24 m.
    up = (12 * 0.06 + 51 * 0.995) / 63
    assert (bag.edge_rad, bag.arm_m) == pytest.approx((np.arctan2(0.24, up), np.hypot(0.24, up)))
    # Upright it has to gain g (0.852 - 0.817) a kilogram: by hand, 4/3 0.852^2 w^2 / 2 of that is w = 0.84 rad/s.
    assert not bag.goes(0.0, 0.84) and bag.goes(0.0, 1.15)
    assert not bag.goes(0.15, 0.2) and bag.goes(0.15, 0.7)
    assert bag.goes(0.3, 0.05) and not bag.goes(0.3, -0.05)


def test_parts_without_a_mass_weigh_by_their_volume() -> None:
    scene = parse_scene(
        "name: s\nbodies: [{name: post, position_w_m: [0, 0, 0], mass_kg: 9, parts: ["
        "{shape: cylinder, size_m: [0.2, 0.5], position_b_m: [0, 0, 0.5]},"
        " {shape: cylinder, size_m: [0.1, 0.5], position_b_m: [0, 0, 1.5]}]}]"
    )
    post = Tipping.of(scene.bodies[0])
    assert np.tan(post.edge_rad) == pytest.approx(0.2 / ((4 * 0.5 + 1 * 1.5) / 5))
