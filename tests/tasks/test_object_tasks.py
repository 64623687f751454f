"""What the tasks with objects ask of the planner, and when they are over."""

from __future__ import annotations

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.motion.rotations import matrix_about_z
from shared.motion.skeleton import CANONICAL
from shared.scenes.files import load_scene
from shared.scenes.placing import pose_of, sampled
from shared.scenes.schema import RandomRanges
from shared.tasks import object_rules
from shared.tasks.factory import KINDS, TaskSpec, make_task
from shared.tasks.interface import RISE_PLANNER, BodyView, Trace
from shared.tasks.object_specs import GetUpSpec, SitSpec, StrikeSpec
from shared.tasks.specs import ReachSpec, VelocitySpec
from shared.tasks.world import World
from shared.text.wording import STAND_TEXT

STAND = standing_clip(1, 30).positions_w_m[0]


def view(scene: str, x: float = 0.0, y: float = 0.0, facing: float = 0.0, tick: int = 0, lift: float = 0.0) -> BodyView:
    made = load_scene(scene)
    positions = STAND @ matrix_about_z(facing).T + [x, y, lift]
    objects = {body.name: np.asarray(pose_of(body), dtype=np.float64) for body in made.bodies}
    return BodyView(tick, positions, objects=objects, scene=made)


@pytest.mark.parametrize("limb", ["left_hand", "right_hand", "left_foot", "right_foot"])
def test_a_blow_counts_down_to_one_tick_and_then_waits_before_the_next(limb: str) -> None:
    task = make_task(StrikeSpec.model_validate({"limb": limb}), 0)
    side, end = limb.split("_")
    x = 1.15 if end == "hand" else 0.95
    task.start(view("bag", x))
    joint = f"{side}_{'wrist' if end == 'hand' else 'foot'}"
    for plan_tick in (0, 6, 12, 18):
        goal = task.goal(view("bag", x, tick=plan_tick), plan_tick)
        limbs, root = goal.targets
        assert (limbs.joint, root.joint) == (joint, "traj")
        # Through the mark at (2, 0, 0.9), the fist higher on so tall an object; the body to where the limb reaches.
        assert limbs.position_w_m == pytest.approx((2.1, 0.0, 1.3) if end == "hand" else (2.05, 0.0, 0.9))
        assert root.position_w_m == pytest.approx((1.5 if end == "hand" else 1.45, 0.0, 0.0))
        assert (goal.keyframe_ticks, goal.keyframe_joints) == ((24,), ((joint,),))
        assert goal.keyframe_positions_w_m == ((limbs.position_w_m,),)
        assert goal.heading is not None
        assert goal.heading.heading_rad == pytest.approx(0.0)
        assert side in str(goal.text)
        assert ("strike" in str(goal.text)) is (end == "hand")
        assert (limbs.arrival_tick, root.arrival_tick) == (24, 24)
        assert goal.candidates > 1 and goal.worth is not None
        assert goal.worth(np.repeat(view("bag", x).pos_w_m[None], 8, axis=0), 20.0) < 0  # who stands touches nothing
    again = task.goal(view("bag", x, tick=42), 42)
    assert again.targets[0].arrival_tick == 42 + 24


