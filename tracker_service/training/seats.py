"""Seats in training: a stool and a sofa for each environment, moved to where its clip has a seat, and their heights.

Both are mocap bodies of the training model: `mujoco.rollout` takes their poses with the controls, so that seats of all
heights stand in one rollout. Heights have the meaning and order of `TrackerObservation`: ground grid, feet, pelvis.
"""

from __future__ import annotations

import mujoco
import numpy as np
import numpy.typing as npt

from shared.plugins.interfaces import GROUND_GRID_M
from tracker_service.simulation.humanoid import BODY_BIT, WORLD_BIT, Humanoid, humanoid_spec
from tracker_service.training.bags import add_bag

Floats = npt.NDArray[np.floating]

SEAT_SIZE_M = (0.40, 0.45, 0.06)
"""Extent of the block forward, across and down from its top."""
HEIGHTS = len(GROUND_GRID_M) ** 2 + 3
EDGE_M = SEAT_SIZE_M[0] / 2
"""The front edge lies so far ahead of a seat's place, be it a stool or a sofa."""
SOFA_SIZE_M = (0.90, 2.00, 0.30)
BACK_SIZE_M = (0.22, 2.00, 0.392)
"""Extent of a sofa's seat and, upon its rear, of its back: those of the scene `sofa`, closed down to the floor."""
NO_SEAT = (0.0, 0.0, -5.0, 0.0, 0.0)
"""x, y and height of the place to sit, its heading, and 1 for a sofa (0 for a stool); this one is out of the way."""
Seat = tuple[float, float, float, float, float]
CONTROL_SPEC = int(
    mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_MOCAP_POS | mujoco.mjtState.mjSTATE_MOCAP_QUAT
)


def training_model(human: Humanoid) -> mujoco.MjModel:
    """The humanoid over a floor with a stool, a sofa and a bag that can stand anywhere, in this order."""
    spec = humanoid_spec(human)
    deep, wide, thick = SOFA_SIZE_M
    middle = EDGE_M - deep / 2
    parts = {
        "stool": [(SEAT_SIZE_M, [0, 0, -SEAT_SIZE_M[2] / 2])],
        "sofa": [
            ((deep, wide, thick), [middle, 0, -thick / 2]),
            (BACK_SIZE_M, [EDGE_M - deep + BACK_SIZE_M[0] / 2, 0, BACK_SIZE_M[2] / 2]),
        ],
    }
    for name, boxes in parts.items():
        body = spec.worldbody.add_body(name=name, mocap=True, pos=[0, 0, NO_SEAT[2]])
        for size, place in boxes:
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=[s / 2 for s in size], pos=place,
                friction=[human.character.sole_friction, 0.005, 0.0001], contype=WORLD_BIT, conaffinity=BODY_BIT,
            )  # fmt: skip
    add_bag(spec)
    return spec.compile()


def mocap_of(seat: Floats, bag: Floats | None = None) -> npt.NDArray[np.float64]:
    """(B, 21) mocap positions of stool, sofa and bag and then their quaternions, for seats (B, 5) as `NO_SEAT` has them
    and bags (B, 5) as `training.bags.NO_BAG`; without, none is there."""
    half, sofa = seat[:, 3] / 2, seat[:, 4:] > 0
    away = np.broadcast_to(NO_SEAT[:3], (len(seat), 3))
    zero = np.zeros_like(half)
    turn = np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)
    base = away if bag is None else bag[:, :3]
    upright = np.broadcast_to((1.0, 0.0, 0.0, 0.0), turn.shape)
    places = [np.where(sofa, away, seat[:, :3]), np.where(sofa, seat[:, :3], away), base]
    return np.concatenate([*places, turn, turn, upright], axis=-1)


def wide_fits(pos_w_m: Floats, seat: Floats, feet: npt.NDArray[np.integer]) -> bool:
    """Whether a clip (T, J, 3) on a stool would go with a sofa in its place: no foot ever is behind the front edge.

    Args:
        feet: indices of ankles and feet.
    """
    along = (pos_w_m[:, feet, :2] - seat[:2]) @ np.array([np.cos(seat[3]), np.sin(seat[3])])
    return bool(along.min() >= EDGE_M)


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
    """(B, N) heights at points (B, N, 2): the seat's top where it lies under the point and below the pelvis, else 0.

    Where a sofa's back is lower than the pelvis it counts too.
    """
    offset = points_m - seat[:, None, :2]
    c, s = np.cos(seat[:, 3])[:, None], np.sin(seat[:, 3])[:, None]
    behind = EDGE_M - (c * offset[..., 0] + s * offset[..., 1])
    across = np.abs(c * offset[..., 1] - s * offset[..., 0])
    sofa, top, pelvis = seat[:, 4:] > 0, seat[:, 2:3], pelvis_height_m[:, None]
    deep, wide = (np.where(sofa, SOFA_SIZE_M[i], SEAT_SIZE_M[i]) for i in range(2))
    over = (behind >= 0) & (behind <= deep) & (across <= wide / 2) & (top > 0)
    back = over & sofa & (behind >= deep - BACK_SIZE_M[0]) & (top + BACK_SIZE_M[2] < pelvis)
    return np.where(back, top + BACK_SIZE_M[2], np.where(over & (top < pelvis), top, 0.0))


SEATED_BODIES = ("pelvis", "left_hip", "right_hip", "spine1")
ALLOWED_M = 0.005
STRIDE = 3


def lowered(model: mujoco.MjModel, qpos: Floats, seat: Seat) -> Seat:
    """A clip's seat, lowered until the body that sits on it is at most ALLOWED_M deep in it.

    Retargeted and made sits know joints, not flesh: their thighs are up to 7 cm deep in the block, which would throw
    the body off it.

    Args:
        model: of `training_model`. qpos: (T, 7+H) of the clip.
    """
    data = mujoco.MjData(model)
    place = mocap_of(np.array([seat]))[0]
    data.mocap_pos[:], data.mocap_quat[:] = place[:9].reshape(3, 3), place[9:].reshape(3, 4)
    blocks = {model.body(name).id for name in ("stool", "sofa")}
    seated = {model.body(name).id for name in SEATED_BODIES}
    deepest = []
    for row in qpos[::STRIDE]:
        data.qpos[: len(row)] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        depth = 0.0
        for contact in data.contact[: data.ncon]:
            bodies = {int(model.geom_bodyid[contact.geom1]), int(model.geom_bodyid[contact.geom2])}
            if bodies & blocks and bodies & seated:
                depth = max(depth, -float(contact.dist))
        deepest.append(depth)
    down = max(float(np.percentile(deepest, 95)) - ALLOWED_M, 0.0)
    return (seat[0], seat[1], seat[2] - down, *seat[3:])
