"""The rules of strike, sit and get_up on made traces, computed by hand, in both directions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from shared.scenes.files import load_scene
from shared.tasks import object_rules
from shared.tasks.interface import Trace
from shared.tasks.object_specs import Limb
from shared.tasks.places import MarkedObject
from shared.tasks.world import World

STAND = standing_clip(1, 30).positions_w_m[0]
PELVIS_M = float(STAND[0, 2])
MASS_KG = 72.0
HALF_NS = 0.5 * MASS_KG * 9.81 / 30
"""Impulse in a tick that half of the weight makes."""
FLOOR = -1
Contact = tuple[int, str, int, float]


def world(ticks: int, contacts: list[Contact], tilt_deg: np.ndarray | None = None, name: str = "bag") -> World:
    """One object at the origin, tilted about X by an angle at every tick; contacts (row, joint, object, N s)."""
    half = np.deg2rad(np.zeros(ticks) if tilt_deg is None else tilt_deg) / 2
    zero = np.zeros(ticks)
    pose = np.stack([zero, zero, zero, np.cos(half), np.sin(half), zero, zero], axis=-1)[:, None]
    rows = sorted(contacts)
    return World(
        (name,), pose, np.zeros((ticks, 1, 6)),
        np.array([row for row, *_ in rows], dtype=np.int64),
        np.array([CANONICAL.index(joint) for _, joint, *_ in rows], dtype=np.int64),
        np.array([index for *_, index, _ in rows], dtype=np.int64),
        np.array([impulse for *_, impulse in rows], dtype=np.float64),
    )  # fmt: skip


def falling(ticks: int, down: int, end_deg: float = 90.0) -> np.ndarray:
    """Upright, then from `down` on at `end_deg`."""
    out = np.zeros(ticks)
    out[down:] = end_deg
    return out


def blow(contacts: list[Contact], tilt: np.ndarray, limb: Limb = "right_hand", fall: int | None = None):
    fallen = np.zeros(len(tilt), dtype=bool)
    if fall is not None:
        fallen[fall:] = True
    return object_rules.strike(world(len(tilt), contacts, tilt), fallen, "bag", limb)


def test_the_tilt_is_the_angle_of_the_axis_whatever_the_heading() -> None:
    poses = np.array(
        [[0, 0, 0, 1, 0, 0, 0], [0, 0, 0, 0.6, 0, 0, 0.8], [0, 0, 0, np.cos(0.3), 0, np.sin(0.3), 0]], dtype=float
    )
    np.testing.assert_allclose(object_rules.tilt_rad(poses), [0, 0, 0.6], atol=1e-12)


def test_a_strike_counts_when_the_limb_is_first_and_the_bag_ends_down() -> None:
    made = blow([(10, "right_wrist", 0, 20.0)], falling(90, 25))
    assert made.outcome == object_rules.Outcome(True, True, True, 25)
    assert (made.first_tick, made.limb_first) == (10, True)
    # Contact with the floor is none with the bag.
    assert blow([(2, "left_foot", FLOOR, 9.0), (10, "right_wrist", 0, 20.0)], falling(90, 25)).outcome.strict


@pytest.mark.parametrize(
    ("limb", "first", "counts"),
    [
        ("right_hand", "left_wrist", False), ("right_hand", "right_elbow", True),
        ("right_hand", "right_shoulder", False),
        ("left_hand", "left_wrist", True), ("left_foot", "left_foot", True), ("left_foot", "left_knee", True),
        ("left_foot", "right_foot", False), ("right_foot", "right_ankle", True), ("right_foot", "pelvis", False),
    ],
)  # fmt: skip
def test_the_wrong_limb_first_is_no_strict_success(limb: Limb, first: str, counts: bool) -> None:
    own = object_rules.LIMBS[limb][-1]
    made = blow([(10, first, 0, 1.0), (12, own, 0, 40.0)], falling(90, 25), limb)
    assert (made.outcome.strict, made.outcome.paper, made.outcome.code) == (counts, True, True)


def test_two_parts_within_one_tick_are_both_first() -> None:
    made = blow([(10, "spine3", 0, 1.0), (10, "right_wrist", 0, 9.0)], falling(90, 25))
    assert made.outcome.strict


def test_the_angles_are_those_of_paper_and_code() -> None:
    contact = [(10, "right_wrist", 0, 20.0)]
    for degrees, paper, code in ((14.9, False, False), (15.1, True, False), (75.4, True, False), (75.6, True, True)):
        outcome = blow(contact, falling(90, 25, degrees)).outcome
        assert (outcome.paper, outcome.code, outcome.strict) == (paper, code, code), degrees


def test_a_bag_that_rights_itself_is_no_strict_success() -> None:
    tilt = falling(90, 25)
    tilt[60:] = 10
    assert blow([(10, "right_wrist", 0, 20.0)], tilt).outcome == object_rules.Outcome(False, True, True, 25)


def test_a_fall_within_a_second_after_is_no_strict_success() -> None:
    contact = [(10, "right_wrist", 0, 20.0)]
    for fall, strict, paper in ((20, False, False), (26, False, True), (55, False, True), (56, True, True)):
        outcome = blow(contact, falling(90, 25), fall=fall).outcome
        assert (outcome.strict, outcome.paper, outcome.code) == (strict, paper, True), fall


def test_a_bag_that_falls_before_it_is_touched_or_untouched_is_none() -> None:
    assert not blow([(40, "right_wrist", 0, 20.0)], falling(90, 25)).outcome.strict
    assert not blow([], falling(90, 25)).outcome.strict
    assert blow([(40, "right_wrist", 0, 20.0)], np.zeros(90)).outcome == object_rules.NOTHING


def test_the_first_stretch_is_held_without_a_break() -> None:
    good = np.zeros(60, dtype=bool)
    good[10:25] = True  # 15 ticks cover 14 intervals
    assert object_rules.first_stretch(good) is None
    good[30:46] = True
    assert object_rules.first_stretch(good) == 30
    assert object_rules.first_stretch(good[:0]) is None


SOFA = MarkedObject(load_scene("sofa"), "seat_centre")
TOP = (0.10, 0.0, 0.344)
"""The mark on a sofa at the origin that faces +X."""


def seated(
    ticks: int = 90, at: tuple[float, float, float] = (0.0, 0.0, 0.12), impulse_ns: float = 1.2 * HALF_NS,
    fall: int | None = None, gap: range | None = None,
) -> Trace:  # fmt: skip
    """A body whose pelvis is at `at` from the mark from row 20 on, where the sofa carries it."""
    positions = np.repeat(STAND[None], ticks, axis=0)
    positions[:, :, 0] += 1.5
    positions[20:] = STAND + (np.array(TOP) + at - STAND[0])
    contacts = [(row, "pelvis", 0, impulse_ns) for row in range(20, ticks) if gap is None or row not in gap]
    fallen = np.zeros(ticks, dtype=bool)
    if fall is not None:
        fallen[fall:] = True
    return Trace(1, positions, fallen, world(ticks, contacts, name="sofa"))


def test_sitting_counts_when_the_seat_carries_half_for_half_a_second() -> None:
    # The share is a mean over three ticks: it takes three to be full.
    assert object_rules.sit(seated(), SOFA, MASS_KG) == object_rules.Outcome(True, True, True, 22)


@pytest.mark.parametrize(
    ("trace", "strict", "paper", "code"),
    [
        (seated(impulse_ns=0.95 * HALF_NS), False, True, True),
        (seated(impulse_ns=0.0), False, True, True),
        (seated(at=(0.0, 0.0, 0.179)), True, False, False),
        (seated(at=(0.0, 0.0, 0.181)), False, False, False),
        (seated(at=(0.0, 0.0, -0.01)), False, True, True),
        (seated(at=(0.32, 1.14, 0.12)), True, True, True),
        (seated(at=(0.34, 0.0, 0.12)), False, False, True),
        (seated(at=(0.0, 1.16, 0.12)), False, False, True),
        (seated(at=(0.61, 0.0, 0.12)), False, False, False),
        (seated(ticks=37), False, True, True),
        (seated(ticks=38), True, True, True),
        (seated(gap=range(30, 90)), False, True, True),
        (seated(fall=10), False, False, True),
        (seated(fall=67), False, True, True),
        (seated(fall=68), True, True, True),
    ],
)
def test_sitting_by_the_three_rules(trace: Trace, strict: bool, paper: bool, code: bool) -> None:
    outcome = object_rules.sit(trace, SOFA, MASS_KG)
    assert (outcome.strict, outcome.paper, outcome.code) == (strict, paper, code)


def test_a_heavier_body_needs_more_of_the_seat() -> None:
    assert not object_rules.sit(seated(), SOFA, 1.3 * MASS_KG).strict


def test_the_mark_turns_and_moves_with_its_object() -> None:
    made = world(3, [], name="sofa")
    pose = made.pose_w.copy()
    pose[1, 0] = [1.0, 2.0, 0.0, np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)]  # turned to face +Y
    moved = World(("sofa",), pose, *(getattr(made, name) for name in (
        "velocity_w", "contact_row", "contact_body", "contact_object", "contact_impulse_ns")))  # fmt: skip
    points = np.array([[0.2, 0.3, 0.5], [1.0 - 0.3, 2.1 + 0.1, 0.5], [0.1, 0.0, 0.344]])
    np.testing.assert_allclose(
        SOFA.local_m(moved, points), [[0.1, 0.3, 0.156], [0.1, 0.3, 0.156], [0.0, 0.0, 0.0]], atol=1e-9
    )


def test_where_touches_cannot_be_told_the_place_decides() -> None:
    """As in a plan, in which nothing bears anybody."""
    sat, stood = seated(impulse_ns=0.0), risen(feet=())
    assert sat.world is not None
    assert stood.world is not None
    assert object_rules.sit(sat, SOFA, MASS_KG).met_tick is None
    assert object_rules.get_up(stood, TARGET, False).met_tick is None
    sat, stood = (replace(trace, world=replace(trace.world, felt=False)) for trace in (sat, stood))
    assert object_rules.sit(sat, SOFA, MASS_KG).met_tick == 20
    assert object_rules.get_up(stood, TARGET, False).met_tick == 20
    above = seated(at=(0.0, 0.0, 0.181), impulse_ns=0.0)
    assert above.world is not None
    unseen = replace(above, world=replace(above.world, felt=False))
    assert object_rules.sit(unseen, SOFA, MASS_KG).met_tick is None


TARGET = np.array([0.5, 0.0, 0.9])


def risen(ticks: int = 90, off: float = 0.0, feet: tuple[str, ...] = ("left_foot", "right_foot"), up: int = 20):
    """Low until row `up`, then standing `off` metres from the target on the named feet."""
    positions = np.repeat(STAND[None], ticks, axis=0)
    positions[:, :, 0] += TARGET[0] + off
    positions[:, :, 2] += TARGET[2] - PELVIS_M
    positions[:up, :, 2] -= 0.45
    contacts = [(row, foot, FLOOR, 5.0) for row in range(ticks) for foot in feet]
    return Trace(1, positions, np.zeros(ticks, dtype=bool), world(ticks, contacts))


def test_getting_up_counts_on_both_feet_near_the_target() -> None:
    assert object_rules.get_up(risen(), TARGET, False) == object_rules.Outcome(True, True, True, 20)
    assert object_rules.get_up(risen(off=0.29), TARGET, False).strict
    assert object_rules.get_up(risen(off=0.31), TARGET, False) == object_rules.NOTHING
    assert object_rules.get_up(risen(feet=("left_foot",)), TARGET, False) == object_rules.Outcome(
        False, True, True, None
    )
    assert object_rules.get_up(risen(feet=("left_ankle", "right_foot")), TARGET, False).strict
    assert not object_rules.get_up(risen(ticks=35), TARGET, False).strict
    assert object_rules.get_up(risen(ticks=36), TARGET, False).strict


def test_a_fall_spoils_getting_up_until_a_second_after() -> None:
    for fall, strict, paper in ((5, False, False), (30, False, True), (65, False, True), (66, True, True)):
        trace = risen()
        trace.fallen[fall:] = True
        outcome = object_rules.get_up(trace, TARGET, False)
        assert (outcome.strict, outcome.paper) == (strict, paper), fall


def test_from_the_floor_only_what_comes_after_counts_as_a_fall() -> None:
    trace = risen(ticks=120, up=40)
    trace.pos_w_m[:40] = STAND[:, [2, 0, 1]] * [1, 1, 0.2] + [0, 0, 0.1]
    trace.fallen[:40] = True
    assert object_rules.get_up(trace, TARGET, True).strict
    assert not object_rules.get_up(trace, TARGET, False).strict
    trace.pos_w_m[60:] = trace.pos_w_m[0]
    assert not object_rules.get_up(trace, TARGET, True).strict
    assert object_rules.get_up(trace, TARGET, True).code