@pytest.mark.parametrize("limb", ["left_foot", "right_hand"])
def test_what_was_hit_is_gone_through_until_it_goes_down(limb: str) -> None:
    task = make_task(StrikeSpec.model_validate({"limb": limb}), 0)
    task.start(view("bag", 1.15))
    task.goal(view("bag", 1.15), 0)
    # 0.7 m and what the mark has leant away, from 0.55 m/s on, by 0.12 m/s faster each second, at most 0.8 m/s.
    for tick, lean, mps in ((15, 0.05, 0.55), (30, 0.2, 0.61), (90, 0.2, 0.8)):
        leant = 0.9 * np.sin(lean)
        hit = leaning_bag(view("bag", 1.9, tick=tick), lean)
        goal = task.goal(hit, tick)
        root, hand = goal.targets
        assert (root.joint, hand.joint) == ("traj", f"{limb.split('_')[0]}_wrist")
        assert root.position_w_m == pytest.approx((2.6 + leant, 0.0, 0.0))
        assert hand.position_w_m == pytest.approx((3.05 + leant, 0.0, 1.3))
        assert root.arrival_tick == hand.arrival_tick == tick + round((0.7 + leant) / mps * 30)
        assert "walking forward" in str(goal.text)
        assert goal.replan_ticks == 6, "looked at again before the bag is down"
    # Who has slipped to its side goes through where it is, not on past it; who has passed it keeps the way.
    root = task.goal(view("bag", 1.6, 0.3, tick=96), 96).targets[0]
    assert root.position_w_m == pytest.approx((2.0 + 0.6 * 0.8, -0.6 * 0.6, 0.0))
    assert task.goal(view("bag", 2.6, 0.3, tick=102), 102).targets[0].position_w_m == pytest.approx(root.position_w_m)
    assert task.goal(leaning_bag(view("bag", 1.3, tick=105), 0.5), 105).text == STAND_TEXT
    # One that rocks back is hit again; what the limb feels counts though nothing moves.
    assert task.goal(view("bag", 1.15, tick=140), 140).targets[0].arrival_tick == 140 + 24
    felt = touched_world(30, object_rules.LIMBS[StrikeSpec.model_validate({"limb": limb}).limb][-1], 25)
    assert task.status(Trace(140, np.repeat(STAND[None], 30, axis=0), np.zeros(30, dtype=bool), felt)) == "running"
    assert "walking forward" in str(task.goal(view("bag", 1.4, tick=170), 170).text)


def touched_world(ticks: int, joint: str, row: int) -> World:
    """The bag that stands, touched once."""
    (bag,) = load_scene("bag").bodies
    return World(
        ("bag",), np.repeat(pose_of(bag)[None, None].astype(np.float64), ticks, axis=0), np.zeros((ticks, 1, 6)),
        np.array([row]), np.array([CANONICAL.index(joint)]), np.array([0]), np.array([9.0]),
    )  # fmt: skip


def test_a_bag_that_goes_fast_enough_is_let_go() -> None:
    task = make_task(StrikeSpec.model_validate({"limb": "right_hand"}), 0)
    task.start(view("bag", 1.15))
    task.goal(view("bag", 1.15), 0)
    for lean_rad, text in ((0.11, "walking forward"), (0.16, STAND_TEXT)):
        world = touched_world(30, "right_wrist", 25)
        for row, lean in ((-3, 0.1), (-2, 0.1), (-1, lean_rad)):
            world.pose_w[row, 0, 3:] = [np.cos(lean / 2), 0.0, np.sin(lean / 2), 0.0]
        seen = leaning_bag(view("bag", 1.5, tick=45), lean_rad)
        task.status(Trace(0, np.repeat(STAND[None], 30, axis=0), np.zeros(30, dtype=bool), world))
        assert text in str(task.goal(seen, 45).text)


def test_from_a_bag_that_goes_down_it_goes_back_a_little_and_then_stands() -> None:
    task = make_task(StrikeSpec.model_validate({"limb": "right_hand"}), 0)
    task.start(view("bag", 1.15))
    task.goal(view("bag", 1.15), 0)
    assert "walking forward" in str(task.goal(leaning_bag(view("bag", 1.5, tick=45), 0.1), 45).text)
    seen = leaning_bag(view("bag", 1.5, tick=60), 0.4)
    back = task.goal(seen, 60)
    assert back.text == STAND_TEXT and back.heading is not None
    assert back.targets[0].position_w_m[0] == pytest.approx(float(seen.pelvis_xy_m[0]) - 0.35, abs=0.01)
    on_the_way = task.goal(leaning_bag(view("bag", 1.4, tick=75), 0.8), 75)
    assert on_the_way.targets[0].position_w_m == back.targets[0].position_w_m
    later = task.goal(leaning_bag(view("bag", 1.4, tick=91), 1.5), 91)
    assert later.text == STAND_TEXT and back.targets[0] not in later.targets


