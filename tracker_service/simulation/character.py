"""One simulated character: a humanoid in its scene, its reference, its tracker, its clock.

Lockstep by nature: time passes only in `step`. The same calls give the same samples bit for bit.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from shared.errors import InvalidInputError, SimulationError
from shared.motion.rotations import cross, matrix_from_quat
from shared.npz import SNAPSHOT_BYTES, read_npz
from shared.plugins.interfaces import Tracker, TrackerObservation
from shared.protocol.rates import PHYSICS_HZ, PLANNER_FPS, TICK_HZ
from tracker_service.simulation.contacts import Contacts
from tracker_service.simulation.drive import Driver
from tracker_service.simulation.fallen import FallDetector
from tracker_service.simulation.humanoid import FEET
from tracker_service.simulation.objects import Vector, set_object
from tracker_service.simulation.reference import ReferenceBuffer
from tracker_service.simulation.scene import SceneModel
from tracker_service.simulation.substeps import Substeps
from tracker_service.simulation.surroundings import Heights, Sight

Array = npt.NDArray[np.float64]
Samples = dict[str, npt.NDArray[np.generic]]

SUBSTEPS = PHYSICS_HZ // TICK_HZ
PREVIEW_ROWS = 4
EXPLODED_MPS = 60.0
"""No body part moves this fast; physics that does has exploded."""

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


class States(NamedTuple):
    """World frames: positions (N, 3), quaternions (N, 4), linear and angular velocities (N, 3)."""

    pos_w_m: Array
    quat_w: Array
    linvel_w_mps: Array
    angvel_w_radps: Array

    @property
    def pose(self) -> Array:
        """(N, 7)."""
        return np.concatenate([self.pos_w_m, self.quat_w], axis=-1)

    @property
    def velocity(self) -> Array:
        """(N, 6)."""
        return np.concatenate([self.linvel_w_mps, self.angvel_w_radps], axis=-1)


def _moving(pos_w_m: Array, quat_w: Array, com_velocity: Array, root_com_w_m: Array) -> tuple[Array, ...]:
    """Positions, quaternions, linear and angular velocities (..., N, 3 or 4) of frames.

    Args:
        com_velocity: (..., N, 6) MuJoCo's, angular then linear, of the point of the body at the centre of mass of its
            tree, root_com_w_m (..., N, 3).
    """
    spin = com_velocity[..., :3]
    return pos_w_m, quat_w, com_velocity[..., 3:] + cross(spin, pos_w_m - root_com_w_m), spin


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
        self.driver = Driver(scene.human, tracker, character_id)
        self.tick = 0
        self._data = mujoco.MjData(scene.model)
        self._hinge_end = 7 + len(self.human.hinges)
        self._contacts = Contacts(scene)
        self._heights = Heights(scene)
        self._sight = Sight(scene, self._heights)
        self._frames = np.concatenate([scene.body_ids, scene.object_ids])
        self._roots = np.asarray(scene.model.body_rootid)[self._frames]
        self._low: list[tuple[int, bool]] = []
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
        self._low = []
        self._fall = FallDetector(self.scene, self._heights)
        mujoco.mj_forward(model, data)
        self.driver.reset()

    @property
    def tracker(self) -> Tracker:
        """The tracker in use."""
        return self.driver.tracker

    def set_tracker(self, tracker: Tracker) -> None:
        """Swap the tracker; it takes over at the next tick. Raises SimulationError when it cannot be reset."""
        self.driver.swap(tracker)

    def set_reference(
        self, start_tick: int, positions_w_m: npt.NDArray[np.floating], fps: int = PLANNER_FPS, may_be_low: bool = False
    ) -> None:
        """Put a plan (T, 22, 3) in: frame i is at start_tick / 30 + (i + 1) / fps s.

        Rotations are not taken: they come from the positions by the same inverse kinematics everywhere (DESIGN 2).
        """
        self.enter(start_tick, self.prepared_reference(start_tick, positions_w_m, fps), may_be_low)

    def enter(self, start_tick: int, reference: ReferenceBuffer, may_be_low: bool) -> None:
        """Follow a prepared reference; from start_tick on (or now) being low is a fall or none."""
        self.reference = reference
        begins = max(start_tick, self.tick)
        self._low = [(tick, low) for tick, low in self._low if tick < begins][-8:] + [(begins, may_be_low)]

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

    def impulse(self, body: str, impulse_w_ns: tuple[float, float, float]) -> None:
        """Push one body at its centre of mass, in newton seconds; it acts in the next substep."""
        joint = self.human.skeleton.index(body)
        force = np.asarray(impulse_w_ns, dtype=np.float64) * PHYSICS_HZ
        if not np.isfinite(force).all():
            raise InvalidInputError("the impulse is not finite", field="impulse_w_ns", allowed="finite numbers")
        if not self.driver.shows_pose:  # nothing can push what is only shown, and no push waits for a tracker
            self._data.xfrc_applied[self.scene.body_ids[joint], :3] += force

    def set_object(
        self,
        name: str,
        position_w_m: Vector = None,
        quat_w: Vector = None,
        linvel_w_mps: Vector = None,
        angvel_w_radps: Vector = None,
    ) -> None:
        """Move an object at once, see tracker_service.simulation.objects; raises InvalidInputError."""
        set_object(self.scene, self._data, name, position_w_m, quat_w, linvel_w_mps, angvel_w_radps)

    def observe(self) -> TrackerObservation:
        """State now and reference at the next ticks, for the tracker."""
        bodies, objects = self._states()
        pos, quat, lin, ang = bodies
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
            **self._sight.of(self._data, pos, matrix_from_quat(quat[0])[:, 0], objects.pose, objects.velocity),
        )

    def sample(self) -> Samples:
        """The state now as one sample, arrays (1, ...): see `step`."""
        contacts = self._contacts.read(self._data, forces=False)
        self._place_frames()
        substeps = self._substeps(1)
        substeps.keep(0, self._data, *contacts, self.fallen)
        return self._samples(substeps, self.reference.at(self.tick).pos_w_m)

    def step(self, ticks: int) -> Samples:
        """Advance by `ticks`; the 4 x ticks samples after the present one.

        Returns:
            body_pos_w_m (N, J, 3), body_quat_w (N, J, 4), body_linvel_w_mps and body_angvel_w_radps (N, J, 3),
            contacts (N, 4) uint8 of left heel, left toe, right heel, right toe, reference_pos_w_m (N, J, 3),
            tracking_error_m (N,) mean joint distance to the reference, fallen (N,) uint8,
            hinge_pos_rad, hinge_vel_radps, servo_target_rad (N, H), object_pose_w (N, O, 7) position and quaternion,
            object_vel_w (N, O, 6) linear and angular velocity, contact_impulse_ns (N, J, 1 + O) normal impulses since
            the sample before between body and floor (column 0) or object.

        Raises:
            SimulationError: physics produced non-finite or exploding values; the character must be reset or restored.
        """
        parts = [self._step_tick() for _ in range(ticks)]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {}

    @property
    def fallen(self) -> bool:
        """DESIGN 2: low or on the floor for 0.3 s, where that was not asked for."""
        return self._fall.fallen

    def _step_tick(self) -> Samples:
        """The samples of one tick: kept raw substep by substep, worked out together."""
        if not self.driver.shows_pose:
            self._data.ctrl[:] = self.driver.targets(self.tick, self.observe)
        pose_only = self.driver.shows_pose
        here, there = self.reference.at(self.tick, 2).pos_w_m
        substeps = self._substeps(SUBSTEPS)
        for substep in range(1, SUBSTEPS + 1):
            if pose_only:
                self._pose(substep / SUBSTEPS)
            else:
                mujoco.mj_step(self.scene.model, self._data)
            self._data.xfrc_applied[:] = 0.0
            touching, impulses = self._contacts.read(self._data, forces=not pose_only)
            if substep == SUBSTEPS:
                self._end_tick(touching)
            self._place_frames()
            substeps.keep(substep - 1, self._data, touching, impulses, self.fallen)
        phases = np.arange(1, SUBSTEPS)[:, None, None] / SUBSTEPS
        return self._samples(substeps, np.concatenate([here + phases * (there - here), there[None]]))

    def _end_tick(self, touching: npt.NDArray[np.bool_]) -> None:
        self.tick += 1
        self._check()
        may_be_low = next((low for tick, low in reversed(self._low) if tick < self.tick), False)
        self._fall.update(self._data, touching, may_be_low)

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
        data.ctrl[:] = here[7 : self._hinge_end]
        data.time += 1.0 / PHYSICS_HZ
        mujoco.mj_forward(model, data)

    def _check(self) -> None:
        data = self._data
        finite = np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()
        if not finite or np.abs(data.qvel[:3]).max() > EXPLODED_MPS:
            raise SimulationError(f"physics exploded at tick {self.tick}")

    def _place_frames(self) -> None:
        """Frames and velocities of the bodies where the last step has left them."""
        model, data = self.scene.model, self._data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)

    def _states(self) -> tuple[States, States]:
        """Frames of the bodies (J) and of the objects (O)."""
        self._place_frames()
        data, ids = self._data, self._frames
        whole = _moving(data.xpos[ids], data.xquat[ids], data.cvel[ids], data.subtree_com[self._roots])
        bodies = len(self.scene.body_ids)
        return States(*(part[:bodies] for part in whole)), States(*(part[bodies:] for part in whole))

    def _substeps(self, count: int) -> Substeps:
        return Substeps(count, self._frames, self._roots, len(self.human.hinges), self._contacts.shape)

    def _samples(self, kept: Substeps, reference_w_m: Array) -> Samples:
        """What `step` returns of the substeps kept; reference (N, J, 3) at each."""
        bodies = len(self.scene.body_ids)
        pos, quat, lin, ang = _moving(kept.pos_w_m, kept.quat_w, kept.com_velocity, kept.root_com_w_m)
        whole = np.concatenate([pos[:, bodies:], quat[:, bodies:]], axis=-1)
        return {
            "body_pos_w_m": pos[:, :bodies],
            "body_quat_w": quat[:, :bodies],
            "body_linvel_w_mps": lin[:, :bodies],
            "body_angvel_w_radps": ang[:, :bodies],
            "contacts": kept.touching[:, self._feet].any(axis=-1).astype(np.uint8),
            "reference_pos_w_m": reference_w_m,
            "tracking_error_m": np.linalg.norm(pos[:, :bodies] - reference_w_m, axis=-1).mean(axis=-1),
            "fallen": kept.fallen,
            "hinge_pos_rad": kept.hinge_pos_rad,
            "hinge_vel_radps": kept.hinge_vel_radps,
            "servo_target_rad": kept.servo_target_rad,
            "object_pose_w": whole,
            "object_vel_w": np.concatenate([lin[:, bodies:], ang[:, bodies:]], axis=-1),
            "contact_impulse_ns": kept.impulse_ns,
        }

    def snapshot(self) -> tuple[dict[str, Any], Array, npt.NDArray[np.uint8]]:
        """Complete state: JSON-able facts, the physics vector, and the buffers as bytes. `restore` takes all three."""
        state = np.zeros(mujoco.mj_stateSize(self.scene.model, _STATE))
        mujoco.mj_getState(self.scene.model, self._data, state, _STATE)
        arrays = {f"ref_{name}": array for name, array in self.reference.to_arrays().items()}
        out = io.BytesIO()
        np.savez(out, **self.driver.to_arrays(), **arrays)  # type: ignore[arg-type]
        meta = {
            "tick": self.tick,
            "scene": self.scene.scene.name,
            "scene_document": self.scene.scene.model_dump(mode="json"),
            "character": self.human.character.name,
            "tracker": self.tracker.spec.name,
            "down_ticks": self._fall.down_ticks,
            "low": self._low,
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
            arrays = read_npz(buffers.tobytes(), SNAPSHOT_BYTES)
            reference = self.reference.copy()
            reference.from_arrays({name[4:]: arrays[name] for name in arrays if name.startswith("ref_")})
            self.reference = reference
            self.driver.from_arrays(arrays)
            self.tick = int(meta["tick"])
            self._fall.down_ticks = int(meta["down_ticks"])
            self._low = [(int(tick), bool(low)) for tick, low in meta["low"]]
        except (InvalidInputError, KeyError, ValueError, TypeError, OverflowError) as error:
            raise InvalidInputError(f"the snapshot is damaged: {error}", field="buffers") from error
        mujoco.mj_setState(self.scene.model, self._data, np.ascontiguousarray(state, dtype=np.float64), _STATE)
        # Contacts are not part of the state; forward finds them again, then the warm start is put back.
        mujoco.mj_forward(self.scene.model, self._data)
        mujoco.mj_setState(self.scene.model, self._data, np.ascontiguousarray(state, dtype=np.float64), _STATE)
        self.tracker.reset([self.character_id])
