"""The trainer end to end on made motion: exact resume, drops of exploded states, export equal in numpy and torch."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.scenes.files import load_scene
from tracker_service.policy.learned import LearnedTracker, policy_input
from tracker_service.policy.observations import feedforward_targets
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import HUMAN
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import build_scene
from tracker_service.training import rewards
from tracker_service.training.dataset import (
    MotionInput,
    ReferenceSet,
    concatenated,
    largest_change_rad,
    load_bank,
    prepare,
    prepare_cached,
    smooth_stretches,
)
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.evaluate import evaluate
from tracker_service.training.export import export_weights
from tracker_service.training.network import ActorCritic, Normalizer, run_mixed
from tracker_service.training.ppo import PpoSettings
from tracker_service.training.trainer import Trainer

HUMANOID = humanoid(HUMAN)
SMALL = EnvSettings(envs=6)


def swaying(name: str, frames: int = 75) -> MotionInput:
    positions = standing_clip(frames, 30.0).positions_w_m.copy()
    positions[:, :, 1] += 0.02 * np.sin(np.arange(frames) / 10.0)[:, None] * positions[:, :, 2]
    return MotionInput(name, "stand", 1.0, positions)


@pytest.fixture(scope="module")
def references() -> ReferenceSet:
    return prepare(HUMANOID, [swaying("a"), swaying("b", 60)])


def trainer(references: ReferenceSet, out: Path) -> Trainer:
    return Trainer(HUMANOID, references, references, out, SMALL, PpoSettings(steps=6, minibatches=2), seed=3)


def test_resume_is_exact(references: ReferenceSet, tmp_path: Path) -> None:
    whole = trainer(references, tmp_path / "a")
    whole.iterate()
    whole.save(tmp_path / "checkpoint.pt")
    expected = [whole.iterate() for _ in range(2)][-1]
    resumed = trainer(references, tmp_path / "b")
    resumed.load(tmp_path / "checkpoint.pt")
    got = [resumed.iterate() for _ in range(2)][-1]
    for name, value in expected.items():
        if not name.endswith("_s"):
            assert got[name] == value, name
    for a, b in zip(whole.network.parameters(), resumed.network.parameters(), strict=True):
        assert torch.equal(a, b)


def test_other_clips_leave_the_optimiser_as_it_was(references: ReferenceSet, tmp_path: Path) -> None:
    """A fresh one would throw the policy far beyond what PPO allows in its first update."""
    t = trainer(references, tmp_path / "a")
    for _ in range(3):
        t.iterate()
    t.updater.learning_rate = 2e-5
    t.save(tmp_path / "checkpoint.pt")
    other = trainer(prepare(HUMANOID, [swaying("c"), swaying("a")]), tmp_path / "b")
    other.load(tmp_path / "checkpoint.pt")
    assert other.updater.learning_rate == 2e-5
    kept, got = (x.updater.optimizer.state_dict()["state"] for x in (t, other))
    assert kept.keys() == got.keys()
    assert all(torch.equal(kept[k]["exp_avg_sq"], got[k]["exp_avg_sq"]) for k in kept)
    fresh = trainer(references, tmp_path / "c")
    fresh.load(tmp_path / "checkpoint.pt", weights_only=True)
    assert not fresh.updater.optimizer.state_dict()["state"]


def test_numpy_policy_equals_torch(references: ReferenceSet, tmp_path: Path) -> None:
    t = trainer(references, tmp_path)
    for _ in range(2):
        t.iterate()
    with torch.no_grad():
        t.averaged[-1].weight.mul_(100.0)
    t.save(tmp_path / "checkpoint.pt")
    path = export_weights(tmp_path / "checkpoint.pt", tmp_path / "ppo.safetensors", {})
    tracker = LearnedTracker(t.env.ratio, path)
    tensors = load_file(str(path))
    network = ActorCritic(t.env.observation_size, t.env.hinges)
    with torch.no_grad():
        for i, layer in enumerate(m for m in network.actor if isinstance(m, torch.nn.Linear)):
            layer.weight.copy_(torch.from_numpy(tensors[f"w{i}"].astype(np.float32)))
            layer.bias.copy_(torch.from_numpy(tensors[f"b{i}"].astype(np.float32)))
        observation = t.env.observe()
        wanted = torch.clamp(network.actor(t.normalizer(torch.from_numpy(observation))), -1, 1).numpy()
    np.testing.assert_allclose(tracker.network(observation), wanted, atol=1e-5)
    assert np.abs(wanted).max() > 0.01
    character = SimulatedCharacter(build_scene(HUMANOID, load_scene("flat")), tracker)
    assert not character.step(3)["fallen"].any()


def test_service_and_training_see_the_same(references: ReferenceSet) -> None:
    env = TrackingEnv(HUMANOID, references, SMALL.model_copy(update={"envs": 1}), seed=0)
    env.start_at(np.array([0]))
    character = SimulatedCharacter(build_scene(HUMANOID, load_scene("flat")), PdStub())
    character.reference._ticks = character.reference._ticks.rows(np.zeros(60, dtype=np.int64))
    ticks = character.reference._ticks
    clip = slice(0, 60)
    ticks.pos_w_m[:] = references.pos_w_m[clip]
    ticks.linvel_w_mps[:] = references.linvel_w_mps[clip]
    ticks.qpos[:] = references.qpos[clip]
    columns = references.rot_xy[clip].astype(np.float64)
    from shared.motion.rotations import quat_from_matrix

    matrices = np.stack([columns[..., 0, :], columns[..., 1, :], np.cross(columns[..., 0, :], columns[..., 1, :])], -1)
    ticks.quat_w[:] = quat_from_matrix(matrices)
    character.reference._first_tick = 0
    character._data.qpos[:] = env.qpos[0]
    character._data.qvel[:] = env.qvel[0]
    seen = character.observe()
    from tracker_service.policy.observations import observe

    np.testing.assert_allclose(observe(policy_input([seen])), env.observe(), atol=2e-5)
    led = feedforward_targets(seen.ref_hinge_rad[:1], seen.ref_hinge_rad[1:2], 30.0, env.ratio)
    np.testing.assert_allclose(led, env.targets(np.zeros((1, 40), np.float32)), atol=1e-5)


class PdStub:
    """A tracker that is never asked."""

    def reset(self, character_ids: object) -> None:
        """Nothing to forget."""


def test_exploded_states_are_dropped_and_begun_anew(references: ReferenceSet) -> None:
    env = TrackingEnv(HUMANOID, references, SMALL, seed=0)
    env.reset_all()
    env.state[2, env.first_v] = 1e9
    result = env.step(np.zeros((6, 40), np.float32))
    assert result.exploded.tolist() == [False, False, True, False, False, False]
    assert np.isfinite(result.observation).all()
    assert np.isfinite(env.state).all()
    assert not (result.terminated | result.truncated)[2]


def test_some_episodes_begin_on_the_clip_and_none_in_the_floor(references: ReferenceSet) -> None:
    env = TrackingEnv(HUMANOID, references, SMALL.model_copy(update={"envs": 200}), seed=2)
    env.reset_all()
    frames = references.start[env.clip] + env.time
    off = np.abs(env.qpos[:, 7:] - references.qpos[frames, 7:]).mean(axis=1)
    assert off.min() < 0.01 and 0.05 < off.max() < 0.12
    lowest = env.bodies().pos_w_m[..., 2].min(axis=1)
    assert (lowest > references.pos_w_m[frames, :, 2].min(axis=1) - 1e-6).all()
    env.close()


def test_episodes_end_before_the_preview_runs_over_the_clip(references: ReferenceSet) -> None:
    env = TrackingEnv(HUMANOID, references, SMALL, seed=0)
    env.reset_all()
    truncated = 0
    for _ in range(60):
        result = env.step(np.zeros((6, 40), np.float32))
        assert (env.time + 5 <= env.references.length[env.clip]).all()
        assert result.final_observation.shape == result.observation.shape
        assert not (result.truncated & result.terminated).any()
        truncated += int(result.truncated.sum())
    assert truncated > 0


def test_reward_is_highest_on_the_clip_that_was_asked_for(references: ReferenceSet) -> None:
    pos, rot = references.pos_w_m[:5], references.rot_xy[:5]
    assert rewards.position_reward(pos, pos) == pytest.approx(0.5)
    assert rewards.rotation_reward(rot, rot) == pytest.approx(1.0, abs=2e-3)
    moved = pos + np.float32([0.1, 0, 0])
    assert rewards.position_reward(moved, pos) == pytest.approx(0.4 * np.exp(-1.0) + 0.1 * np.exp(-0.1), rel=1e-4)
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]], np.float32)
    assert rewards.rotation_reward(rot @ turn.T, rot) == pytest.approx(np.exp(-10 * angle**2), rel=2e-3)
    assert rewards.velocity_reward(pos + np.float32([1, 0, 0]), pos) == pytest.approx(np.exp(-1.0), rel=1e-4)


def test_the_environments_reward_is_of_its_own_clip_at_its_own_tick() -> None:
    """Two clips that differ: who moves as clip a is rewarded on a and not on b; likewise the other way round."""
    pair = prepare(HUMANOID, [swaying("a"), MotionInput("b", "wave", 1.0, swaying("b").positions_w_m + [0.3, 0, 0])])
    env = TrackingEnv(HUMANOID, pair, SMALL.model_copy(update={"envs": 4}), seed=0)
    env.start_at(np.array([0, 1, 0, 1]))
    bodies = pair.start[np.array([0, 1, 1, 0])]  # the last two stand where the other clip begins
    env._set(np.arange(4), pair.qpos[bodies], pair.qvel[bodies])
    distance, reward, exploded = env.advance(np.zeros((4, env.hinges), np.float32))
    assert not exploded.any()
    assert reward[:2].min() > 0.9
    assert (reward[2:] < reward[:2] - 0.4).all()
    np.testing.assert_allclose(distance[2:].mean(axis=-1), 0.3, atol=0.02)
    # Clips are apart in the flat arrays: the reference never runs from one into the next.
    env.time[:] = 10_000
    assert (env._frames(0) == pair.start[env.clip] + pair.length[env.clip] - 1).all()
    env.close()


def test_threads_share_the_work_and_change_nothing(references: ReferenceSet) -> None:
    one, three = (TrackingEnv(HUMANOID, references, SMALL.model_copy(update={"threads": n}), seed=4) for n in (1, 3))
    np.testing.assert_allclose(one.reset_all(), three.reset_all(), atol=1e-6)
    action = np.zeros((SMALL.envs, one.hinges), np.float32)
    for _ in range(5):
        a, b = one.step(action), three.step(action)
        np.testing.assert_allclose(a.observation, b.observation, atol=1e-6)
        np.testing.assert_allclose(a.reward, b.reward, atol=1e-6)
    one.close()
    three.close()


def test_references_made_by_several_processes_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tracker_service.training.dataset.JOB_CLIPS", 2)
    standing = standing_clip(40, 30.0).positions_w_m
    motions = [MotionInput(f"{n}", "stand", 1.0, standing[n:]) for n in range(5)]
    one, many = prepare(HUMANOID, motions), prepare(HUMANOID, motions, jobs=2)
    for field in fields(ReferenceSet):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(many, field.name))


def test_evaluation_of_standing_still(references: ReferenceSet) -> None:
    result = evaluate(SMALL, references, HUMANOID, lambda o: np.zeros((len(o), 40), np.float32))
    assert result["clips"] == 2
    assert result["success"] == 1.0
    assert 0 < result["mpjpe_mm"] < 60
    assert result["by_behaviour"]["stand"]["clips"] == 2
    assert result["by_group"] == {"common": result["by_behaviour"]["stand"]}
    low, high = result["ci95"]
    assert low <= result["success"] <= high and high - low > 0.3  # two clips say little
    one = evaluate(SMALL, references, HUMANOID, lambda o: np.zeros((len(o), 40), np.float32), which=np.array([1]))
    assert [row["name"] for row in one["per_clip"]] == ["b"]


def test_prepared_references_are_cached(tmp_path: Path) -> None:
    made = prepare_cached(HUMANOID, [swaying("a")], tmp_path)
    again = prepare_cached(HUMANOID, [swaying("a")], tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    np.testing.assert_array_equal(made.qpos, again.qpos)
    np.testing.assert_allclose(made.pos_w_m, swaying("a").positions_w_m, atol=5e-3)


def test_normalizer_equals_numpy_over_batches() -> None:
    rng = np.random.default_rng(0)
    data = (rng.normal(size=(500, 3)) * [1, 5, 0.2] + [0, 3, -1]).astype(np.float32)
    normalizer = Normalizer(3)
    for part in np.array_split(data, 7):
        normalizer.update(part)
    np.testing.assert_allclose(normalizer.mean.numpy(), data.mean(0), atol=1e-4)
    np.testing.assert_allclose(normalizer.var.numpy(), data.var(0), rtol=1e-3)


def test_bfloat16_layers_stay_close() -> None:
    torch.manual_seed(0)
    network = ActorCritic(20, 4)
    x = torch.randn(64, 20)
    exact, mixed = run_mixed(network.actor, x, False), run_mixed(network.actor, x, True)
    assert float((exact - mixed).detach().abs().max()) < 1e-3


def test_a_bank_of_plans_joins_the_corpus_with_its_share(references: ReferenceSet, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="no pieces"):
        load_bank(tmp_path)
    for name, frames in (("x", 50), ("y", 100)):
        np.savez(tmp_path / f"{name}.npz", positions_w_m=swaying(name, frames).positions_w_m.astype(np.float32))
    bank = prepare(HUMANOID, load_bank(tmp_path))
    both = concatenated(references, bank, 0.4)
    assert [str(n) for n in both.names] == ["a", "b", "x@0", "y@0"]
    np.testing.assert_allclose(both.weight, [0.3, 0.3, 0.4 / 3, 0.8 / 3])
    last = slice(both.start[3], both.start[3] + both.length[3])
    np.testing.assert_array_equal(both.qpos[last], bank.qpos[bank.start[1] : bank.start[1] + 100])
    assert both.start[3] + both.length[3] == len(both.qpos)


def test_long_pieces_of_a_bank_are_cut_with_an_overlap(tmp_path: Path) -> None:
    whole = np.zeros((500, 22, 3), np.float32) + np.arange(500, dtype=np.float32)[:, None, None]
    np.savez(tmp_path / "long.npz", positions_w_m=whole)
    cuts = [(m.name, m.positions_w_m[0, 0, 0], len(m.positions_w_m)) for m in load_bank(tmp_path)]
    assert cuts == [("long@0", 0, 180), ("long@120", 120, 180), ("long@240", 240, 180), ("long@360", 360, 140)]


def test_plans_are_cut_where_they_jump_to_the_body(tmp_path: Path) -> None:
    way = np.zeros((200, 3))
    way[:, 0] = np.arange(200) * 0.05  # 1.5 m/s
    assert smooth_stretches(way) == [(0, 200)]
    way[80:, 1] += 0.1
    (first, end), (second, last) = smooth_stretches(way)
    assert (first, last) == (0, 200) and 77 <= end <= 80 <= second <= 83
    way[90:] += 0.2  # too soon after the first: what lies between is too short to follow
    assert [b - a for a, b in smooth_stretches(way)] == [end, 200 - smooth_stretches(way)[1][0]]
    positions = np.repeat(standing_clip(2, 30.0).positions_w_m[:1], 200, axis=0) + way[:, None]
    np.savez(tmp_path / "plan.npz", positions_w_m=positions)
    pieces = load_bank(tmp_path)
    assert len(pieces) == 2 and sum(len(p.positions_w_m) for p in pieces) < 190


def test_the_averaged_policy_lags_behind_and_survives_a_restart(references: ReferenceSet, tmp_path: Path) -> None:
    run = trainer(references, tmp_path / "a")
    run.iterate()
    first = [p.clone() for p in run.network.actor.parameters()]
    assert all(torch.equal(a, b) for a, b in zip(run.averaged.parameters(), first, strict=True))
    run.iterate()
    for mean, old, new in zip(run.averaged.parameters(), first, run.network.actor.parameters(), strict=True):
        torch.testing.assert_close(mean, (old + new) / 2)
    run.save(tmp_path / "checkpoint.pt")
    again = trainer(references, tmp_path / "b")
    again.load(tmp_path / "checkpoint.pt")
    assert all(torch.equal(a, b) for a, b in zip(run.averaged.parameters(), again.averaged.parameters(), strict=True))


def test_the_largest_change_of_a_clip_is_not_seen_across_its_ends(references: ReferenceSet) -> None:
    qpos = references.qpos.copy()
    qpos[references.start[1] :, 7:] += 5.0  # between the clips: no jump of either
    qpos[references.start[1] + 10 :, 9] += 2.0
    a, b = largest_change_rad(replace(references, qpos=qpos))
    assert a < 0.1
    assert b == pytest.approx(2.0, abs=0.1)
