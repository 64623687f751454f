"""The plug-in: seeds, batches, horizons, targets, and plans that are clips of exact bone lengths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from planner_service.dip.conditions import JOINT_SLOTS
from planner_service.dip.config import preset
from planner_service.dip.effort import EASIER_GUIDANCE, eased, hardest_mps2, speed_mps
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork
from planner_service.dip.planner import DipPlanner, DipSettings
from planner_service.dip.weights import load_weights, save_weights
from planner_service.text.encoder import TextEncoderSpec
from shared.errors import InvalidInputError, UnavailableError
from shared.motion.features import global_to_features
from shared.motion.resampling import finite_velocity
from shared.motion.skeleton import CANONICAL
from shared.protocol.messages import HeadingTarget, JointTarget, PlanRequest
from tests.planner.dip_helpers import HashEncoder, moving_body


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(1)
    features = torch.from_numpy(global_to_features(moving_body(200, 20.0), 20)).float()
    normalizer = Normalizer(features.mean(0), features.std(0).clamp_min(0.02) * 0.1)
    path = tmp_path_factory.mktemp("dip") / "tiny.safetensors"
    save_weights(path, DipNetwork(preset("tiny")), normalizer, {"name": "dip"})
    return path


@pytest.fixture(scope="module")
def planner(weights: Path) -> DipPlanner:
    return DipPlanner(load_weights(weights), HashEncoder(), DipSettings(bf16=False))


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


def test_a_plan_is_a_clip_of_exact_bone_lengths(planner: DipPlanner) -> None:
    plan = planner.plan([request()])[0]
    assert plan.positions_w_m.shape == (40, 22, 3)
    assert plan.start_tick == 30
    parents = np.array(CANONICAL.parents[1:])
    bones = np.linalg.norm(plan.positions_w_m[:, 1:] - plan.positions_w_m[:, parents], axis=-1)
    np.testing.assert_allclose(bones, np.broadcast_to(CANONICAL.bone_lengths_m[1:], bones.shape), atol=1e-4)


def test_same_seed_same_plan_another_seed_another(planner: DipPlanner) -> None:
    first, again = planner.plan([request()])[0], planner.plan([request()])[0]
    np.testing.assert_array_equal(first.positions_w_m, again.positions_w_m)
    other = planner.plan([request(seed=8)])[0]
    assert np.abs(first.positions_w_m - other.positions_w_m).max() > 1e-3


def test_texts_pull_less_at_a_body_that_runs(planner: DipPlanner) -> None:
    assert [eased(5.0, v) for v in (0.0, 1.2, 1.6, 2.0, 4.0)] == pytest.approx([5.0, 5.0, 3.0, 1.0, 1.0])
    assert eased(0.5, 3.0) == 0.5  # who asks for less than none at all keeps it

    def at(mps: float, **changes: object) -> PlanRequest:
        prefix = np.repeat(moving_body(1, 20.0), 20, axis=0)
        prefix[:, :, 1] += (np.arange(20) * mps / 20)[:, None]
        return request(prefix_positions_w_m=prefix, prefix_velocities_w_mps=finite_velocity(prefix, 20), **changes)

    assert speed_mps(at(1.6)) == pytest.approx(1.6)
    assert planner.plan([at(0.5)])[0].guidance == DipSettings().guidance
    assert planner.plan([at(1.6)])[0].guidance == pytest.approx(eased(DipSettings().guidance, 1.6))
    assert planner.plan([at(3.0)])[0].guidance == 1.0
    assert planner.plan([at(3.0, guidance=5.0)])[0].guidance == 5.0


def test_a_plan_does_not_depend_on_its_batch(planner: DipPlanner) -> None:
    alone = planner.plan([request()])[0]
    mixed = planner.plan([request(text=None, seed=3), request(), request(text="run and jump about", seed=4)])[1]
    np.testing.assert_allclose(alone.positions_w_m, mixed.positions_w_m, atol=1e-4)


def test_text_and_guidance_count_and_no_text_is_the_free_branch(planner: DipPlanner) -> None:
    free = planner.plan([request(text=None)])[0].positions_w_m
    unguided = planner.plan([request(guidance=0.0)])[0].positions_w_m
    np.testing.assert_allclose(free, unguided, atol=1e-4)
    assert np.abs(planner.plan([request(guidance=7.5)])[0].positions_w_m - free).max() > 1e-4


def test_the_noisiest_steps_are_guided_less(weights: Path) -> None:
    def plan(coarse_steps: int, guidance: float, coarse: float = 1.0) -> np.ndarray:
        settings = DipSettings(bf16=False, steps=10, coarse_steps=coarse_steps, coarse_guidance=coarse)
        own = DipPlanner(load_weights(weights), HashEncoder(), settings)
        return own.plan([request(guidance=guidance)])[0].positions_w_m

    plain, full = plan(0, 1.0), plan(0, 5.0)
    np.testing.assert_allclose(plan(10, 5.0), plain, atol=1e-5)
    np.testing.assert_allclose(plan(10, 5.0, 5.0), full, atol=1e-5)
    partly = plan(4, 5.0)
    assert np.abs(partly - plain).max() > 1e-5
    assert np.abs(partly - full).max() > 1e-5
    # A request that asks for less than the coarse guidance gets what it asks for.
    np.testing.assert_allclose(plan(4, 0.5, 1.5), plan(0, 0.5), atol=1e-5)


def test_fewer_steps_make_another_plan_and_no_more_are_taken_than_were_trained(weights: Path) -> None:
    def plan(steps: int) -> np.ndarray:
        own = DipPlanner(load_weights(weights), HashEncoder(), DipSettings(bf16=False, steps=steps))
        assert own.runs_in.endswith(f" {min(steps, 10)} steps")
        return own.plan([request()])[0].positions_w_m

    assert DipPlanner(load_weights(weights), HashEncoder(), DipSettings(bf16=False)).runs_in.endswith(" 5 steps")
    assert DipPlanner(load_weights(weights), HashEncoder(), DipSettings(bf16=True)).runs_in.endswith(" 10 steps")
    np.testing.assert_array_equal(plan(11), plan(10))
    assert np.abs(plan(4) - plan(10)).max() > 1e-5


def test_targets_are_not_guided_away_from(planner: DipPlanner) -> None:
    target = JointTarget(joint="traj", position_w_m=(1.0, 0.0, 0.0), arrival_tick=90)
    default = planner.plan([request(targets=[target])])[0].positions_w_m
    np.testing.assert_array_equal(default, planner.plan([request(targets=[target], guidance=1.0)])[0].positions_w_m)
    assert np.abs(default - planner.plan([request(targets=[target], guidance=5.0)])[0].positions_w_m).max() > 1e-5


def test_a_plan_moves_with_its_world(planner: DipPlanner) -> None:
    """Turning and shifting the prefix and the targets turns and shifts the plan: one frame convention throughout."""
    prefix = moving_body(20, 20.0)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([3.0, -2.0, 0.0])
    goal = np.array([1.0, 0.4, 0.0])

    def ask(p: np.ndarray, place: np.ndarray, heading: float) -> np.ndarray:
        target = JointTarget(joint="traj", position_w_m=tuple(place), arrival_tick=90)
        return planner.plan(
            [
                request(
                    prefix_positions_w_m=p,
                    targets=[target],
                    heading=HeadingTarget(heading_rad=heading, arrival_tick=90),
                )
            ]
        )[0].positions_w_m

    here = ask(prefix, goal, 0.5)
    there = ask(prefix @ turn.T + shift, turn @ goal + shift, 0.5 + np.pi / 2)
    np.testing.assert_allclose(there, here @ turn.T + shift, atol=2e-3)


def test_every_slot_counts(planner: DipPlanner) -> None:
    free = planner.plan([request()])[0].positions_w_m
    for slot in JOINT_SLOTS:
        target = JointTarget(joint=slot, position_w_m=(1.0, 0.5, 0.9), arrival_tick=60)
        plan = planner.plan([request(targets=[target])])[0]
        assert plan.ignored_conditions == []
        assert np.abs(plan.positions_w_m - free).max() > 1e-5, slot


def test_bfloat16_differs_by_rounding_only(planner: DipPlanner, weights: Path) -> None:
    rounded = DipPlanner(load_weights(weights), HashEncoder(), DipSettings(bf16=True, steps=5)).plan([request()])[0]
    exact = planner.plan([request()])[0]
    assert 0 < np.abs(rounded.positions_w_m - exact.positions_w_m).max() < 0.02


def test_what_is_not_honoured_is_said(planner: DipPlanner) -> None:
    target = JointTarget(joint="left_knee", position_w_m=(1.0, 0.0, 0.5), arrival_tick=60)
    plan = planner.plan([request(targets=[target], desired_velocity_w_mps=(1.0, 0.0))])[0]
    assert plan.ignored_conditions == ["target:left_knee"], "the service adds what `conditions` does not hold"


def test_horizon_cuts_the_plan(planner: DipPlanner) -> None:
    long, short = planner.plan([request(), request(horizon_frames=7)])
    assert len(short.positions_w_m) == 7
    # A nearly straight knee is found from a square root, which makes more of rounding.
    np.testing.assert_allclose(short.positions_w_m, long.positions_w_m[:7], atol=2e-3)


def test_wrong_lengths_are_named(planner: DipPlanner) -> None:
    with pytest.raises(InvalidInputError) as caught:
        planner.plan([request(horizon_frames=41)])
    assert caught.value.field == "horizon_frames"
    short = {name: np.zeros((19, 22, n)) for name, n in (
        ("prefix_positions_w_m", 3), ("prefix_rotations_6d", 6), ("prefix_velocities_w_mps", 3))}  # fmt: skip
    with pytest.raises(InvalidInputError) as caught:
        planner.plan([request(**short)])
    assert caught.value.field == "prefix_positions_w_m"


def test_weights_that_are_none_are_refused(tmp_path: Path, weights: Path) -> None:
    with pytest.raises(UnavailableError):
        load_weights(tmp_path / "absent.safetensors")
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(weights.read_bytes()[:5000])
    with pytest.raises(InvalidInputError):
        load_weights(cut)


def test_encoder_must_be_the_one_trained_with(weights: Path) -> None:
    class OtherEncoder(HashEncoder):
        @property
        def spec(self) -> TextEncoderSpec:
            return TextEncoderSpec("distilbert", 768, "0", 8)

    with pytest.raises(InvalidInputError) as caught:
        DipPlanner(load_weights(weights), OtherEncoder())
    assert caught.value.field == "text_encoder"


def test_a_plan_that_legs_cannot_follow_is_made_again_with_less_guidance(
    planner: DipPlanner, monkeypatch: pytest.MonkeyPatch
) -> None:
    gentle = planner.plan([request(text="walk", guidance=EASIER_GUIDANCE)])[0]
    usual = planner.plan([request(text="walk")])[0]
    monkeypatch.setattr("planner_service.dip.effort.LEGS_MPS2", -1.0)
    again = planner.plan([request(text="walk"), request(text="walk", guidance=5.0), request(text=None)])
    assert [plan.guidance for plan in again] == [EASIER_GUIDANCE, 5.0, None]
    np.testing.assert_array_equal(again[0].positions_w_m, gentle.positions_w_m)
    assert np.abs(usual.positions_w_m - gentle.positions_w_m).max() > 1e-4


def test_the_hardest_change_of_speed_is_found() -> None:
    time = np.arange(40) / 20.0
    motion = np.zeros((40, 22, 3))
    motion[:, :, 0] = (0.5 * 2.5 * time**2)[:, None]
    assert hardest_mps2(motion) == pytest.approx(2.5, rel=1e-6)
    assert hardest_mps2(np.zeros((5, 22, 3))) == 0.0
