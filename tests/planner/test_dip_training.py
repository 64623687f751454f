"""Training: windows, joins, losses, and a resume that is exact."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from planner_service.dip.config import preset
from planner_service.dip.features_torch import Normalizer, plan_to_positions
from planner_service.dip.network import DipNetwork
from planner_service.dip.weights import load_weights
from planner_service.training.bending import MAX_SIDEWAYS_MPS2, random_turns
from planner_service.training.dataset import (
    Material,
    TextBank,
    Told,
    WindowSampler,
    emphasized,
    feature_statistics,
    load_material,
)
from planner_service.training.disturbance import ARMS, LEAST_STILLED, SETTLE_FRAMES, stilled_arms
from planner_service.training.export import export
from planner_service.training.joins import JoinFinder, join, speed_gap_mps
from planner_service.training.losses import LossWeights, dip_loss, feature_weights, sample_targets
from planner_service.training.trainer import Trainer, TrainSettings, learning_rate, read_checkpoint
from shared.data.corpus import Corpus
from shared.errors import InvalidInputError
from shared.motion.features import FEATURES, ROOT_VELOCITY, YAW_RATE
from shared.motion.ik import standing_clip
from shared.motion.skeleton import CANONICAL
from tests.planner.dip_helpers import HashEncoder, write_small_corpus


@pytest.fixture(scope="module")
def material(tmp_path_factory: pytest.TempPathFactory) -> Material:
    return load_material(Corpus.load(write_small_corpus(tmp_path_factory.mktemp("corpus") / "v")), "train", 60)


def trainer(material: Material, out: Path, seed: int = 0, workers: int = 0) -> Trainer:
    torch.manual_seed(seed)
    network = DipNetwork(preset("tiny").model_copy(update={"dropout": 0.1}))
    normalizer = Normalizer(*feature_statistics(WindowSampler(material, 20, 40, 0), 2))
    settings = TrainSettings(
        batch=8, seed=seed, log_every=2, save_every=100, learning_rate=1e-3, warmup_steps=2, workers=workers
    )
    texts = TextBank(HashEncoder(), material.sentences)
    return Trainer(network, normalizer, WindowSampler(material, 20, 40, seed), texts, settings, out)


def test_only_the_split_is_loaded(material: Material) -> None:
    assert len(material.length) == 5
    assert abs(material.weight.sum() - 1.0) < 1e-9
    assert material.behaviours == ("stand", "walk")
    assert len(material.features) == material.length.sum()


def test_a_split_without_clips_is_an_error(tmp_path: Path) -> None:
    corpus = Corpus.load(write_small_corpus(tmp_path / "v"))
    with pytest.raises(InvalidInputError):
        load_material(corpus, "train", 1000)


def test_windows_are_finite_and_repeat_with_the_generator(material: Material) -> None:
    sampler = WindowSampler(material, 20, 40, 3)
    state = sampler.state()
    first = sampler.draw(32)
    assert first.features.shape == (32, 60, FEATURES)
    assert torch.isfinite(first.features).all()
    sampler.restore(state)
    again = sampler.draw(32)
    assert torch.equal(first.features, again.features)
    assert (first.sentence == again.sentence).all()


def test_sentences_belong_to_the_clip_the_plan_ends_in(material: Material) -> None:
    batch = WindowSampler(material, 20, 40, 5).draw(64)
    for sentence, clip in zip(batch.sentence, batch.clip, strict=True):
        assert sentence in material.texts[clip]


def test_joined_windows_have_no_jump(material: Material) -> None:
    enterable = np.arange(len(material.features)) % 100 > 5
    finder = JoinFinder(material.features, material.behaviour[material.clip], enterable)
    rng = np.random.default_rng(0)
    last = np.array([30, 40])
    enter = np.array([finder.find(int(i), 1, rng)[0] for i in last])
    enter = np.minimum(enter, len(material.features) - 45)
    windows = join(material.features, last, enter, np.array([20, 20]), np.array([6, 6]), 60)
    positions, _ = plan_to_positions(torch.from_numpy(windows), 20)
    step = torch.diff(positions, dim=1).norm(dim=-1)
    assert float(step[:, 15:30].max()) < 3 * float(step[:, :15].max()) + 0.05
    before = material.features[last[:, None] - 19 + np.arange(1, 19)]
    after = material.features[enter[:, None] + np.arange(10, 40)]
    np.testing.assert_allclose(windows[:, 1:19, :259], before[..., :259], atol=1e-4)
    np.testing.assert_allclose(windows[:, 30:, :4], after[..., :4], atol=1e-4)


def test_stilled_arms_swing_less_in_the_prefix_and_as_recorded_in_the_plan() -> None:
    time = np.arange(60) / 20
    pose = standing_clip(60, 20).positions_w_m
    elbow, wrist = CANONICAL.indices("right_elbow", "right_wrist")
    length = np.linalg.norm(pose[0, wrist] - pose[0, elbow])
    angle = 0.5 * np.sin(2 * np.pi * 1.5 * time)
    pose[:, wrist] = pose[:, elbow] + length * np.stack([0 * time, np.sin(angle), np.cos(angle)], axis=-1)
    windows = np.repeat(pose[None], 16, 0)
    out = stilled_arms(windows, 20, np.random.default_rng(0))
    others = [joint for joint in range(22) if joint not in np.ravel(ARMS)]
    np.testing.assert_array_equal(out[:, :, others], windows[:, :, others])
    np.testing.assert_array_equal(out[:, 20 + SETTLE_FRAMES :], windows[:, 20 + SETTLE_FRAMES :])
    np.testing.assert_allclose(np.linalg.norm(out[:, :, wrist] - out[:, :, elbow], axis=-1), length, atol=1e-9)
    swing = np.ptp(out[:, :20, wrist, 1], axis=1) / np.ptp(pose[:20, wrist, 1])
    assert swing.max() < 1 - 0.8 * LEAST_STILLED
    assert swing.min() < 0.3


def test_between_two_ways_to_say_a_thing_lie_others() -> None:
    bank = TextBank(HashEncoder(), ["walk on", "go ahead"])
    pair, yes = torch.tensor([0, 0, 0]), torch.tensor([True, True, False])
    told = Told(pair, pair + 1, torch.tensor([0.0, 0.25, 0.5]), torch.tensor([False, True, False]), yes)
    text, mask = bank.told(told)
    first, second = bank.pooled()
    torch.testing.assert_close(text[:, 0], torch.stack([torch.lerp(first, second, s) for s in told.share]))
    torch.testing.assert_close(text[:, 1:], bank.rows(pair, yes)[0][:, 1:])
    assert mask[0].all() and mask[1].tolist() == [True, False, False] and not mask[2].any()
    torch.testing.assert_close(bank.pooled()[0], first)


def test_only_what_legs_can_follow_is_joined(material: Material, monkeypatch: pytest.MonkeyPatch) -> None:
    features = material.features.copy()
    sampler = WindowSampler(material, 20, 40, 5)
    made, windows, ends = sampler._join(np.zeros(12, np.int64))
    assert made.any() and len(windows) == len(ends) == made.sum()
    assert speed_gap_mps(features, 30, 31) < 0.2
    features[30, ROOT_VELOCITY] += 3.0
    assert speed_gap_mps(features, 30, 40) == pytest.approx(3.0 * 2**0.5, abs=0.5)
    monkeypatch.setattr("planner_service.training.dataset.MAX_SPEED_GAP_MPS", -1.0)
    made, windows, ends = sampler._join(np.zeros(12, np.int64))
    assert not made.any() and windows.shape == (0, 60, 263) and len(ends) == 0
    assert torch.isfinite(sampler.draw(8).features).all()


def test_fast_windows_are_bent_as_far_as_a_body_bears_it_upright() -> None:
    features = np.zeros((200, 60, 263), np.float32)
    features[..., ROOT_VELOCITY.start] = 4.0
    sideways = 4.0 * np.abs(random_turns(features, 20, np.random.default_rng(0))).max(axis=1) * 20
    assert 0.8 < sideways.max() <= MAX_SIDEWAYS_MPS2 + 1e-6


def test_perfect_prediction_leaves_only_the_datas_own_skating(material: Material) -> None:
    plan = WindowSampler(material, 20, 40, 0).draw(16).features
    prefix, plan = plan.split([20, 40], dim=1)
    mean, std = torch.zeros(FEATURES), torch.ones(FEATURES)
    targets = sample_targets(plan, 8, torch.Generator().manual_seed(0))
    weights = LossWeights()
    _, terms = dip_loss(
        plan, plan, prefix[:, -1], mean, std, targets, torch.ones(16), weights, feature_weights(weights)
    )
    for name in ("x0", "target", "heading", "position", "velocity"):
        assert abs(terms[name]) < 1e-6, name


def test_facing_backwards_costs_pi_squared(material: Material) -> None:
    prefix, plan = WindowSampler(material, 20, 40, 0).draw(8).features.split([20, 40], dim=1)
    targets = sample_targets(plan, 8, torch.Generator().manual_seed(0))
    backwards = plan.clone()
    backwards[:, 0, YAW_RATE] += torch.pi * 20
    weights = LossWeights()
    ones, zeros = torch.ones(FEATURES), torch.zeros(FEATURES)
    _, terms = dip_loss(
        backwards, plan, prefix[:, -1], zeros, ones, targets, torch.ones(8), weights, feature_weights(weights)
    )
    assert abs(terms["heading"] * 8 / max(int(targets.heading_valid.sum()), 1) - np.pi**2) < 1e-2


def test_half_of_the_windows_have_nothing_but_their_text(material: Material) -> None:
    plan = WindowSampler(material, 20, 40, 0).draw(512).features[:, 20:]
    targets = sample_targets(plan, 8, torch.Generator().manual_seed(3))
    free = ~(targets.position_valid.any(-1) | targets.heading_valid)
    # 0.5 + 0.5 x 0.2 x 0.5: a joint or a heading, or neither by chance.
    assert abs(float(free.float().mean()) - 0.55) < 0.07


def test_bent_windows_say_so(material: Material) -> None:
    batch = WindowSampler(material, 20, 40, 0).draw(256)
    straight = WindowSampler(material, 20, 40, 0, augment=False).draw(256)
    assert 0 < batch.bent.sum() < 256
    assert not straight.bent.any()


def test_targets_are_where_the_clip_is_at_arrival(material: Material) -> None:
    plan = WindowSampler(material, 20, 40, 0).draw(64).features[:, 20:]
    targets = sample_targets(plan, 8, torch.Generator().manual_seed(1))
    positions, _ = plan_to_positions(plan, 20)
    assert targets.position_frame.min() >= 8
    assert targets.position_frame.max() == 40
    count = targets.position_valid.sum(-1)
    assert 0 < (count == 2).sum() < (count == 1).sum() and count.max() == 2
    assert targets.position_valid[count == 2, 6].all(), "the second place is the root's, at the same frame"
    for row in torch.nonzero(targets.position_valid[:, 6]).flatten().tolist():
        frame = int(targets.position_frame[row, 6])
        torch.testing.assert_close(targets.position_m[row, 6, :2], positions[row, frame - 1, 0, :2])


@pytest.mark.parametrize("workers", [0, 2])
def test_resume_is_exact(material: Material, tmp_path: Path, workers: int) -> None:
    whole = trainer(material, tmp_path / "whole", workers=workers)
    whole.run(6, lambda: False, lambda line: None)
    half = trainer(material, tmp_path / "half", workers=workers)
    half.run(3, lambda: False, lambda line: None)
    # Workers draw by seed and step: the seed is part of the command, the state of the other way of a checkpoint.
    rest = trainer(material, tmp_path / "half", seed=0 if workers else 9, workers=workers)
    rest.restore(read_checkpoint(tmp_path / "half" / "last.pt"))
    rest.run(6, lambda: False, lambda line: None)
    for one, other in zip(whole.network.parameters(), rest.network.parameters(), strict=True):
        assert torch.equal(one, other)
    for one, other in zip(whole.average.parameters(), rest.average.parameters(), strict=True):
        assert torch.equal(one, other)
    assert rest.state.step == 6


def test_learning_rate_rises_then_falls() -> None:
    settings = TrainSettings(learning_rate=1.0, warmup_steps=10, decay_until=100)
    assert learning_rate(settings, 4) == 0.5 * 0.96
    assert learning_rate(settings, 50) == 0.5
    assert learning_rate(settings, 5000) == 0.05
    assert learning_rate(TrainSettings(learning_rate=1.0, warmup_steps=10), 5000) == 1.0


def test_a_stop_writes_a_checkpoint(material: Material, tmp_path: Path) -> None:
    stopped = trainer(material, tmp_path)
    stopped.run(100, lambda: stopped.state.step >= 2, lambda line: None)
    assert read_checkpoint(tmp_path / "last.pt")["step"] == 2


def test_training_lowers_the_loss(material: Material, tmp_path: Path) -> None:
    run = trainer(material, tmp_path)
    losses = [run.train_step()["loss"] for _ in range(60)]
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:10])


def test_exported_weights_are_the_average_in_half_precision(material: Material, tmp_path: Path) -> None:
    run = trainer(material, tmp_path)
    run.run(3, lambda: False, lambda line: None)
    export(tmp_path / "last.pt", tmp_path / "w.safetensors", None, None)
    loaded = load_weights(tmp_path / "w.safetensors")
    for ours, theirs in zip(loaded.network.parameters(), run.average.parameters(), strict=True):
        torch.testing.assert_close(ours, theirs.half().float())
    torch.testing.assert_close(loaded.normalizer.mean, run.normalizer.mean)
    assert (tmp_path / "w.json").is_file()


def test_text_rows_can_be_dropped(material: Material) -> None:
    bank = TextBank(HashEncoder(), material.sentences)
    _, mask = bank.rows(torch.tensor([0, 1]), torch.tensor([True, False]))
    assert mask[0].any()
    assert not mask[1].any()


def test_emphasis_multiplies_a_behaviours_share(material: Material) -> None:
    stand = material.behaviours.index("stand")
    before = material.weight[material.behaviour == stand].sum()
    after = emphasized(material, {"stand": 3.0}).weight[material.behaviour == stand].sum()
    assert abs(after - 3 * before / (1 + 2 * before)) < 1e-9
    action = material.actions[0]
    own = np.array([a == action for a in material.actions])
    share = material.weight[own].sum()
    doubled = emphasized(material, {f"action:{action}": 2.0}).weight[own].sum()
    assert abs(doubled - 2 * share / (1 + share)) < 1e-9
    with pytest.raises(InvalidInputError) as caught:
        emphasized(material, {"fly": 2.0})
    assert caught.value.field == "emphasis"
