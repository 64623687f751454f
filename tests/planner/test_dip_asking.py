"""Training with keyframes and velocity: what windows ask for, its losses, warm starts, and a resume that is exact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from planner_service.dip.conditions import SLOT_JOINTS, KeyframeBatch, TargetBatch, VelocityBatch, late_velocity
from planner_service.dip.config import DipConfig, preset
from planner_service.dip.features_torch import Normalizer, plan_to_positions
from planner_service.dip.network import DipNetwork, with_conditions
from planner_service.dip.weights import load_weights, save_weights
from planner_service.training import main
from planner_service.training.asking import MOST_KEYS, sample_asked, sample_keys
from planner_service.training.dataset import Material, TextBank, WindowSampler, feature_statistics, load_material
from planner_service.training.losses import LossWeights, dip_loss, feature_weights, sample_targets
from planner_service.training.trainer import Trainer, TrainSettings, read_checkpoint
from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from shared.motion.features import FEATURES, ROOT_VELOCITY
from shared.motion.skeleton import CANONICAL
from tests.planner.dip_helpers import HashEncoder, write_small_corpus

TINY = preset("tiny").model_copy(update={"dropout": 0.1})
BOTH = TINY.model_copy(update={"keyframes": True, "velocity": True})


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_corpus(tmp_path_factory.mktemp("corpus") / "v")


@pytest.fixture(scope="module")
def material(corpus: Path) -> Material:
    return load_material(Corpus.load(corpus), "train", 60)


def trainer(material: Material, out: Path, config: DipConfig = BOTH, seed: int = 0) -> Trainer:
    torch.manual_seed(seed)
    network = DipNetwork(config)
    normalizer = Normalizer(*feature_statistics(WindowSampler(material, 20, 40, 0), 2))
    settings = TrainSettings(batch=8, seed=seed, log_every=2, save_every=100, learning_rate=1e-3, warmup_steps=2)
    texts = TextBank(HashEncoder(), material.sentences)
    return Trainer(network, normalizer, WindowSampler(material, 20, 40, seed), texts, settings, out)


def test_keys_are_few_and_of_few_joints_or_all() -> None:
    mask = sample_keys(4000, 40, torch.Generator().manual_seed(0))
    keyed = mask.any(-1)
    assert keyed.any(-1).all()
    assert keyed.sum(-1).max() == MOST_KEYS
    assert keyed.any(0).all(), "a key may be at any frame of a plan"
    joints = mask.sum(-1)[keyed]
    assert set(joints.unique().tolist()) >= {1, 2, 3, 4, 22}
    assert abs(float((joints == 22).float().mean()) - 0.3) < 0.03
    alone = mask[(mask.sum(-1) == 1)].float().mean(0)
    wrist, knee = CANONICAL.index("left_wrist"), CANONICAL.index("left_knee")
    assert 2.5 < float(alone[wrist] / alone[knee]) < 6.0


def test_windows_ask_for_what_their_own_plans_do(material: Material) -> None:
    plan = WindowSampler(material, 20, 40, 0).draw(256).features[:, 20:]
    asked = sample_asked(plan, BOTH, 0.5, 0.5, torch.Generator().manual_seed(1))
    assert asked.keyframes is not None
    assert asked.velocity is not None
    positions, _ = plan_to_positions(plan, 20)
    mask = asked.keyframes.mask
    assert torch.equal(asked.keyframes.position_m[mask], positions[mask])
    torch.testing.assert_close(asked.velocity.velocity_mps, late_velocity(positions, 20))
    keyed = mask.flatten(1).any(-1)
    placed = asked.targets.position_valid.any(-1) | asked.targets.heading_valid
    for some in (keyed, asked.velocity.valid, keyed & placed, keyed & ~placed, placed & ~keyed):
        assert some.any()
    assert torch.equal(asked.any(), keyed | asked.velocity.valid | placed)


def test_some_places_are_told_twice_as_a_target_and_as_a_key(material: Material) -> None:
    plan = WindowSampler(material, 20, 40, 0).draw(512).features[:, 20:]
    asked = sample_asked(plan, BOTH, 0.0, 0.0, torch.Generator().manual_seed(1))
    assert asked.keyframes is not None
    limbs = asked.targets.position_valid[:, :-1].any(-1)
    twice = asked.keyframes.mask.flatten(1).any(-1)
    assert 0.25 < float(twice.sum() / limbs.sum()) < 0.55
    assert not (twice & ~limbs).any()
    for row in torch.nonzero(twice).flatten().tolist():
        slot = int(asked.targets.position_valid[row, :-1].float().argmax())
        frame, joint = int(asked.targets.position_frame[row, slot]) - 1, int(SLOT_JOINTS[slot])
        assert torch.nonzero(asked.keyframes.mask[row]).tolist() == [[frame, joint]]


def test_windows_with_nothing_but_their_text_stay_as_many(material: Material) -> None:
    plan = WindowSampler(material, 20, 40, 0).draw(512).features[:, 20:]
    asked = sample_asked(plan, BOTH, 0.5, 0.5, torch.Generator().manual_seed(3))
    plain = sample_asked(plan, TINY, 0.5, 0.5, torch.Generator().manual_seed(3))
    assert torch.equal(asked.any(), plain.any())


def test_without_the_conditions_targets_are_drawn_as_ever(material: Material) -> None:
    plan = WindowSampler(material, 20, 40, 0).draw(32).features[:, 20:]
    ours, theirs = torch.Generator().manual_seed(4), torch.Generator().manual_seed(4)
    asked, targets = sample_asked(plan, TINY, 0.5, 0.5, ours), sample_targets(plan, 8, theirs)
    assert asked.keyframes is None
    assert asked.velocity is None
    assert torch.equal(asked.targets.vector(40), targets.vector(40))
    assert torch.equal(ours.get_state(), theirs.get_state())


def test_missed_keys_and_velocities_cost_their_squares(material: Material) -> None:
    """A plan that goes 0.5 m/s faster along X all the way, in the first frame's heading, of two windows one asked."""
    prefix, plan = WindowSampler(material, 20, 40, 0).draw(2).features.split([20, 40], dim=1)
    plan[..., 0] = 0.0
    faster = plan.clone()
    faster[..., ROOT_VELOCITY.start] += 0.5
    positions, _ = plan_to_positions(plan, 20)
    keys = KeyframeBatch(positions, torch.zeros(2, 40, 22, dtype=torch.bool))
    keys.mask[0, 19, [3, 8]] = True
    velocity = VelocityBatch(late_velocity(positions, 20), torch.tensor([True, False]))
    weights = LossWeights()
    terms = dip_loss(
        faster, plan, prefix[:, -1], torch.zeros(FEATURES), torch.ones(FEATURES), TargetBatch.none(2, 40),
        torch.ones(2), weights, feature_weights(weights), keys, velocity,
    )[1]  # fmt: skip
    assert abs(terms["keyframe_m"] - 0.5) < 1e-4, "20 frames at 20 fps are a second"
    assert abs(terms["keyframe"] - 0.25 / 2) < 1e-4
    assert abs(terms["desired_velocity_mps"] - 0.5) < 1e-4
    assert abs(terms["desired_velocity"] - 0.25 / 2) < 1e-4


