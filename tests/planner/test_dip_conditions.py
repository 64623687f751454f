"""Keyframes and velocity as conditions: what a request becomes, weights with and without them, and reports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from planner_service.dip.conditions import KEYFRAME_NUMBERS, KeyframeBatch, VelocityBatch, late_velocity
from planner_service.dip.config import DipConfig, preset
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork, with_conditions
from planner_service.dip.planner import DipPlanner, DipSettings
from planner_service.dip.weights import DipWeights, load_weights, save_weights
from planner_service.dip.wishes import read_wishes
from shared.errors import InvalidInputError
from shared.motion.features import RootState, global_to_features
from shared.motion.ik import standing_clip
from shared.motion.resampling import finite_velocity
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import JointTarget, PlanRequest
from tests.planner.dip_helpers import HashEncoder, moving_body

BOTH = preset("tiny").model_copy(update={"keyframes": True, "velocity": True})
WRIST = CANONICAL.index("left_wrist")


def request(**changes: object) -> PlanRequest:
    prefix = moving_body(20, 20.0)
    fields: dict[str, object] = {
        "start_tick": 30,
        "prefix_positions_w_m": prefix,
        "prefix_rotations_6d": np.zeros((20, 22, 6)),
        "prefix_velocities_w_mps": finite_velocity(prefix, 20),
        "text": "walk",
        "seed": 7,
    }
    return PlanRequest.model_validate({**fields, **changes})


def keys(*due: tuple[int, int, tuple[float, float, float]]) -> dict[str, object]:
    """Fields of a request with one joint a key, each (tick, joint, place)."""
    mask, places = np.zeros((len(due), 22), np.uint8), np.full((len(due), 22, 3), np.nan)
    for row, (_, joint, place) in enumerate(due):
        mask[row, joint] = 1
        places[row, joint] = place
    return {
        "keyframe_ticks": np.array([tick for tick, _, _ in due]),
        "keyframe_mask": mask,
        "keyframe_positions_w_m": np.nan_to_num(places, nan=7.0),
    }


@pytest.fixture(scope="module")
def plain() -> DipWeights:
    torch.manual_seed(1)
    features = torch.from_numpy(global_to_features(moving_body(200, 20.0), 20)).float()
    normalizer = Normalizer(features.mean(0), features.std(0).clamp_min(0.02) * 0.1)
    return DipWeights(DipNetwork(preset("tiny")).eval().requires_grad_(False), normalizer, "0" * 64)


@pytest.fixture(scope="module")
def taught(plain: DipWeights) -> DipWeights:
    """Weights whose keyframes and velocity do something."""
    network = with_conditions(plain.network, ("keyframes", "velocity")).requires_grad_(False)
    torch.nn.init.normal_(network.keyframe_in.weight)
    torch.nn.init.normal_(network.velocity_in.weight)
    return replace(plain, network=network)


def planner(weights: DipWeights) -> DipPlanner:
    return DipPlanner(weights, HashEncoder(), DipSettings(bf16=False))


def test_conditions_added_to_weights_change_nothing_until_they_are_trained(plain: DipWeights) -> None:
    """Also with keys of feet that kick, which only the network heeds, and a velocity; guidance is given, since
    its default follows what is asked for."""
    more = replace(plain, network=with_conditions(plain.network, ("keyframes", "velocity")).requires_grad_(False))
    foot = CANONICAL.index("left_foot")
    asked = request(**keys((60, foot, (1.0, 0.2, 0.1))), desired_velocity_w_mps=(1.0, 0.0), guidance=3.0)
    asked = asked.model_copy(update={"text": "a person kicks"})
    before, after = planner(plain).plan([asked])[0], planner(more).plan([asked])[0]
    np.testing.assert_array_equal(after.positions_w_m, before.positions_w_m)
    np.testing.assert_array_equal(planner(more).plan([request()])[0].positions_w_m,
                                  planner(plain).plan([request()])[0].positions_w_m)  # fmt: skip


def test_the_shipped_planner_brings_a_hand_to_its_key_and_to_its_target() -> None:
    shipped = DipPlanner.load(settings=DipSettings(bf16=False, runtime="torch"))
    prefix = standing_clip(20, 20).positions_w_m
    body = {"prefix_positions_w_m": prefix, "prefix_velocities_w_mps": np.zeros((20, 22, 3)), "text": "stand"}
    place = tuple(map(float, prefix[-1, WRIST] + np.array([0.12, 0.04, 0.12], np.float32)))
    keyed = request(**body, **keys((75, WRIST, place)))  # both due 1.5 s ahead
    told = request(**body, targets=[JointTarget(joint="left_wrist", position_w_m=place, arrival_tick=75)])
    for plan in shipped.plan([keyed, told]):
        assert np.linalg.norm(plan.positions_w_m[29, WRIST] - place) < 0.04


def test_a_condition_unknown_is_refused_by_name(plain: DipWeights) -> None:
    with pytest.raises(InvalidInputError) as caught:
        with_conditions(plain.network, ["obstacles"])
    assert caught.value.field == "conditions"


def test_weights_say_which_conditions_they_take(taught: DipWeights, plain: DipWeights, tmp_path: Path) -> None:
    assert planner(plain).spec.conditions == ("text", "target", "heading")
    path = tmp_path / "w.safetensors"
    save_weights(path, taught.network, taught.normalizer, {"name": "dip"})
    loaded = load_weights(path)
    assert planner(loaded).spec.conditions == ("text", "target", "heading", "velocity", "keyframes")
    torch.testing.assert_close(loaded.network.keyframe_in.weight, taught.network.keyframe_in.weight.half().float())
    only = replace(plain, network=with_conditions(plain.network, ["velocity"]).requires_grad_(False))
    assert planner(only).spec.conditions == ("text", "target", "heading", "velocity")


def test_config_of_older_weights_has_neither() -> None:
    old = preset("tiny").model_dump()
    del old["keyframes"], old["velocity"]
    assert DipConfig.model_validate(old).extra_conditions == ()


def test_weights_without_them_are_deaf_to_them(plain: DipWeights) -> None:
    deaf = planner(plain)
    asked = request(**keys((60, WRIST, (1.0, 0.2, 1.1))), desired_velocity_w_mps=(1.0, 0.0))
    plan, free = deaf.plan([asked])[0], deaf.plan([request()])[0]
    np.testing.assert_array_equal(plan.positions_w_m, free.positions_w_m)
    assert plan.guidance == free.guidance == DipSettings().guidance
    assert plan.ignored_conditions == [], "the service names what `conditions` does not hold"


def test_keys_and_velocity_count_and_are_not_guided_away_from(taught: DipWeights) -> None:
    able = planner(taught)
    free = able.plan([request(guidance=1.0)])[0]
    for asked in (keys((60, WRIST, (1.0, 0.2, 1.1))), {"desired_velocity_w_mps": (1.0, 0.0)}):
        plan = able.plan([request(**asked)])[0]
        assert plan.guidance == 1.0
        assert np.abs(plan.positions_w_m - free.positions_w_m).max() > 1e-4


def test_a_plan_with_keys_and_velocity_moves_with_its_world(taught: DipWeights) -> None:
    able, prefix = planner(taught), moving_body(20, 20.0)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift, place = np.array([3.0, -2.0, 0.0]), np.array([1.6, 0.4, 1.0])
    here = request(**keys((60, WRIST, tuple(place))), desired_velocity_w_mps=(0.8, 0.3))
    there = request(
        prefix_positions_w_m=prefix @ turn.T + shift,
        **keys((60, WRIST, tuple(turn @ place + shift))),
        desired_velocity_w_mps=(-0.3, 0.8),
    )
    first, second = (able.plan([asked])[0].positions_w_m for asked in (here, there))
    np.testing.assert_allclose(second, first @ turn.T + shift, atol=5e-3)


def test_a_key_lands_at_its_frame_seen_from_the_last_prefix_frame() -> None:
    """Tick 45 is half a second, so 10 frames, after tick 30; the body stands at (1, 2) and faces +Y."""
    state = RootState(np.array([1.0, 2.0]), np.array(np.pi / 2))
    asked = request(**keys((45, WRIST, (1.0, 2.7, 1.2))), desired_velocity_w_mps=(0.0, 1.5))
    wishes = read_wishes([asked], [state], BOTH, step_m=5.0)
    assert wishes.keyframes is not None
    assert wishes.velocity is not None
    key = wishes.keyframes[0]
    assert key.shape == (40, KEYFRAME_NUMBERS)
    assert torch.nonzero(key.any(-1)).flatten().tolist() == [9]
    np.testing.assert_allclose(key[9, 3 * WRIST : 3 * WRIST + 3], [0.7, 0.0, 1.2], atol=1e-6)
    assert torch.nonzero(key[9, 66:]).flatten().tolist() == [WRIST]
    assert (key[9].abs() > 1e-6).sum() == 3, "x, z and the mask: joints without a key stay zero"
    np.testing.assert_allclose(wishes.velocity[0], [1.5, 0.0, 1.0], atol=1e-6)
    assert wishes.placed == [True]


def test_only_a_place_that_can_be_asked_for_is_placed() -> None:
    state = RootState(np.zeros(2), np.array(0.0))
    asked = [
        request(targets=[JointTarget(joint=joint, position_w_m=(1.0, 0.0, 0.5), arrival_tick=60)])
        for joint in ("left_knee", "left_foot")
    ]
    wishes = read_wishes(asked, [state, state], BOTH, step_m=5.0)
    assert (wishes.placed, wishes.ignored) == ([False, True], [["target:left_knee"], []])


def test_keys_past_or_beyond_the_plan_are_reported(taught: DipWeights) -> None:
    """The plan is from tick 30 to 90."""
    place = (0.9, 0.1, 1.0)
    plan = planner(taught).plan([request(**keys(*((tick, WRIST, place) for tick in (24, 30, 33, 90, 93))))])[0]
    assert plan.ignored_conditions == ["keyframes:24", "keyframes:30", "keyframes:93"]


def test_a_key_out_of_reach_comes_nearer_as_a_whole() -> None:
    state = RootState(np.zeros(2), np.array(0.0))
    head = CANONICAL.index("head")
    asked = request(
        keyframe_ticks=np.array([60]),
        keyframe_mask=np.isin(np.arange(22), (WRIST, head))[None].astype(np.uint8),
        keyframe_positions_w_m=np.where(np.arange(22)[:, None] == head, (20.2, 0.0, 1.6), (19.8, 0.0, 1.0))[None],
        desired_velocity_w_mps=(0.0, 9.0),
    )
    wishes = read_wishes([asked], [state], BOTH, step_m=5.0)
    assert wishes.keyframes is not None
    assert wishes.velocity is not None
    key = wishes.keyframes[0, 19]
    np.testing.assert_allclose(key[3 * head : 3 * head + 3], [2.7, 0.0, 1.6], atol=1e-5)
    np.testing.assert_allclose(key[3 * WRIST : 3 * WRIST + 3], [2.3, 0.0, 1.0], atol=1e-5)
    np.testing.assert_allclose(wishes.velocity[0], [0.0, 4.0, 1.0], atol=1e-6)


def test_nothing_asked_is_all_zero() -> None:
    assert not KeyframeBatch.none(2, 40).vector().any()
    assert not VelocityBatch.none(2).vector().any()


def test_late_velocity_is_that_of_the_second_half() -> None:
    """10 frames in place, then 10 frames of 0.1 m along Y and -0.05 m along X, at 20 fps."""
    steps = torch.cat([torch.zeros(10), torch.arange(1, 11)])
    positions = torch.zeros(1, 20, 22, 3)
    positions[..., 1] = 0.1 * steps[:, None]
    positions[..., 0] = -0.05 * steps[:, None]
    torch.testing.assert_close(late_velocity(positions, 20.0), torch.tensor([[-1.0, 2.0]]))
