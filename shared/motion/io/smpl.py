"""SMPL npz files (`poses` (T, 72 or more) axis-angle, `trans` (T, 3), a rate), Z up, as AMASS writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.io.raw import Y_UP_TO_Z_UP, RawMotion, accumulate, compose
from shared.motion.rotations import matrix_from_rotvec
from shared.motion.skeleton import CANONICAL

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "fps")


def read_smpl_npz(path: str | Path) -> RawMotion:
    """Read an SMPL or SMPL-H npz; its first 22 joints are HumanML3D's, in the same order.

    SMPL's template is not needed: its joint rotations are relative to a T-pose that faces +Z with Y up, so they
    are put on the canonical skeleton's proportions. Heights are off by a constant that the retargeting removes.

    Raises:
        InvalidInputError: missing arrays or wrong shapes.
    """
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {k: data[k] for k in data.files if k in ("poses", "trans", *_RATE_KEYS)}
    except (OSError, ValueError) as error:
        raise InvalidInputError(f"{path.name}: not a readable npz ({error})", field="path") from error
    if "poses" not in arrays or "trans" not in arrays:
        raise InvalidInputError(f"{path.name}: no poses or trans", field="path", allowed="arrays poses and trans")
    poses, trans = np.asarray(arrays["poses"], dtype=np.float64), np.asarray(arrays["trans"], dtype=np.float64)
    joints = len(CANONICAL)
    if poses.ndim != 2 or poses.shape[1] < joints * 3 or trans.shape != (len(poses), 3) or len(poses) == 0:
        raise InvalidInputError(f"{path.name}: poses {poses.shape}, trans {trans.shape}", field="path")
    rate = next((float(arrays[k]) for k in _RATE_KEYS if k in arrays), 30.0)
    c = Y_UP_TO_Z_UP
    local = c @ matrix_from_rotvec(poses[:, : joints * 3].reshape(-1, joints, 3)) @ c.T
    # The root's rotation takes the Y-up body into a Z-up world: only its body side changes axes.
    local[:, 0] = matrix_from_rotvec(poses[:, :3]) @ c.T
    offsets = np.array(CANONICAL.offsets_m)
    positions, world = compose(CANONICAL.parents, offsets, trans, local)
    return RawMotion(
        CANONICAL.names,
        CANONICAL.parents,
        offsets,
        positions,
        world,
        accumulate(CANONICAL.parents, offsets),
        rate,
        str(path),
    )