@pytest.mark.parametrize("config", [TINY, BOTH], ids=["plain", "conditions"])
def test_a_resumed_training_has_the_same_next_20_losses(material: Material, tmp_path: Path, config: DipConfig) -> None:
    whole = trainer(material, tmp_path, config)
    for _ in range(3):
        whole.train_step()
    whole.save(tmp_path / "last.pt")
    wanted = [whole.train_step() for _ in range(20)]
    rest = trainer(material, tmp_path / "rest", config, seed=9)
    rest.restore(read_checkpoint(tmp_path / "last.pt"))
    assert [rest.train_step() for _ in range(20)] == wanted
    assert ("keyframe" in wanted[0]) == config.keyframes


def test_keys_are_learnt(material: Material, tmp_path: Path) -> None:
    """The new inputs start at zero, so what they do comes from training; gradients reach both."""
    run = trainer(material, tmp_path)
    losses = [run.train_step()["loss"] for _ in range(60)]
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:10])
    for layer in (run.network.keyframe_in, run.network.velocity_in):
        assert layer.weight.abs().max() > 1e-3


def test_a_warm_start_takes_the_conditions_and_a_checkpoint_keeps_its_own(
    corpus: Path, material: Material, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(main, "minilm", HashEncoder)
    monkeypatch.setattr(main.signal, "signal", lambda number, handler: None)
    torch.manual_seed(0)
    old = DipNetwork(TINY)
    normalizer = Normalizer(*feature_statistics(WindowSampler(material, 20, 40, 0), 1))
    save_weights(tmp_path / "old.safetensors", old, normalizer, {})
    options = {"corpus": corpus, "out": tmp_path / "run", "size": "tiny", "batch": 4, "bf16": False}
    main.train(**options, steps=2, init=tmp_path / "old.safetensors", conditions="keyframes,velocity")
    content = read_checkpoint(tmp_path / "run" / "last.pt")
    assert DipConfig.model_validate_json(content["config"]).extra_conditions == ("velocity", "keyframes")
    main.train(**options, steps=3, conditions="keyframes")
    assert read_checkpoint(tmp_path / "run" / "last.pt")["step"] == 3
    main.train(**{**options, "out": tmp_path / "plain"}, steps=1, init=tmp_path / "old.safetensors")
    with pytest.raises(InvalidInputError) as caught:
        main.train(**{**options, "out": tmp_path / "plain"}, steps=2, conditions="keyframes")
    assert caught.value.field == "conditions"


def test_warm_start_keeps_the_weights_outputs(tmp_path: Path) -> None:
    torch.manual_seed(0)
    old = DipNetwork(TINY).eval()
    save_weights(tmp_path / "old.safetensors", old, Normalizer(torch.zeros(FEATURES), torch.ones(FEATURES)), {})
    loaded = load_weights(tmp_path / "old.safetensors").network
    new = with_conditions(loaded, ["keyframes", "velocity"])
    inputs = (
        torch.randn(2, 40, FEATURES), torch.tensor([0, 7]), torch.randn(2, 20, FEATURES), torch.randn(2, 40),
        torch.randn(2, 3, 384), torch.ones(2, 3, dtype=torch.bool),
    )  # fmt: skip
    assert torch.equal(new(*inputs, torch.randn(2, 40, 88), torch.randn(2, 3)), loaded(*inputs))
