"""Learning through the world model: one definition in simulation and imagination, updates that learn, exact resume."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from shared.errors import InvalidInputError
from shared.motion.ik import standing_clip
from shared.scenes.files import load_scene
from tracker_service.policy.learned import LearnedTracker
from tracker_service.simulation.character import SimulatedCharacter
from tracker_service.simulation.character_spec import character
from tracker_service.simulation.humanoid import humanoid
from tracker_service.simulation.scene import build_scene
from tracker_service.training.dataset import MotionInput, ReferenceSet, prepare
from tracker_service.training.env import TrackingEnv
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.sampling import FailureTable, kin_of
from tracker_service.training.seats import HEIGHTS
from tracker_service.training.world.body import Bodies, State, tensor
from tracker_service.training.world.learner import Learner
from tracker_service.training.world.quality import drift_mm, response_cosine
from tracker_service.training.world.replay import Replay
from tracker_service.training.world.settings import WorldSettings
from tracker_service.training.world.sight import observe, servo_targets, still_tracked, tick_reward, trembling
from tracker_service.training.world.trainer import WorldTrainer
from tracker_service.training.world.weights import export_learner, training_file, warm_start

HUMAN = humanoid(character("human"))
SMALL = EnvSettings(envs=6)
TINY = WorldSettings(
    hidden=(16, 16), model_hidden=(32,), buffer_ticks=60, model_batch=16, model_ticks=2, critic_batch=32,
    critic_ticks=3, policy_batch=16, horizon=3, recent_ticks=50, bf16=False, compiled=False,
)  # fmt: skip


def swaying(name: str, frames: int = 75) -> MotionInput:
    positions = standing_clip(frames, 30.0).positions_w_m.copy()
    positions[:, :, 1] += 0.02 * np.sin(np.arange(frames) / 10.0)[:, None] * positions[:, :, 2]
    return MotionInput(name, "stand", 1.0, positions)


@pytest.fixture(scope="module")
def references() -> ReferenceSet:
    return prepare(HUMAN, [swaying("a"), swaying("b", 90)])


@pytest.fixture(autouse=True)
def short_start(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"FIRST_ROWS": 40, "FIRST_MODEL_UPDATES": 4, "FIRST_CRITIC_UPDATES": 4}
    for name, value in names.items():
        monkeypatch.setattr(f"tracker_service.training.world.trainer.{name}", value)


def trainer(references: ReferenceSet, out: Path, settings: WorldSettings = TINY, seed: int = 3) -> WorldTrainer:
    return WorldTrainer(HUMAN, references, references, out, SMALL, settings, seed)


def test_trembling_counts_where_the_reference_stands_still() -> None:
    still = torch.zeros(2, 22, 3)
    before, after = (Bodies(still, torch.zeros(2, 22, 3, 3), still + speed) for speed in (0.0, 0.1))
    walking = still.clone()
    walking[1, :, 0] = 1.0
    shaken = trembling(before, after, walking)
    assert shaken[0] == pytest.approx(3 * (0.1 * 30) ** 2)  # 0.1 m/s along each axis within a tick
    assert shaken[1] < 1e-5
    assert trembling(before, before, walking).abs().max() == 0


def test_simulation_and_imagination_see_want_and_judge_the_same(references: ReferenceSet, tmp_path: Path) -> None:
    env = TrackingEnv(HUMAN, references, SMALL, seed=0)
    seen = env.reset_all()
    env.jump_m[:] = np.random.default_rng(0).normal(size=env.jump_m.shape) * 0.05
    seen = env.observe()
    learner = Learner(HUMAN, references, SMALL, TINY, env.observation_size, 0)
    state = State.of(tensor(env.qpos), tensor(env.qvel))
    clip, time, jump = torch.from_numpy(env.clip), torch.from_numpy(env.time), tensor(env.jump_m)
    ref = learner.references.at(clip, time, jump, SMALL.jump_decay)
    bodies = learner.kinematics(state)
    np.testing.assert_allclose(observe(state, bodies, ref, torch.zeros(6, 0)), seen, atol=1e-5)
    action = np.random.default_rng(1).normal(size=(6, env.hinges)).astype(np.float32)
    lead = tensor(env.ratio * 30.0)
    limits = tensor(HUMAN.hinges.lower), tensor(HUMAN.hinges.upper)
    wanted = servo_targets(torch.from_numpy(action), ref, lead, SMALL.action_scale_rad, limits)
    np.testing.assert_allclose(wanted, env.targets(action), atol=1e-6)
    before = env.previous_action.copy()
    distance, reward, _ = env.advance(action)
    after = State.of(tensor(env.qpos), tensor(env.qvel))
    got, far = tick_reward(after, learner.kinematics(after), ref)
    cost = 0.02 * np.mean((np.clip(action, -1, 1) - before) ** 2, axis=-1)
    np.testing.assert_allclose(got.numpy() - cost, reward, atol=1e-4)
    np.testing.assert_allclose(far, distance, atol=1e-4)
    stretched = far * torch.tensor([1.0, 1.0, 1.0, 20.0, 20.0, 20.0])[:, None]
    expected = env.failed(stretched.numpy())
    assert expected.any() and not expected.all()
    assert np.array_equal(
        ~still_tracked(stretched, SMALL.stop_mean_m, SMALL.stop_max_m, torch.ones(6)).numpy(), expected
    )
    env.close()


def test_the_model_learns_what_the_simulator_does(references: ReferenceSet, tmp_path: Path) -> None:
    t = trainer(references, tmp_path, TINY.model_copy(update={"model_rate": 3e-3, "model_batch": 64}))
    t.prepare(lambda line: None, fresh_sight=True, fresh_model=True)
    losses = [t.learner.update_model(t.replay, t.rng).get("model_loss", np.nan) for _ in range(150)]
    assert np.nanmean(losses[-20:]) < 0.8 * np.nanmean(losses[:20])


def test_the_models_quality_is_measured_against_the_simulator(references: ReferenceSet, tmp_path: Path) -> None:
    t = trainer(references, tmp_path, TINY.model_copy(update={"model_rate": 3e-3, "model_batch": 64}))
    t.prepare(lambda line: None, fresh_sight=True, fresh_model=True)
    before = drift_mm(t.learner, t.replay, np.random.default_rng(0), 64)
    blind = response_cosine(t.learner, t.env, t.replay, np.random.default_rng(0))
    for _ in range(300):
        t.learner.update_model(t.replay, t.rng)
    after = drift_mm(t.learner, t.replay, np.random.default_rng(0), 64)
    seeing = response_cosine(t.learner, t.env, t.replay, np.random.default_rng(0))
    assert after["drift_mm_1"] < before["drift_mm_1"] < before["drift_mm_16"]
    assert seeing["response_cosine_1"] > max(blind["response_cosine_1"], 0.2)


def test_the_critic_explains_returns(references: ReferenceSet, tmp_path: Path) -> None:
    t = trainer(references, tmp_path)
    t.prepare(lambda line: None, fresh_sight=True, fresh_model=True)
    losses = [t.learner.update_critic(t.replay, t.rng)["critic_loss"] for _ in range(200)]
    assert np.mean(losses[-20:]) < 0.5 * np.mean(losses[:20])


def test_updates_are_done_where_the_networks_are(references: ReferenceSet, monkeypatch: pytest.MonkeyPatch) -> None:
    # Meta tensors stand for a graphics card's: an operation that meets one of the processor's fails.
    for name in ("__float__", "item"):
        monkeypatch.setattr(torch.Tensor, name, lambda self: 0.5)
    env = TrackingEnv(HUMAN, references, SMALL.model_copy(update={"heights": True}), seed=0)
    env.reset_all()
    learner = Learner(HUMAN, references, env.settings, TINY, env.observation_size, HEIGHTS, "meta")
    ring = Replay(TINY.buffer_ticks, SMALL.envs, env.observation_size, env.hinges, "meta")
    for _ in range(TINY.buffer_ticks):
        ring.put(clip=env.clip, time=env.time, cut=np.zeros(SMALL.envs, bool))
        ring.forward()
    rng = np.random.default_rng(0)
    learner.take_normalisation(ring, rng, True, True)
    facts = learner.update_model(ring, rng) | learner.update_critic(ring, rng) | learner.update_policy(ring, rng)
    assert {"model_loss", "critic_loss", "imagined_worth"} <= set(facts)


def test_resume_is_exact(references: ReferenceSet, tmp_path: Path) -> None:
    whole = trainer(references, tmp_path / "a")
    whole.prepare(lambda line: None, fresh_sight=True, fresh_model=True)
    whole.iterate()
    whole.save(tmp_path / "a" / "checkpoint.pt")
    expected = [whole.iterate() for _ in range(3)]
    resumed = trainer(references, tmp_path / "b", seed=8)
    resumed.load(tmp_path / "a" / "checkpoint.pt")
    assert resumed.ready
    got = [resumed.iterate() for _ in range(3)]
    for one, other in zip(expected, got, strict=True):
        assert {k: v for k, v in one.items() if not k.endswith("_s")} == {
            k: v for k, v in other.items() if not k.endswith("_s")
        }
    for a, b in zip(whole.learner.averaged.parameters(), resumed.learner.averaged.parameters(), strict=True):
        assert torch.equal(a, b)
    (tmp_path / "a" / "replay.npz").unlink()
    said: list[str] = []
    elsewhere = trainer(references, tmp_path / "c")
    elsewhere.load(tmp_path / "a" / "checkpoint.pt", said.append)
    assert not elsewhere.ready and any("filled anew" in line for line in said)


def test_exported_weights_start_a_learner(references: ReferenceSet, tmp_path: Path) -> None:
    t = trainer(references, tmp_path)
    t.prepare(lambda line: None, fresh_sight=True, fresh_model=True)
    t.iterate()
    path = export_learner(t.learner, tmp_path / "learned.safetensors", {"samples": t.samples})
    fresh = Learner(HUMAN, references, SMALL, TINY, t.env.observation_size, 0)
    assert warm_start(fresh, path)
    np.testing.assert_allclose(
        fresh.act(t.observation, averaged=True), t.learner.act(t.observation, averaged=True), atol=2e-3
    )
    torch.testing.assert_close(fresh.model.scale, t.learner.model.scale)
    wider = Learner(HUMAN, references, SMALL, TINY, t.env.observation_size + 5, 5)
    assert warm_start(wider, path)
    more = np.concatenate([t.observation, np.full((6, 5), 0.3, np.float32)], axis=1)
    np.testing.assert_allclose(wider.act(more, averaged=True), fresh.act(t.observation, averaged=True), atol=1e-5)
    training_file(path).unlink()
    assert not warm_start(fresh, path)
    size = t.env.observation_size
    larger = TINY.model_copy(update={"hidden": (24, 20), "model_hidden": (48,)})
    grown = Learner(HUMAN, references, SMALL, larger, size, 0)
    assert warm_start(grown, export_learner(t.learner, path, {}))
    np.testing.assert_allclose(grown.act(t.observation), t.learner.act(t.observation, averaged=True), atol=2e-3)
    x = torch.randn(5, len(t.learner.model.mean))
    torch.testing.assert_close(grown.model.net(x), t.learner.model.net(x), atol=5e-3, rtol=0)
    smaller = Learner(HUMAN, references, SMALL, TINY.model_copy(update={"hidden": (8, 8)}), size, 0)
    with pytest.raises(InvalidInputError, match="too large"):
        warm_start(smaller, path)


def test_the_service_acts_as_training_does_on_a_seat_too(references: ReferenceSet, tmp_path: Path) -> None:
    settings = SMALL.model_copy(update={"heights": True})
    t = WorldTrainer(HUMAN, references, references, tmp_path, settings, TINY, seed=3)
    t.prepare(lambda line: None, fresh_sight=True, fresh_model=True)
    with torch.no_grad():
        t.learner.averaged[-1].weight.mul_(100.0)
    path = export_learner(t.learner, tmp_path / "learned.safetensors", {})
    tracker = LearnedTracker(t.env.ratio, path)
    seen = t.env.observe()
    seen[:, -1] = 0.4
    wanted = np.clip(t.learner.act(seen, averaged=True), -1, 1)
    np.testing.assert_allclose(tracker.network(seen), wanted, atol=5e-3)
    assert np.abs(wanted).max() > 0.01
    body = SimulatedCharacter(build_scene(HUMAN, load_scene("flat")), tracker)
    assert not body.step(3)["fallen"].any()


def test_windows_never_cross_a_cut_and_failures_are_not_bootstrapped() -> None:
    ring = Replay(capacity=20, envs=1, observation=1, hinges=1)
    rng = np.random.default_rng(0)
    for tick in range(18):
        ring.observation[ring.head], ring.reward[ring.head] = tick, 1.0
        ring.cut[ring.head] = tick in (7, 12)
        ring.terminated[ring.head] = tick == 7
        ring.forward()
    slots = ring.draw(rng, 400, 3).slot
    assert set(slots.tolist()) == {0, 1, 2, 3, 4, 8, 9, 13, 14}
    places, total, after, factor = ring.returns(rng, 400, 3, 0.5)
    facts = {
        int(s): (float(t), int(a), float(f)) for s, t, a, f in zip(places.slot, total, after.slot, factor, strict=True)
    }
    assert facts[0] == (0.5 + 0.25 + 0.125, 3, 0.125)
    assert facts[6][0] == 0.5 + 0.25 and facts[6][2] == 0.0  # fails in its second tick
    assert facts[11] == (0.5, 12, 0.5)  # cut short at 12: the value there stands for the rest


def test_bodies_on_the_floor_may_be_farther_from_their_way(references: ReferenceSet) -> None:
    floor = replace(references, behaviours=np.array(["get_up", "stand"]))
    env = TrackingEnv(HUMAN, floor, SMALL, seed=0)
    env.start_at(np.array([0, 1, 0, 1, 0, 1]))
    distance = np.full((6, len(HUMAN.skeleton)), 0.4, np.float32)
    distance[4:] = 0.6
    assert env.failed(distance).tolist() == [False, True, False, True, True, True]
    learner = Learner(HUMAN, floor, SMALL, TINY, env.observation_size, 0)
    slack = learner.references.slack[torch.from_numpy(env.clip)]
    going = still_tracked(torch.from_numpy(distance), SMALL.stop_mean_m, SMALL.stop_max_m, slack)
    assert going.tolist() == [True, False, True, False, False, False]
    env.close()


def test_clips_that_were_not_met_yet_are_judged_by_their_kin() -> None:
    names = ["made/train/kick_at/1", "made/train/kick_at/2", "cmu/1", "cmu/2"]
    kin = kin_of(["kick", "kick", "walk", "walk"], names)
    assert kin[0] == kin[1] != kin[2] == kin[3]
    table = FailureTable(np.full(4, 120), np.full(4, 0.25), floor=0.15, tail_ticks=10, kin=kin)
    for _ in range(300):
        table.note(0, 0, 40, failed=True)
        table.note(2, 0, 115, failed=False)
    f = table.estimate().reshape(4, 4)
    assert f[1, 1] > 0.9 and f[3, 1] < 0.1  # their kin fail there, and pass there
    assert f[1, 2] == 0.5  # nobody came that far
    for _ in range(40):
        table.note(1, 0, 115, failed=False)
    assert table.estimate().reshape(4, 4)[1, 1] < 0.3  # what a clip does itself counts more in the end


def test_failures_are_met_again_where_they_happen() -> None:
    table = FailureTable(np.array([120, 90]), np.array([0.5, 0.5]), floor=0.15, tail_ticks=10)
    for _ in range(40):
        table.note(0, 0, 70, failed=True)
        table.note(1, 0, 85, failed=False)
    assert table.rate[2] > 0.9 and table.rate[1] > 0.9 and table.rate[0] < 0.1
    assert table.rate[3] == 0.5  # never reached
    assert (table.rate[4:7] < 0.1).all()
    np.testing.assert_allclose(table.by_clip(), [np.mean(table.rate[:4]), np.mean(table.rate[4:])])
    for tick in range(40):
        table.note(0, 0, 70 if tick % 2 else 115, failed=tick % 2 == 1)
    clips, ticks = table.draw(np.random.default_rng(0), 4000)
    assert (clips == 0).mean() > 0.7  # sometimes failing beats never failing
    assert ((ticks >= 0) & (ticks < np.where(clips == 0, 110, 80))).all()


def test_environments_in_processes_resume_exactly(references: ReferenceSet, tmp_path: Path) -> None:
    many = SMALL.model_copy(update={"processes": 2})

    def made(out: Path) -> WorldTrainer:
        return WorldTrainer(HUMAN, references, references, out, many, TINY, 3)

    whole = made(tmp_path / "a")
    whole.prepare(print, fresh_sight=True, fresh_model=True)
    whole.iterate()
    whole.save(tmp_path / "checkpoint.pt")
    wanted = [whole.iterate() for _ in range(3)]
    rest = made(tmp_path / "b")
    rest.load(tmp_path / "checkpoint.pt")
    again = [rest.iterate() for _ in range(3)]
    for one, other in zip(wanted, again, strict=True):
        assert {k: v for k, v in one.items() if not k.endswith("_s")} == {
            k: v for k, v in other.items() if not k.endswith("_s")
        }
    np.testing.assert_array_equal(whole.env.state, rest.env.state)
    assert whole.env.time.any() and not np.array_equal(whole.env.state[0], whole.env.state[-1])
    for trainer in (whole, rest):
        trainer.env.close()
