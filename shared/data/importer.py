"""`motionloop data import`: recordings of any skeleton with legs, retargeted to the canonical one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from shared.data.grounding import Quality, ground
from shared.data.retarget import Calibration, calibrate, retarget
from shared.data.splice import denoise
from shared.errors import InvalidInputError
from shared.motion.body import origin_start
from shared.motion.clip import MotionClip
from shared.motion.ik import clip_from_positions
from shared.motion.io.bvh import write_bvh
from shared.motion.io.files import SUFFIXES, read_motion
from shared.motion.io.options import ReadOptions

FPS = 30.0
_REST_JUMP_M = 0.25


def load_clip(
    path: str | Path, calibration: Calibration | None = None, options: ReadOptions | None = None
) -> tuple[MotionClip, Quality]:
    """A recording as a clip of the canonical skeleton at 30 fps, on the floor, starting over the origin facing +X.

    Raises:
        InvalidInputError: it cannot be read, or is shorter than three frames.
    """
    raw = read_motion(path, options)
    if len(raw) < 4:
        raise InvalidInputError(f"{Path(path).name}: {len(raw)} frames are too few", field="path", allowed=">= 4")
    positions = retarget(raw, calibration if calibration is not None else calibrate([raw]))
    if len(positions) > 3 and np.linalg.norm(positions[1] - positions[0], axis=-1).max() > _REST_JUMP_M:
        positions = positions[1:]  # many BVH files begin with their zero pose
    positions, quality = ground(denoise(positions))
    return clip_from_positions(origin_start(positions), FPS, rebuild=True), quality


def import_path(
    path: str | Path, out: str | Path, progress: Callable[[str, float], None] | None = None
) -> list[dict[str, object]]:
    """Import a file, or all motion files below a folder.

    Each becomes `<out>/<name>.npz` (positions_w_m, rotations_6d, fps) and `<out>/<name>.bvh`.

    Returns:
        One entry a file: `file`, `frames` and `quality`, or `error` where it could not be imported.

    Raises:
        InvalidInputError: nothing to import at `path`.
    """
    path, out = Path(path), Path(out)
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.suffix.lower() in SUFFIXES)
    if not files:
        raise InvalidInputError(f"no motion files at {path}", field="path", allowed=", ".join(SUFFIXES))
    out.mkdir(parents=True, exist_ok=True)
    entries: list[dict[str, object]] = []
    for k, file in enumerate(files):
        name = file.stem if path.is_file() else "_".join(file.relative_to(path).with_suffix("").parts)
        if progress is not None:
            progress(name, k / len(files))
        try:
            clip, quality = load_clip(file)
        except InvalidInputError as error:
            entries.append({"file": str(file), "error": error.message})
            continue
        np.savez_compressed(
            out / f"{name}.npz",
            positions_w_m=clip.positions_w_m.astype(np.float32),
            rotations_6d=clip.rotations_6d.astype(np.float32),
            fps=np.float32(clip.fps),
        )
        write_bvh(out / f"{name}.bvh", clip)
        entries.append({"file": str(file), "frames": len(clip), "quality": quality.as_dict()})
    return entries