def leaning_bag(seen: BodyView, lean_rad: float) -> BodyView:
    """The same with a bag that leans away about its foot."""
    pose = seen.objects["bag"].copy()
    pose[3:] = [np.cos(lean_rad / 2), 0.0, np.sin(lean_rad / 2), 0.0]
    return replace(seen, objects={"bag": pose})


def test_far_from_the_bag_it_walks_near_it_steps_beside_it_turns() -> None:
    task = make_task(StrikeSpec(), 0)
    task.start(view("bag", -1.0))
    walk = task.goal(view("bag", -1.0), 0)
    assert walk.text == "a person is walking."
    assert walk.targets[0].position_w_m == pytest.approx((0.2, 0.0, 0.0))
    # On the way it walks to where it strikes from, and comes to rest there before anything else.
    assert task.goal(view("bag", 0.9, tick=60), 60).targets[0].position_w_m == pytest.approx((1.2, 0.0, 0.0))
    assert "forward" in str(task.goal(view("bag", 0.9, tick=75), 75).text)
    for x, word, spot in (
        (1.55, "backward", 1.2),
        (0.9, "forward", 1.2),
        (0.99, "forward", 1.27),
        (1.1, "strike", 2.1),
    ):
        task = make_task(StrikeSpec(), 0)
        task.start(view("bag", x))
        goal = task.goal(view("bag", x), 0)
        assert word in str(goal.text), x
        assert goal.targets[0].position_w_m[0] == pytest.approx(spot)
    task = make_task(StrikeSpec(), 0)
    task.start(view("bag", 1.1, facing=pi / 2))
    assert task.goal(view("bag", 1.1, facing=pi / 2), 0).text == "a person turns to the right."


def test_where_it_stood_before_is_no_place_to_go_back_to() -> None:
    task = make_task(StrikeSpec(), 0)
    task.start(view("bag", 1.3))
    for tick in (0, 15):
        stood = task.goal(leaning_bag(view("bag", 1.3, tick=tick), 0.6), tick)
    assert stood.targets[0].position_w_m == pytest.approx((1.3, 0.0, 0.0))
    assert "strike" in str(task.goal(view("bag", 1.3, tick=30), 30).text)
    falls = leaning_bag(view("bag", 2.2, tick=60), 0.6)
    assert task.goal(falls, 60).targets == ()
    spot = task.goal(leaning_bag(view("bag", 2.25, tick=75), 1.5), 75).targets[0].position_w_m
    assert spot == pytest.approx((2.25, 0.0, 0.0))


def test_distances_that_a_user_gives_go_before_those_of_the_limb() -> None:
    task = make_task(StrikeSpec(from_m=0.3, stand_m=0.5, to_m=0.6), 0)
    task.start(view("bag", 1.3))
    step = task.goal(view("bag", 1.3), 0)
    assert step.targets[0].position_w_m[0] == pytest.approx(1.3 + 0.28)
    assert "strike" in str(task.goal(view("bag", 1.6, tick=0), 0).text)


def test_a_bag_that_lies_is_set_up_and_one_that_stands_is_left() -> None:
    task = make_task(StrikeSpec(), 0)
    stands = view("bag", 0.9)
    assert task.props(stands) == {}
    lies = replace(stands, objects={"bag": np.array([3.0, 0, 0.2, np.sqrt(0.5), 0, np.sqrt(0.5), 0])})
    np.testing.assert_allclose(task.props(lies)["bag"], [2.0, 0, 0, 1, 0, 0, 0], atol=1e-12)
    near = replace(lies, pos_w_m=lies.pos_w_m + [1.0, 0, 0])  # stands where the bag would
    np.testing.assert_allclose(task.props(near)["bag"][:2], [2.7, 0.0], atol=0.05)
    task.start(lies)
    assert task.goal(lies, 0).text == STAND_TEXT


