"""One simulated character: a humanoid in its scene, its reference, its tracker, its clock.

Lockstep by nature: time passes only in `step`. The same calls give the same samples bit for bit.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError, SimulationError
from shared.plugins.interfaces import Tracker, TrackerObservation
from shared.protocol.rates import PLANNER_FPS, TICK_HZ
from tracker_service.simulation.fallen import FallDetector, floor_touch
from tracker_service.simulation.humanoid import FEET, PHYSICS_HZ
from tracker_service.simulation.reference import ReferenceBuffer
from tracker_service.simulation.scene import SceneModel

Array = npt.NDArray[np.float64]
Samples = dict[str, npt.NDArray[np.generic]]

SUBSTEPS = PHYSICS_HZ // TICK_HZ
PREVIEW_ROWS = 4
EXPLODED_MPS = 60.0
"""No body part moves this fast; physics that does has exploded."""

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class SimulatedCharacter:
    """A character that follows its reference.

    Samples are at 120 Hz: sample k is the state at exactly k / 120 s, tick t is sample 4 t.

    Args:
        scene: the compiled world.
        tracker: plug-in that gives servo targets, see shared.plugins.interfaces.
        character_id: handed to the tracker.
        xy_w_m, heading_rad: where it starts, standing.
    """

    def __init__(
        self,
        scene: SceneModel,
        tracker: Tracker,
        character_id: str = "character",
        xy_w_m: tuple[float, float] = (0.0, 0.0),
        heading_rad: float = 0.0,
    ):
        self.scene = scene
        self.human = scene.human
        self.character_id = character_id
        self.tracker = tracker
        self.tick = 0
        self._data = mujoco.MjData(scene.model)
        self._hinge_end = 7 + len(self.human.hinges)
        self._actions: tuple[int, Array] = (0, np.zeros((0, len(self.human.hinges))))
        self._feet = [scene.human.skeleton.index(name) for name in FEET]
        self.reset(xy_w_m, heading_rad)

    def reset(self, xy_w_m: tuple[float, float], heading_rad: float) -> None:
        """Stand at a place; objects return to theirs. The clock goes on from the next tick divisible by 3."""
        self.tick = -(-self.tick // 3) * 3
        model, data = self.scene.model, self._data
        mujoco.mj_resetData(model, data)
        self.reference = ReferenceBuffer(self.human, self.tick, xy_w_m, heading_rad)
        data.qpos[: self._hinge_end] = self.reference.at(self.tick).qpos[0]
        data.ctrl[:] = data.qpos[7 : self._hinge_end]
        self._actions = (0, np.zeros((0, len(self.human.hinges))))
        self._fall = FallDetector(self.scene)
        mujoco.mj_forward(model, data)
        self.tracker.reset([self.character_id])

    def set_tracker(self, tracker: Tracker) -> None:
        """Swap the tracker; it takes over at the next tick."""
        self.tracker = tracker
        tracker.reset([self.character_id])

    def set_reference(self, start_tick: int, positions_w_m: npt.NDArray[np.floating], fps: int = PLANNER_FPS) -> None:
        """Put a plan (T, 22, 3) in: frame i is at start_tick / 30 + (i + 1) / fps s.

        Rotations are not taken: they come from the positions by the same inverse kinematics everywhere (DESIGN 2).
        """
        self.reference = self.prepared_reference(start_tick, positions_w_m, fps)

    def prepared_reference(
        self, start_tick: int, positions_w_m: npt.NDArray[np.floating], fps: int = PLANNER_FPS
    ) -> ReferenceBuffer:
        """The reference as `set_reference` would make it, the present one untouched, so that ticks can go on meanwhile.

        Every change of the reference puts another buffer in place of the old one.
        """
        positions = np.asarray(positions_w_m)
        expected = (len(self.human.skeleton), 3)
        if positions.ndim != 3 or positions.shape[1:] != expected or len(positions) == 0:
            raise InvalidInputError(
                f"the plan has shape {positions.shape}", field="positions_w_m", allowed=f"(T >= 1, {expected[0]}, 3)"
            )
        if not np.isfinite(positions).all():
            raise InvalidInputError("the plan is not finite", field="positions_w_m", allowed="finite numbers")
        reference = self.reference.copy()
        reference.insert(start_tick, positions, self.tick, fps)
        return reference

    def set_actions(self, start_tick: int, targets_rad: npt.NDArray[np.floating]) -> None:
        """Servo targets (A, H) for the ticks from start_tick on: row i drives the tick that ends at start_tick + i + 1.

        While they last the tracker is not asked.
        """
        targets = np.asarray(targets_rad, dtype=np.float64)
        hinges = len(self.human.hinges)
        if targets.ndim != 2 or targets.shape[1] != hinges:
            raise InvalidInputError(
                f"the actions have shape {targets.shape}", field="actions", allowed=f"(A, {hinges})"
            )
        if not np.isfinite(targets).all():
            raise InvalidInputError("the actions are not finite", field="actions", allowed="finite numbers")
        self._actions = (start_tick, targets)

    def impulse(self, body: str, impulse_w_ns: tuple[float, float, float]) -> None:
        """Push one body at its centre of mass, in newton seconds; it acts in the next substep."""
        joint = self.human.skeleton.index(body)
        force = np.asarray(impulse_w_ns, dtype=np.float64) * PHYSICS_HZ
        if not np.isfinite(force).all():
            raise InvalidInputError("the impulse is not finite", field="impulse_w_ns", allowed="finite numbers")
        self._data.xfrc_applied[self.scene.body_ids[joint], :3] += force

    def observe(self) -> TrackerObservation:
        """State now and reference at the next ticks, for the tracker."""
        pos, quat, lin, ang = self._body_states()
        ref = self.reference.at(self.tick + 1, PREVIEW_ROWS)
        return TrackerObservation(
            body_pos_w_m=pos,
            body_quat_w=quat,
            body_linvel_w_mps=lin,
            body_angvel_w_radps=ang,
            hinge_pos_rad=self._data.qpos[7 : self._hinge_end].copy(),
            hinge_vel_radps=self._data.qvel[6 : self._hinge_end - 1].copy(),
            ref_pos_w_m=ref.pos_w_m,
            ref_linvel_w_mps=ref.linvel_w_mps,
            ref_quat_w=ref.quat_w,
            ref_hinge_rad=ref.hinges_rad,
        )

    def sample(self) -> Samples:
        """The state now as one sample, arrays (1, ...): see `step`."""
        return {name: value[None] for name, value in self._sample(self.tick).items()}

    def step(self, ticks: int) -> Samples:
        """Advance by `ticks`; the 4 x ticks samples after the present one.

        Returns:
            body_pos_w_m (N, J, 3), body_quat_w (N, J, 4), body_linvel_w_mps and body_angvel_w_radps (N, J, 3),
            contacts (N, 4) uint8 of left heel, left toe, right heel, right toe, reference_pos_w_m (N, J, 3),
            tracking_error_m (N,) mean joint distance to the reference, fallen (N,) uint8,
            hinge_pos_rad, hinge_vel_radps, servo_target_rad (N, H), object_pose_w (N, O, 7) position and quaternion,
            object_vel_w (N, O, 6) linear and angular velocity.

        Raises:
            SimulationError: physics produced non-finite or exploding values; the character must be reset or restored.
        """
        rows = [row for _ in range(ticks) for row in self._step_tick()]
        return {name: np.stack([row[name] for row in rows]) for name in rows[0]} if rows else {}

    @property
    def fallen(self) -> bool:
        """DESIGN 2: on the floor for 0.3 s while the reference is not."""
        return self._fall.fallen

    def _step_tick(self) -> list[Samples]:
        rows = []
        pose_only = self.tracker.spec.drives == "pose"
        if not pose_only:
            self._data.ctrl[:] = self._targets()
        for substep in range(1, SUBSTEPS + 1):
            if pose_only:
                self._pose(substep / SUBSTEPS)
            else:
                mujoco.mj_step(self.scene.model, self._data)
                self._data.xfrc_applied[:] = 0.0
            if substep == SUBSTEPS:
                self._end_tick()
            rows.append(self._sample(self.tick if substep == SUBSTEPS else self.tick + substep / SUBSTEPS))
        return rows

    def _end_tick(self) -> None:
        self.tick += 1
        self._check()
        self._fall.update(self._data, floor_touch(self.scene, self._data), self.reference.at(self.tick).pos_w_m[0])

    def _targets(self) -> Array:
        start, chunk = self._actions
        if start <= self.tick < start + len(chunk):
            targets = chunk[self.tick - start]
        else:
            targets = np.asarray(self.tracker.act([self.character_id], [self.observe()])[0], dtype=np.float64)
        if not np.isfinite(targets).all():
            raise SimulationError(f"tracker {self.tracker.spec.name!r} gave non-finite targets at tick {self.tick}")
        return np.asarray(np.clip(targets, self.human.hinges.lower, self.human.hinges.upper))

    def _pose(self, phase: float) -> None:
        """Show the reference between this tick and the next, without physics; objects rest."""
        ref = self.reference.at(self.tick, 2).qpos
        model, data = self.scene.model, self._data
        step = np.zeros(model.nv)
        here, there = data.qpos.copy(), data.qpos.copy()
        here[: self._hinge_end], there[: self._hinge_end] = ref
        mujoco.mj_differentiatePos(model, step, 1.0 / TICK_HZ, here, there)
        mujoco.mj_integratePos(model, here, step, phase / TICK_HZ)
        data.qpos[:], data.qvel[:] = here, step
        data.time += 1.0 / PHYSICS_HZ
        mujoco.mj_forward(model, data)

    def _check(self) -> None:
        data = self._data
        finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
        if not finite or np.abs(data.qvel[:3]).max() > EXPLODED_MPS:
            raise SimulationError(f"physics exploded at tick {self.tick}")

    def _body_states(self) -> tuple[Array, Array, Array, Array]:
        """Positions (J, 3), quaternions (J, 4), linear and angular velocities (J, 3) of the bodies' frames, world."""
        model, data = self.scene.model, self._data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        return self._states_of(self.scene.body_ids)

    def _states_of(self, ids: npt.NDArray[np.integer]) -> tuple[Array, Array, Array, Array]:
        model, data = self.scene.model, self._data
        pos = data.xpos[ids]
        spin = data.cvel[ids, :3]
        arm = pos - data.subtree_com[model.body_rootid[ids]]
        return pos, data.xquat[ids], data.cvel[ids, 3:] + np.cross(spin, arm), spin

    def _sample(self, tick: float) -> Samples:
        pos, quat, lin, ang = self._body_states()
        whole = int(tick)
        ref = self.reference.at(whole, 2).pos_w_m
        target = ref[0] + (tick - whole) * (ref[1] - ref[0])
        data = self._data
        object_pos, object_quat, object_lin, object_ang = self._states_of(self.scene.object_ids)
        touching = floor_touch(self.scene, data, floor_only=False)
        return {
            "body_pos_w_m": pos,
            "body_quat_w": quat,
            "body_linvel_w_mps": lin,
            "body_angvel_w_radps": ang,
            "contacts": touching[self._feet].astype(np.uint8),
            "reference_pos_w_m": target,
            "tracking_error_m": np.array(np.linalg.norm(pos - target, axis=-1).mean()),
            "fallen": np.array(self._fall.fallen, dtype=np.uint8),
            "hinge_pos_rad": data.qpos[7 : self._hinge_end].copy(),
            "hinge_vel_radps": data.qvel[6 : self._hinge_end - 1].copy(),
            "servo_target_rad": data.ctrl.copy(),
            "object_pose_w": np.concatenate([object_pos, object_quat], axis=-1),
            "object_vel_w": np.concatenate([object_lin, object_ang], axis=-1),
        }

    def snapshot(self) -> tuple[dict[str, Any], Array, npt.NDArray[np.uint8]]:
        """Complete state: JSON-able facts, the physics vector, and the buffers as bytes. `restore` takes all three."""
        state = np.zeros(mujoco.mj_stateSize(self.scene.model, _STATE))
        mujoco.mj_getState(self.scene.model, self._data, state, _STATE)
        arrays = {f"ref_{name}": array for name, array in self.reference.to_arrays().items()}
        out = io.BytesIO()
        np.savez(out, actions=self._actions[1], **arrays)  # type: ignore[arg-type]
        meta = {
            "tick": self.tick,
            "scene": self.scene.scene.name,
            "character": self.human.character.name,
            "tracker": self.tracker.spec.name,
            "actions_start": self._actions[0],
            "down_ticks": self._fall.down_ticks,
        }
        return meta, state, np.frombuffer(out.getvalue(), dtype=np.uint8).copy()

    def restore(self, meta: Mapping[str, Any], state: Array, buffers: npt.NDArray[np.uint8]) -> None:
        """Go on from a snapshot of the same scene and character, bit for bit.

        Raises:
            InvalidInputError: the snapshot belongs to another scene or character, or is damaged.
        """
        for field, mine in (("scene", self.scene.scene.name), ("character", self.human.character.name)):
            if meta.get(field) != mine:
                raise InvalidInputError(f"the snapshot is of {meta.get(field)!r}", field=f"meta.{field}", allowed=mine)
        size = mujoco.mj_stateSize(self.scene.model, _STATE)
        if state.shape != (size,):
            raise InvalidInputError(f"the state has shape {state.shape}", field="state", allowed=f"({size},)")
        try:
            with np.load(io.BytesIO(buffers.tobytes()), allow_pickle=False) as data:
                arrays = {name: data[name] for name in data.files}
            reference = self.reference.copy()
            reference.from_arrays({name[4:]: arrays[name] for name in arrays if name.startswith("ref_")})
            self.reference = reference
            self._actions = (int(meta["actions_start"]), np.asarray(arrays["actions"], dtype=np.float64))
            self.tick = int(meta["tick"])
            self._fall.down_ticks = int(meta["down_ticks"])
        except (KeyError, ValueError, OSError) as error:
            raise InvalidInputError(f"the snapshot is damaged: {error}", field="buffers") from error
        mujoco.mj_setState(self.scene.model, self._data, np.ascontiguousarray(state, dtype=np.float64), _STATE)
        # Contacts are not part of the state; forward finds them again, then the warm start is put back.
        mujoco.mj_forward(self.scene.model, self._data)
        mujoco.mj_setState(self.scene.model, self._data, np.ascontiguousarray(state, dtype=np.float64), _STATE)
        self.tracker.reset([self.character_id])
