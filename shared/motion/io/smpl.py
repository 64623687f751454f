"""npz files of motion: SMPL, SMPL-H and SMPL-X (axis-angle poses, as AMASS writes them), and our own imported clips."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.io.axes import TURNS, Y_UP_TO_Z_UP, vector
from shared.motion.io.landmarks import Array, find_landmarks, find_segments
from shared.motion.io.options import ReadOptions, rate_of
from shared.motion.io.raw import LeftOutError, RawMotion, accumulate, compose
from shared.motion.kinematics import forward_kinematics
from shared.motion.rotations import matrix_from_6d, matrix_from_rotvec, rotvec_from_matrix
from shared.motion.skeleton import CANONICAL
from shared.npz import read_npz_file

_RATE_KEYS = ("mocap_framerate", "mocap_frame_rate", "framerate", "frame_rate", "mocap_fps", "fps")
_WHOLE_KEYS = ("poses", "pose", "smpl_poses")
_ROOT_KEYS = ("root_orient", "global_orient")
_BODY_KEYS = ("pose_body", "body_pose")
_PLACE_KEYS = ("trans", "transl", "smpl_trans")
_OURS = ("positions_w_m", "rotations_6d")
MOST_BYTES = 2**31
"""Of the arrays of one file, unpacked: hours of motion."""
_UPRIGHT = 0.7
_MOSTLY = 0.8
_FLAT_M = 0.3
_Y_OR_Z = (("y", 1), ("z", 2))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an npz that are looked for here, and the names of all."""
    wanted = (*_RATE_KEYS, *_WHOLE_KEYS, *_ROOT_KEYS, *_BODY_KEYS, *_PLACE_KEYS, *_OURS)
    if path.stat().st_size == 0:
        raise InvalidInputError(f"{path.name}: the file is empty", field="path")
    try:
        names, arrays = read_npz_file(path, wanted, MOST_BYTES)
    except InvalidInputError as error:
        raise InvalidInputError(
            f"{path.name}: not a readable npz, it may be cut off or broken ({error.message})", field="path"
        ) from error
    if not any(k in arrays for k in (*_WHOLE_KEYS, *_BODY_KEYS)) and not all(k in arrays for k in _OURS):
        raise LeftOutError(
            f"{path.name}: no motion in it (its arrays: {', '.join(names[:12]) or 'none'})",
            field="path",
            allowed="poses and trans, or root_orient, pose_body and trans",
        )
    return arrays


def _first(arrays: Mapping[str, np.ndarray], keys: tuple[str, ...]) -> np.ndarray | None:
    return next((arrays[k] for k in keys if k in arrays), None)


def _numbers(path: Path, name: str, array: np.ndarray) -> Array:
    """The array as finite float64; the message names what is not."""
    if array.dtype.kind not in "fiu":
        raise InvalidInputError(f"{path.name}: {name} holds no numbers but {array.dtype}", field="path")
    out = np.asarray(array, dtype=np.float64)
    bad = np.argwhere(~np.isfinite(out))
    if len(bad):
        raise InvalidInputError(f"{path.name}: {name} is not finite in frame {int(bad[0][0])}", field="path")
    return out


def _rate(path: Path, arrays: Mapping[str, np.ndarray], options: ReadOptions) -> tuple[float, list[str]]:
    """Rate and what to say about it; a number, an array of one, or the text of one."""
    key = next((k for k in _RATE_KEYS if k in arrays), None)
    if key is None:
        return rate_of(path.name, None, options)
    array = arrays[key]
    try:
        if array.size != 1 or array.dtype.kind not in "fiuSU":
            raise ValueError
        said = float(array.reshape(-1)[0])
    except ValueError:
        raise InvalidInputError(f"{path.name}: {key} {str(array)[:40]!r} is no rate", field="fps") from None
    return rate_of(path.name, said, options, f"{key} says")


def _axis_angles(poses: Array) -> Array:
    """Poses (T, 3 J) as they are, with an axis for the joints, or as rotation matrices of nine numbers a joint."""
    square = poses.ndim == 4 and poses.shape[2:] == (3, 3)
    if square or (poses.ndim == 2 and len(poses) and poses.shape[1] and poses.shape[1] % 9 == 0):
        matrices = poses.reshape(len(poses), -1, 3, 3)
        if np.allclose(matrices @ np.swapaxes(matrices, -1, -2), np.eye(3), atol=1e-3):
            return rotvec_from_matrix(matrices).reshape(len(poses), -1)
    return poses.reshape(len(poses), -1) if poses.ndim == 3 and poses.shape[2] == 3 else poses


def _poses(path: Path, arrays: Mapping[str, np.ndarray]) -> tuple[Array, Array, list[str]]:
    """(T, 22, 3) axis-angle rotations, (T, 3) places and what to say about them."""
    joints = len(CANONICAL)
    whole, body = _first(arrays, _WHOLE_KEYS), _first(arrays, _BODY_KEYS)
    said: list[str] = []
    if whole is not None:
        poses = _axis_angles(_numbers(path, "poses", whole))
    else:
        assert body is not None
        pose = _numbers(path, "pose_body", body)
        pose = pose.reshape(len(pose), -1) if pose.ndim > 1 else pose
        turn = _first(arrays, _ROOT_KEYS)
        if turn is None or turn.size != 3 * len(pose) or pose.ndim != 2:
            raise InvalidInputError(f"{path.name}: pose_body {pose.shape} without a root_orient of its", field="path")
        poses = np.concatenate([_numbers(path, "root_orient", turn).reshape(-1, 3), pose], axis=1)
    if len(poses) == 0:
        raise LeftOutError(f"{path.name}: 0 frames are too few", field="path", allowed=">= 4")
    if poses.ndim != 2 or poses.shape[1] < joints * 3 or poses.shape[1] % 3:
        raise InvalidInputError(
            f"{path.name}: poses {poses.shape}", field="path", allowed=f"(T, {joints * 3} or more), 3 a joint"
        )
    place = _first(arrays, _PLACE_KEYS)
    if place is None:
        trans = np.zeros((len(poses), 3))
        said.append("no trans in the file: the person stays in place")
    else:
        trans = _numbers(path, "trans", place)
        if trans.ndim == 2 and trans.shape[1] != 3 and trans.shape == (3, len(poses)):
            trans = trans.T
        if trans.ndim == 2 and trans.shape[1] != 3:
            raise InvalidInputError(f"{path.name}: trans {trans.shape}", field="path", allowed=f"({len(poses)}, 3)")
        trans = trans.reshape(-1, 3) if trans.size % 3 == 0 else np.zeros((0, 3))
    if len(trans) != len(poses):
        raise InvalidInputError(f"{path.name}: {len(poses)} poses but {len(trans)} places in trans", field="path")
    return poses[:, : joints * 3].reshape(-1, joints, 3), trans, said


