"""Many humanoids that follow reference clips, stepped together by `mujoco.rollout`.

An episode starts on a clip's own state (reference-state initialisation) and ends when the body is too far from the
reference (termination), or by time or the clip's end (truncation, which is not termination). It ends early enough that
the preview never runs over the clip's last tick.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco import rollout

from shared.protocol.rates import PHYSICS_HZ, TICK_HZ
from tracker_service.policy.observations import (
    PREVIEW_TICKS,
    PolicyInput,
    feedforward_targets,
    observation_size,
    observe,
)
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.simulation.kinematics import BodyKinematics, BodyStates
from tracker_service.training import rewards
from tracker_service.training.bags import BAG_DOFS, latest_starts
from tracker_service.training.dataset import ReferenceSet
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.knocks import Knocks
from tracker_service.training.sampling import FailureTable, kin_of
from tracker_service.training.seats import CONTROL_SPEC, HEIGHTS, height_points, mocap_of, seat_heights, training_model

F32 = npt.NDArray[np.float32]
Ints = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

SUBSTEPS = PHYSICS_HZ // TICK_HZ
_FULL = mujoco.mjtState.mjSTATE_FULLPHYSICS
KNOCKED = ("wrist", "elbow", "foot", "knee")
_TAIL_TICKS = max(PREVIEW_TICKS) + 1


FLOOR_SLACK = 2.0
FLOOR_BEHAVIOURS = ("get_up", "lie_down")


def slack_of(behaviours: npt.NDArray[np.str_]) -> npt.NDArray[np.float32]:
    """(C,) factor on the distances that end an episode: a body on the floor may get up otherwise than it was shown."""
    return np.where(np.isin(behaviours, FLOOR_BEHAVIOURS), FLOOR_SLACK, 1.0).astype(np.float32)


@dataclass(frozen=True)
class StepResult:
    """What a step gives. B environments.

    Attributes:
        observation: (B, D) after the step, of the new episode where one began.
        reward: (B,). terminated, truncated, exploded: (B,) how episodes ended.
        final_observation: (B, D) right after the tick, before new episodes and disturbances.
        error_m: (B,) mean joint distance.
        disturbed: rows of the environments in which the next tick does not follow from what is observed: they were
            pushed, or are at a bag, which nobody sees.
    """

    observation: F32
    reward: F32
    terminated: Bools
    truncated: Bools
    exploded: Bools
    final_observation: F32
    error_m: F32
    disturbed: Ints


class TrackingEnv:
    """See the module's docstring."""

    def __init__(self, human: Humanoid, references: ReferenceSet, settings: EnvSettings, seed: int):
        self.settings = settings
        self.human = human
        self.references = references
        self.model = training_model(human)
        self.kinematics = BodyKinematics(human)
        threads = settings.threads
        self._rollout = rollout.Rollout(nthread=threads if threads > 1 else 0)
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        b, h = settings.envs, len(human.hinges)
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        edges = np.linspace(0, b, threads + 1).astype(int).tolist()
        self._shares = [slice(i, j) for i, j in zip(edges[:-1], edges[1:], strict=True) if j > i]
        self.rng = np.random.default_rng(seed)
        self.state = np.zeros((b, mujoco.mj_stateSize(self.model, _FULL)))
        self.clip = np.zeros(b, dtype=np.int64)
        self.time = np.zeros(b, dtype=np.int64)
        self.age = np.zeros(b, dtype=np.int64)
        self.jump_m = np.zeros((b, 2))
        self.previous_action = np.zeros((b, h), dtype=np.float32)
        self.begun = np.zeros(b, dtype=np.int64)
        kin = kin_of(references.behaviours.tolist(), references.names.tolist())
        self.failures = FailureTable(references.length, references.weight, settings.fail_floor, 2 * _TAIL_TICKS, kin)
        self._slack = slack_of(references.behaviours)
        self.ratio = human.damping / human.stiffness
        self.observation_size = observation_size(len(human.skeleton), h) + (HEIGHTS if settings.heights else 0)
        self._feet = (human.skeleton.index("left_foot"), human.skeleton.index("right_foot"))
        self.hinges = h
        self._nq, self._nv = 7 + h, 6 + h
        self.first_v = 1 + self.model.nq
        self._latest = latest_starts(references.pos_w_m, references.start, references.length, references.bag)
        self._bodies: BodyStates | None = None
        self._knocks = Knocks(self.model)
        self._limbs = [self.model.body(f"{side}_{part}").id for side in ("left", "right") for part in KNOCKED]

    def close(self) -> None:
        """Stop the threads."""
        self._rollout.close()
        if self._pool is not None:
            self._pool.shutdown()

    def _shared(self, work: Callable[[slice], tuple[npt.NDArray[Any], ...]]) -> tuple[npt.NDArray[Any], ...]:
        """What `work` gives for all environments, done by all threads, joined along the first axis."""
        if self._pool is None:
            return work(slice(None))
        return tuple(np.concatenate(parts) for parts in zip(*self._pool.map(work, self._shares), strict=True))

    def reset_all(self) -> F32:
        """Begin a new episode everywhere; first observations (B, D)."""
        everyone = np.arange(self.settings.envs)
        self._begin(everyone)
        self.age[:] = self.rng.integers(0, self.settings.episode_ticks, len(everyone))
        return self.observe()

    def start_at(self, clips: Ints) -> F32:
        """Put environment i at the start of clips[i], without noise (evaluation); first observations."""
        self.clip[:] = clips
        self.time[:] = 0
        self.begun[:] = 0
        self.age[:] = 0
        self.jump_m[:] = 0
        self.previous_action[:] = 0
        frames = self.references.start[clips]
        self._set(np.arange(len(clips)), self.references.qpos[frames], self.references.qvel[frames])
        return self.observe()

    def _begin(self, rows: Ints) -> None:
        rng, s, n = self.rng, self.settings, len(rows)
        clips, times = self.failures.draw(rng, n)
        times = np.minimum(times, self._latest[clips])  # none begins in the bag
        self.clip[rows], self.time[rows], self.begun[rows], self.age[rows] = clips, times, times, 0
        self.jump_m[rows] = 0
        self.previous_action[rows] = 0
        frames = self.references.start[clips] + times
        qpos = self.references.qpos[frames].astype(np.float64)
        qvel = self.references.qvel[frames].astype(np.float64)
        far = rng.random((n, 1)) * s.noise_most
        qpos[:, 7:] += rng.normal(size=(n, self.hinges)) * s.noise_hinge_rad * far
        qpos[:, :2] += rng.normal(size=(n, 2)) * s.noise_root_m * far
        qpos[:, 3:7] += rng.normal(size=(n, 4)) * 0.01 * far
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=-1, keepdims=True)
        qvel += rng.normal(size=qvel.shape) * s.noise_rate * far
        # None of them begins deeper in the floor than its clip: the contact would throw it up.
        low = self.references.pos_w_m[frames, :, 2].min(axis=1) - self.kinematics.poses(qpos)[0][..., 2].min(axis=1)
        qpos[:, 2] += np.maximum(low, 0.0)
        self._set(rows, qpos, qvel)

    def _set(self, rows: Ints, qpos: npt.NDArray[np.floating], qvel: npt.NDArray[np.floating]) -> None:
        self.state[rows] = 0.0
        self.state[rows, 1 : 1 + self._nq] = qpos
        self.state[rows, 1 + self._nq : self.first_v] = self.references.bag[self.clip[rows], -BAG_DOFS:]
        self.state[rows, self.first_v : self.first_v + self._nv] = qvel
        self._refresh(rows)

    def _refresh(self, rows: Ints) -> None:
        """Body states of a few environments anew, after their generalised coordinates were changed."""
        if self._bodies is None or len(rows) == 0:
            return
        fresh = self.kinematics.states(self.qpos[rows], self.qvel[rows])
        self._bodies.pos_w_m[rows], self._bodies.rot_w[rows] = fresh.pos_w_m, fresh.rot_w
        self._bodies.linvel_w_mps[rows] = fresh.linvel_w_mps
        self._bodies.angvel_w_radps[rows] = fresh.angvel_w_radps

    def moved(self) -> None:
        """Tell that `state` was changed from outside."""
        self._bodies = None

    @property
    def qpos(self) -> npt.NDArray[np.float64]:
        """(B, 7+H)."""
        return np.asarray(self.state[:, 1 : 1 + self._nq])

    @property
    def qvel(self) -> npt.NDArray[np.float64]:
        """(B, 6+H)."""
        return np.asarray(self.state[:, self.first_v : self.first_v + self._nv])

    def bodies(self) -> BodyStates:
        """World states of all bodies now."""
        if self._bodies is None:
            qpos, qvel = self.qpos, self.qvel

            def states(rows: slice) -> tuple[npt.NDArray[Any], ...]:
                s = self.kinematics.states(qpos[rows], qvel[rows])
                return s.pos_w_m, s.rot_w, s.linvel_w_mps, s.angvel_w_radps

            self._bodies = BodyStates(*self._shared(states))
        return self._bodies

    def _frames(self, ahead: int, rows: Ints | slice = slice(None)) -> Ints:
        clip = self.clip[rows]
        last = self.references.length[clip] - 1
        return np.asarray(self.references.start[clip] + np.minimum(self.time[rows] + ahead, last))

    def observe(self, rows: Ints | None = None) -> F32:
        """(B, D) observations now, of some environments or all."""
        self.bodies()
        if rows is not None:
            return self._observe(rows)
        return np.asarray(self._shared(lambda share: (self._observe(share),))[0], dtype=np.float32)

    def _observe(self, rows: Ints | slice) -> F32:
        ref, bodies = self.references, self.bodies()
        near = self._frames(PREVIEW_TICKS[0], rows)
        ref_pos = np.stack([ref.pos_w_m[self._frames(k, rows)] for k in PREVIEW_TICKS], axis=1).astype(np.float64)
        jump = self.jump_m[rows]
        for k, ticks in enumerate(PREVIEW_TICKS):
            ref_pos[:, k, :, :2] += (jump * self.settings.jump_decay**ticks)[:, None]
        rot_xy = ref.rot_xy[near, 0].astype(np.float64)
        root_rot = np.stack([rot_xy[:, 0], rot_xy[:, 1], np.cross(rot_xy[:, 0], rot_xy[:, 1])], axis=-1)
        seen = observe(
            PolicyInput(
                pos_w_m=bodies.pos_w_m[rows],
                linvel_w_mps=bodies.linvel_w_mps[rows],
                root_rot_w=bodies.rot_w[rows, 0],
                root_angvel_w_radps=bodies.angvel_w_radps[rows, 0],
                hinge_rad=self.qpos[rows, 7:],
                hinge_vel_radps=self.qvel[rows, 6:],
                ref_pos_w_m=ref_pos,
                ref_linvel_w_mps=ref.linvel_w_mps[near].astype(np.float64),
                ref_root_rot_w=root_rot,
                ref_hinge_rad=np.stack([ref.qpos[self._frames(k, rows), 7:] for k in PREVIEW_TICKS], axis=1),
            )
        )
        if not self.settings.heights:
            return seen
        points = height_points(bodies.pos_w_m[rows], bodies.rot_w[rows, 0, :, 0], self._feet)
        heights = seat_heights(points, bodies.pos_w_m[rows, 0, 2], ref.seat[self.clip[rows]])
        return np.concatenate([seen, heights.astype(np.float32)], axis=-1)

    def targets(self, action: F32) -> npt.NDArray[np.float64]:
        """Servo targets (B, H) of clipped actions."""
        ref = self.references.qpos
        base = feedforward_targets(ref[self._frames(1), 7:], ref[self._frames(2), 7:], TICK_HZ, self.ratio)
        wanted = base + self.settings.action_scale_rad * np.clip(action, -1.0, 1.0)
        return np.asarray(np.clip(wanted, self.human.hinges.lower, self.human.hinges.upper), dtype=np.float64)

    def control(self, targets: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """(B, C) controls of `CONTROL_SPEC`: servo targets (B, H), then where seats and bags are."""
        ref = self.references
        return np.concatenate([targets, mocap_of(ref.seat[self.clip], ref.bag[self.clip])], axis=-1)

    def roll(
        self, state: npt.NDArray[np.float64], control: npt.NDArray[np.float64], spec: int
    ) -> npt.NDArray[np.float64]:
        """States (B, N, S) after each of N substeps from states (B, S), controls (B, N, C) of a `mjtState` spec."""
        states, _ = self._rollout.rollout(
            self.model, self._data, state, control, control_spec=spec, nstep=control.shape[1]
        )  # fmt: skip
        return np.asarray(states)

    def advance(self, action: F32) -> tuple[F32, F32, Bools]:
        """One tick of physics under actions (B, H), no resets.

        Returns:
            joint distances to the reference (B, J), reward (B,), and which environments exploded (B,); an exploded one
            keeps the state it had.
        """
        s = self.settings
        control = self.control(self.targets(action))
        new = self.roll(self.state, np.repeat(control[:, None], SUBSTEPS, axis=1), CONTROL_SPEC)[:, -1]
        speed = np.abs(new[:, self.first_v : self.first_v + 6])
        exploded = ~np.isfinite(new).all(axis=-1) | ~(speed.max(axis=-1) < s.exploded_mps)
        self.state = np.where(exploded[:, None], self.state, new)
        self._bodies = None
        self.time += 1
        self.age += 1
        self.jump_m *= s.jump_decay
        self.bodies()
        clipped = np.clip(action, -1.0, 1.0)
        distance, reward = self._shared(lambda rows: self._judged(rows, clipped))
        self.previous_action = clipped
        return distance, np.asarray(reward, dtype=np.float32), exploded

    def _judged(self, rows: slice, action: F32) -> tuple[F32, F32]:
        """Distances to the reference and reward of some environments that arrived under actions (B, H)."""
        bodies, ref, now = self.bodies(), self.references, self._frames(0, rows)
        pos = bodies.pos_w_m[rows].astype(np.float32)
        target = ref.pos_w_m[now].copy()
        target[..., :2] += self.jump_m[rows].astype(np.float32)[:, None]
        distance = np.linalg.norm(pos - target, axis=-1)
        rot_xy = bodies.rot_w[rows, ..., :2].swapaxes(-1, -2).astype(np.float32)
        reward = (
            rewards.position_reward(pos, target)
            + 0.3 * rewards.rotation_reward(rot_xy, ref.rot_xy[now])
            + 0.1 * rewards.velocity_reward(bodies.linvel_w_mps[rows].astype(np.float32), ref.linvel_w_mps[now])
            + 0.1 * rewards.hinge_rate_reward(self.qvel[rows, 6:].astype(np.float32), ref.qvel[now, 6:])
            - 0.02 * rewards.smoothness_cost(action[rows], self.previous_action[rows])
        )
        return distance, reward

    def failed(self, distance: F32) -> Bools:
        """(B,) whether joint distances (B, J) end an episode."""
        s, slack = self.settings, self._slack[self.clip]
        far = distance.max(axis=-1) > s.stop_max_m * slack
        return np.asarray((distance.mean(axis=-1) > s.stop_mean_m * slack) | far)

    def over(self) -> Bools:
        """(B,) whether an episode ends here by time or because its clip does."""
        late = self.time >= self.references.length[self.clip] - _TAIL_TICKS
        return np.asarray((self.age >= self.settings.episode_ticks) | late)

    def step(self, action: F32) -> StepResult:
        """One tick, then new episodes where one ended, then the disturbances."""
        distance, reward, exploded = self.advance(action)
        terminated = self.failed(distance) & ~exploded
        truncated = self.over() & ~terminated & ~exploded
        final = self.observe()
        rows = np.flatnonzero(terminated | truncated | exploded)
        for row, fail in zip(rows, (terminated | exploded)[rows], strict=True):
            self.failures.note(int(self.clip[row]), int(self.begun[row]), int(self.time[row]), bool(fail))
        if len(rows):
            self._begin(rows)
        disturbed = self._disturb()
        changed = np.union1d(rows, disturbed)
        held = np.flatnonzero((self.references.bag[self.clip, 2] >= 0) & (self.time >= self._latest[self.clip]))
        observation = final.copy()
        if len(changed):
            observation[changed] = self.observe(changed)
        error = np.asarray(distance.mean(axis=-1), dtype=np.float32)
        return StepResult(
            observation, reward, terminated, truncated, exploded, final, error, np.union1d(disturbed, held)
        )

    def _disturb(self) -> Ints:
        """Now and then push the root, or let the reference jump sideways; which environments."""
        s, b = self.settings, self.settings.envs
        pushed = np.flatnonzero(self.rng.random(b) < s.push_chance)
        knocked = np.flatnonzero(self.rng.random(b) < s.knock_chance)
        for row in knocked:
            body = int(self.rng.choice(self._limbs))
            way = self.rng.normal(size=3)
            impulse = way / np.linalg.norm(way) * self.rng.random() * s.knock_ns
            self.add_velocity(int(row), self._knocks.change(self.qpos[row], self.qvel[row], body, impulse))
        self._refresh(knocked)
        if len(pushed):
            self.state[pushed, self.first_v : self.first_v + 2] += self.rng.normal(size=(len(pushed), 2)) * s.push_mps
            self._refresh(pushed)
        jumped = np.flatnonzero(self.rng.random(b) < s.jump_chance)
        if len(jumped):
            self.jump_m[jumped] = self.rng.normal(size=(len(jumped), 2)) * s.jump_m
        return np.union1d(np.union1d(pushed, jumped), knocked)

    def add_velocity(self, row: int, change: npt.NDArray[np.float64]) -> None:
        """Add to the qvel of one environment, (V,); `moved` or `_refresh` is the caller's to call."""
        self.state[row, self.first_v : self.first_v + self._nv] += change