def test_a_sitter_walks_round_the_sofa_turns_and_goes_down() -> None:
    task = make_task(SitSpec(), 0)
    task.start(view("sofa", 1.5))
    assert task.goal(view("sofa", 1.5, facing=pi), 0).text == "a person is walking."
    # Behind the sofa it first goes beside it, then past its corner to the front.
    for x, y, wanted in ((-2.3, 0.3, "aside"), (-2.0, 1.8, "ahead")):
        place = make_task(SitSpec(), 0)
        place.start(view("sofa", x, y))
        aim = np.array(
            place.goal(view("sofa", x, y, facing=pi / 2 if wanted == "aside" else 0.0), 0).targets[0].position_w_m
        )
        away = aim[:2] - [x, y]
        assert bool(abs(away[1]) > abs(away[0])) is (wanted == "aside"), (x, y)
    assert task.goal(view("sofa", -0.6, facing=pi / 2), 30).text == "a person turns to the right."
    down = task.goal(view("sofa", -0.6, facing=0.2), 60)
    assert "sitting down" in str(down.text)
    (target,) = down.targets
    assert target.joint == "pelvis"
    assert target.position_w_m == pytest.approx((-1.22, 0.0, 0.344 + 0.12))  # 0.25 m from the edge
    assert down.heading is not None
    assert np.cos(down.heading.heading_rad) == pytest.approx(1.0, abs=0.01)  # away from the seat
    assert task.goal(view("sofa", -0.6, tick=75), 75).targets[0].arrival_tick == target.arrival_tick
    # On the seat it stays where it sits, straight behind where it stood.
    aside = make_task(SitSpec(), 0)
    aside.start(view("sofa", -0.6, 0.3))
    assert aside.goal(view("sofa", -0.6, 0.3), 0).targets[0].position_w_m[:2] == pytest.approx((-1.22, 0.3))
    sat = aside.goal(view("sofa", -1.25, 0.4, lift=STAND_TO_SEAT_M), 60)
    assert sat.targets[0].position_w_m == pytest.approx((-1.25, 0.4, 0.344 + 0.12))
    assert "sitting down" not in str(sat.text)
    # Where no seat was met it begins anew, with the walk to the front.
    late = task.goal(view("sofa", 1.5, facing=pi, tick=60 + 200), 60 + 200)
    assert late.text == "a person is walking."


HIGH_M = 0.592


def on_high_sofa(x: float, y: float, above_m: float) -> BodyView:
    """The body with its pelvis so far above the top of a sofa of HIGH_M."""
    sofa = load_scene("sofa")
    (body,) = sofa.bodies
    ranges = RandomRanges(size=(1.0, 1.0), height=(1.72, 1.72))
    high = sampled(sofa.model_copy(update={"bodies": (body.model_copy(update={"random": ranges}),)}), 0)
    mark = high.marks["seat_centre"].position_b_m
    assert mark is not None and mark[2] == pytest.approx(HIGH_M, abs=0.01)
    here = view("sofa", x, y, lift=mark[2] + above_m - float(STAND[0, 2]))
    return replace(here, scene=high, objects={"sofa": np.asarray(pose_of(high.bodies[0]), dtype=np.float64)})


@pytest.mark.parametrize(("aside_m", "above_m", "low"), [(0.0, 0.12, 1.0), (0.0, 0.3, 0.0), (1.5, 0.12, 0.0)])
def test_who_sits_on_a_high_seat_sits_though_the_pelvis_is_high(aside_m: float, above_m: float, low: float) -> None:
    seen = on_high_sofa(-1.3, aside_m, above_m)
    task = make_task(GetUpSpec.model_validate({"sit_first": False}), 0)
    task.start(seen)
    trace = Trace(0, np.repeat(seen.pos_w_m[None], 3, axis=0), np.zeros(3, dtype=bool))
    assert task.judge(trace).measures["was_low"] == low


def test_on_a_high_seat_one_sits_deeper_and_who_hangs_on_its_edge_goes_on_sitting_down() -> None:
    stands, hangs, sits = (on_high_sofa(*at) for at in ((-0.6, 0.0, 0.36), (-0.95, 0.0, 0.12), (-1.1, 0.0, 0.12)))
    task = make_task(SitSpec(), 0)
    task.start(stands)
    place = task.goal(stands, 0).targets[0].position_w_m
    assert place[0] == pytest.approx(-1.3)  # the middle of the seat: no deeper
    for seen, wanted in ((hangs, place[0]), (sits, -1.1)):
        goal = task.goal(replace(seen, tick=60), 60)
        assert goal.targets[0].position_w_m[0] == pytest.approx(wanted)
        assert ("sitting down" in str(goal.text)) is (seen is hangs)