def _up(root: Array, positions: Array) -> tuple[str, str]:
    """Vertical of an SMPL file and a sentence.

    AMASS has Z up. Another axis is taken where the body is held along it nearly throughout, and Y where the person goes
    down or up and the floor is flat along Y alone.

    Args:
        root: (T, 3, 3) rotation of a body whose own vertical is Y. positions: (T, J, 3) in the file's axes.
    """
    body = root[:, :, 1]
    along = {axis: float(np.mean(body @ vector(axis) > _UPRIGHT)) for axis in TURNS}
    held = max(along, key=lambda axis: along[axis])
    if along[held] >= _MOSTLY:
        how = f"the body is held along {held.upper()}"
    else:
        uneven = {axis: float(np.ptp(np.percentile(positions[:, :, i].min(axis=1), [5, 95]))) for axis, i in _Y_OR_Z}
        held = "y" if uneven["y"] < _FLAT_M and uneven["z"] > 2 * _FLAT_M else "z"
        how = "the floor is flat along Y"
    return ("z", "") if held == "z" else (held, f"{how}, not Z: read with {held.upper()} up (--up says otherwise)")


def read_smpl_npz(
    path: str | Path, up: str = "auto", unit_m: float | None = None, fps: float | None = None
) -> RawMotion:
    """Read an SMPL, SMPL-H or SMPL-X npz; its first 22 joints are HumanML3D's, in the same order.

    SMPL's template is not needed: its joint rotations are relative to a T-pose that faces +Z with Y up, so they
    are put on the canonical skeleton's proportions. Heights are off by a constant that the retargeting removes.
    A clip that `motionloop data import` wrote is read as it is.

    Args:
        path: the file: `poses` (T, 66 or more) or `root_orient` and `pose_body`, `trans` (T, 3), a rate.
        up: vertical axis, or "auto": Z, unless the body is held along another nearly throughout.
        unit_m: metres in one unit of `trans`, 1 unless given.
        fps: frames per second in place of the file's.

    Raises:
        LeftOutError: a sound npz that holds no poses.
        InvalidInputError: broken, missing arrays or wrong shapes, values that are not finite, or no possible rate.
    """
    path = Path(path)
    options = ReadOptions(fps, up, unit_m)
    arrays = _arrays(path)
    rate, said = _rate(path, arrays, options)
    offsets = np.array(CANONICAL.offsets_m)
    marks = find_landmarks(CANONICAL.names, CANONICAL.parents)
    segments = find_segments(CANONICAL.names, CANONICAL.parents, marks)
    unit = 1.0 if unit_m is None else unit_m
    if all(k in arrays for k in _OURS):
        positions, world = _own_clip(path, arrays)
        axis, kind = "z", "motionloop"
    else:
        poses, trans, more = _poses(path, arrays)
        rotations = matrix_from_rotvec(poses)
        c = Y_UP_TO_Z_UP
        local = c @ rotations @ c.T
        # The root's rotation takes the Y-up body into the file's world: only its body side changes axes.
        local[:, 0] = rotations[:, 0] @ c.T
        positions, world = compose(CANONICAL.parents, offsets, trans * unit, local)
        axis, doubt = _up(rotations[:, 0], positions) if up == "auto" else (up, "")
        said += [*more, *([doubt] if doubt else [])]
        positions, world = positions @ TURNS[axis].T, TURNS[axis] @ world
        kind = "SMPL"
    return RawMotion(
        CANONICAL.names,
        CANONICAL.parents,
        offsets,
        positions,
        world,
        accumulate(CANONICAL.parents, offsets),
        rate,
        str(path),
        axis,
        unit,
        kind,
        tuple(said),
        marks,
        segments,
    )


def _own_clip(path: Path, arrays: Mapping[str, np.ndarray]) -> tuple[Array, Array]:
    """Positions (T, 22, 3) and world rotations (T, 22, 3, 3) of a clip we wrote."""
    positions, sixes = (_numbers(path, name, arrays[name]) for name in _OURS)
    joints = len(CANONICAL)
    if positions.shape[1:] != (joints, 3) or sixes.shape != (len(positions), joints, 6) or not len(positions):
        raise InvalidInputError(
            f"{path.name}: positions_w_m {positions.shape}, rotations_6d {sixes.shape}", field="path"
        )
    _, world = forward_kinematics(CANONICAL, positions[:, 0], matrix_from_6d(sixes))
    return positions, world


def is_own_clip(path: Path) -> bool:
    """Whether an npz is a clip that `motionloop data import` wrote."""
    try:
        names, _ = read_npz_file(path, (), MOST_BYTES)
    except InvalidInputError:
        return False
    return all(name in names for name in _OURS)
