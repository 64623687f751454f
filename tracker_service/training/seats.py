"""Seats in training: one block for each environment, moved to where its clip has a seat, and the heights it makes.

The block is a mocap body of the training model: `mujoco.rollout` takes its pose with the controls, so that seats of all
heights stand in one rollout. Heights have the meaning and order of `TrackerObservation`: ground grid, feet, pelvis.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from shared.plugins.interfaces import GROUND_GRID_M
from tracker_service.simulation.humanoid import BODY_BIT, WORLD_BIT, Humanoid, humanoid_spec

Floats = npt.NDArray[np.floating]

SEAT_SIZE_M = (0.40, 0.45, 0.06)
"""Extent of the block forward, across and down from its top."""
HEIGHTS = len(GROUND_GRID_M) ** 2 + 3
NO_SEAT = (0.0, 0.0, -5.0, 0.0)
"""Centre of the top and heading of a seat that is out of the way."""
CONTROL_SPEC = int(
    mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)


def training_model(human: Humanoid) -> mujoco.MjModel:
    """The humanoid over a floor with a block that can stand anywhere."""
    spec = humanoid_spec(human)
    body = spec.worldbody.add_body(name="seat", mocap=True, pos=[0, 0, NO_SEAT[2]])
    half = [s / 2 for s in SEAT_SIZE_M]
    body.add_geom(
        name="seat", type=mujoco.mjtGeom.mjGEOM_BOX, size=half, pos=[0, 0, -half[2]],
        friction=[human.character.sole_friction, 0.005, 0.0001], contype=WORLD_BIT, conaffinity=BODY_BIT,
    )  # fmt: skip
    return spec.compile()


def mocap_of(seat: Floats) -> npt.NDArray[np.float64]:
    """(B, 7) mocap position and quaternion of seats (B, 4): centre of the top and heading."""
    half = seat[:, 3] / 2
    zero = np.zeros_like(half)
    return np.concatenate([seat[:, :3], np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)], axis=-1)


def height_points(pos_w_m: Floats, forward_w: Floats, feet: tuple[int, int]) -> Floats:
    """(B, HEIGHTS, 2) points on the floor whose heights are seen.

    Args:
        pos_w_m: (B, J, 3) of the bodies. forward_w: (B, 3) the X axis of the pelvis.
        feet: indices of left_foot and right_foot.
    """
    norm = np.maximum(np.linalg.norm(forward_w[:, :2], axis=-1), 1e-6)[:, None]
    ahead = forward_w[:, :2] / norm
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1)
    root = pos_w_m[:, 0, :2]
    grid = [root + a * ahead + b * left for a in GROUND_GRID_M for b in GROUND_GRID_M]
    return np.stack([*grid, pos_w_m[:, feet[0], :2], pos_w_m[:, feet[1], :2], root], axis=1)


def seat_heights(points_m: Floats, pelvis_height_m: Floats, seat: Floats) -> Floats:
    """(B, N) heights at points (B, N, 2): the seat's top where it lies under the point and below the pelvis, else 0."""
    offset = points_m - seat[:, None, :2]
    c, s = np.cos(seat[:, 3])[:, None], np.sin(seat[:, 3])[:, None]
    along = c * offset[..., 0] + s * offset[..., 1]
    across = c * offset[..., 1] - s * offset[..., 0]
    over = (np.abs(along) <= SEAT_SIZE_M[0] / 2) & (np.abs(across) <= SEAT_SIZE_M[1] / 2)
    top = seat[:, 2:3]
    return np.where(over & (top > 0) & (top < pelvis_height_m[:, None]), top, 0.0)


SEATED_BODIES = ("pelvis", "left_hip", "right_hip", "spine1")
ALLOWED_M = 0.005
STRIDE = 3


def lowered(model: mujoco.MjModel, qpos: Floats, seat: tuple[float, float, float, float]) -> tuple[float, ...]:
    """A clip's seat, lowered until the body that sits on it is at most ALLOWED_M deep in it.

    Retargeted and made sits know joints, not flesh: their thighs are up to 7 cm deep in the block, which would throw
    the body off it.

    Args:
        model: of `training_model`. qpos: (T, 7+H) of the clip.
    """
    data = mujoco.MjData(model)
    place = mocap_of(np.array([seat]))[0]
    data.mocap_pos[0], data.mocap_quat[0] = place[:3], place[3:]
    block = model.body("seat").id
    seated = {model.body(name).id for name in SEATED_BODIES}
    deepest = []
    for row in qpos[::STRIDE]:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        depth = 0.0
        for contact in data.contact[: data.ncon]:
            bodies = {int(model.geom_bodyid[contact.geom1]), int(model.geom_bodyid[contact.geom2])}
            if block in bodies and bodies & seated:
                depth = max(depth, -float(contact.dist))
        deepest.append(depth)
    down = max(float(np.percentile(deepest, 95)) - ALLOWED_M, 0.0)
    return (seat[0], seat[1], seat[2] - down, seat[3])