def test_getting_up_goes_over_the_feet_and_ends_before_the_seat_or_where_it_lay() -> None:
    task = make_task(GetUpSpec(), 0)
    seat = view("sofa", -1.3, 0.4, lift=-0.45)
    feet = [CANONICAL.index(f"{side}_{part}") for side in ("left", "right") for part in ("ankle", "foot")]
    seat.pos_w_m[feet, 0] += 0.5
    task.start(seat)
    aim = np.array([-1.3 + 0.33 + 0.3, 0.4, 0.9])  # straight ahead of where it sits
    assert task.target_w_m == pytest.approx(aim)
    goal = task.goal(seat, 0)
    (target,) = goal.targets
    assert target.joint == "pelvis"
    over = seat.pos_w_m[feet, :2].mean(axis=0)
    assert target.position_w_m == pytest.approx((*over, 0.9), abs=1e-6)
    assert goal.hold_ticks > 15
    assert goal.heading is not None
    up = task.goal(view("sofa", -1.0, 0.4, tick=60), 60)
    assert (up.targets[0].joint, up.text) == ("traj", STAND_TEXT)  # a step's width: as `reach` ends
    assert up.targets[0].position_w_m == pytest.approx((aim[0], aim[1], 0.0), abs=1e-6)
    assert task.goal(view("sofa", aim[0], 0.4, tick=90), 90).text == STAND_TEXT
    far = make_task(GetUpSpec(), 0)
    far.start(view("sofa", -1.3, 2.0, lift=-0.45))
    assert far.target_w_m[1] == pytest.approx(1.15)  # not beyond the seat's end
    floor = make_task(GetUpSpec.model_validate({"from": "floor"}), 0)
    floor.start(view("flat", 2.0, 1.0, lift=-0.8))
    goal = floor.goal(view("flat", 2.0, 1.0, lift=-0.8), 0)
    assert (goal.may_be_low, goal.planner, goal.targets) == (True, RISE_PLANNER, ())
    # Other words than its own are the character's own planner's.
    told = make_task(GetUpSpec.model_validate({"from": "floor", "text": "a person rolls over and stands up."}), 0)
    told.start(view("flat", 2.0, 1.0, lift=-0.8))
    goal = told.goal(view("flat", 2.0, 1.0, lift=-0.8), 0)
    assert goal.may_be_low and goal.planner is None
    assert goal.targets[0].position_w_m == pytest.approx((2.0, 1.0, 0.9), abs=0.02)
    assert (task.posture, floor.posture, make_task(SitSpec(), 0).posture) == ("upright", "from_floor", "seated")


def test_a_retry_of_getting_up_sits_down_first() -> None:
    spec = GetUpSpec().again()
    assert GetUpSpec.model_validate({"from": "floor"}).again() == GetUpSpec.model_validate({"from": "floor"})
    task = make_task(spec, 0)
    standing, facing = view("sofa", -0.6), view("sofa", -0.6, facing=0.1)
    task.start(standing)
    assert task.time_limit_s == pytest.approx(13.0 + 17.0)
    assert "sitting down" in str(task.goal(facing, 0).text)
    verdict = task.judge(Trace(1, np.repeat(standing.pos_w_m[None], 30, axis=0), np.zeros(30, dtype=bool)))
    assert (verdict.strict, verdict.code, verdict.measures["was_low"]) == (False, False, 0.0)
    sat = view("sofa", -1.3, lift=STAND_TO_SEAT_M)
    trace = Trace(1, np.repeat(sat.pos_w_m[None], 30, axis=0), np.zeros(30, dtype=bool), seated_world(30))
    assert task.status(trace) == "running"
    assert "getting up" in str(task.goal(sat, 30).text)
    # Who sits already gets up at once.
    low = make_task(spec, 0)
    low.start(sat)
    assert "getting up" in str(low.goal(sat, 0).text)


STAND_TO_SEAT_M = 0.344 + 0.12 - float(STAND[0, 2])


def seated_world(ticks: int) -> World:
    """The sofa carrying the whole of 72 kg at every tick."""
    (sofa,) = load_scene("sofa").bodies
    return World(
        ("sofa",), np.repeat(pose_of(sofa)[None, None].astype(np.float64), ticks, axis=0), np.zeros((ticks, 1, 6)),
        np.arange(ticks), np.zeros(ticks, dtype=np.int64), np.zeros(ticks, dtype=np.int64),
        np.full(ticks, 72 * 9.81 / 30),
    )  # fmt: skip


def test_who_never_sat_has_not_got_up() -> None:
    """Standing where one should end is no getting up: `was_low` is 0 and strict fails."""
    task = make_task(GetUpSpec(height_m=float(STAND[0, 2])), 0)
    standing = view("sofa", -1.4 + 0.10 + 0.63)
    task.start(standing)
    trace = Trace(1, np.repeat(standing.pos_w_m[None], 60, axis=0), np.zeros(60, dtype=bool))
    verdict = task.judge(trace)
    assert (verdict.strict, verdict.code, verdict.measures["was_low"]) == (False, True, 0.0)


def test_a_velocity_is_judged_after_the_settling_time() -> None:
    task = make_task(VelocitySpec(relative_mps=(1.0, 0.0), duration_s=3.0, settle_s=1.0), 0)
    task.start(view("flat", facing=pi / 2))
    goal = task.goal(view("flat", facing=pi / 2), 0)
    assert goal.desired_velocity_w_mps == pytest.approx((0.0, 1.0))
    for speed, strict in ((1.0, True), (0.75, True), (0.65, False), (1.35, False)):
        positions = np.repeat(STAND[None], 100, axis=0)
        positions[30:, :, 1] += (np.arange(70) * speed / 30)[:, None]
        trace = Trace(1, positions, np.zeros(100, dtype=bool))
        assert task.judge(trace).strict is strict, speed
    trace.fallen[95] = True
    assert task.judge(trace).fell


def test_gait_and_style_make_the_sentence_and_the_speed() -> None:
    plain, run = ReachSpec(), ReachSpec(gait="run", style="happily")
    assert (plain.prompt, run.prompt) == ("a person is walking.", "a person is running happily.")
    assert run.paced.speed_mps > 2 * plain.paced.speed_mps
    with pytest.raises(ValidationError, match="not both"):
        ReachSpec(gait="run", text="a person crawls.")
    assert ReachSpec.model_validate_json(run.model_dump_json()) == run


def test_every_kind_round_trips_as_json_and_is_made() -> None:
    adapter: TypeAdapter[TaskSpec] = TypeAdapter(TaskSpec)
    assert {"reach", "strike", "sit", "get_up", "halt", "text", "velocity"} <= set(KINDS)
    for spec in (StrikeSpec(limb="left_foot"), SitSpec(), GetUpSpec.model_validate({"from": "floor"})):
        read = adapter.validate_json(spec.model_dump_json())
        assert read == spec
        assert make_task(read, 3).kind == spec.type
    with pytest.raises(ValidationError, match="limb"):
        adapter.validate_python({"type": "strike", "limb": "head"})


def test_a_scene_without_the_mark_is_refused_with_those_it_has() -> None:
    for spec, scene in ((StrikeSpec(), "sofa"), (SitSpec(), "bag"), (GetUpSpec(), "flat")):
        with pytest.raises(InvalidInputError, match="has no mark") as caught:
            spec.check(load_scene(scene))
        assert caught.value.field == "mark"
        with pytest.raises(InvalidInputError):
            make_task(spec, 0).start(view(scene))
    StrikeSpec().check(load_scene("room"))
    GetUpSpec.model_validate({"from": "floor"}).check(load_scene("flat"))
