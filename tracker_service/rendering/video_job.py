"""What a video is made of, as data that travels to the rendering process: a folder with job.json and arrays.npz."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from shared.motion.heading import heading_of
from shared.motion.skeleton import CANONICAL
from shared.protocol.rates import TICK_HZ
from tracker_service.rendering.scene_shapes import SceneShape

FloatArray = npt.NDArray[np.floating]
Camera = Literal["follow", "side", "top"]


@dataclass(frozen=True)
class VideoJob:
    """A range of a character's log to be drawn.

    Attributes:
        body_pos_w_m: (T, J, 3); body_quat_w: (T, J, 4) wxyz.
        object_pose_w: (T, O, 7) position and quaternion of the objects named in `objects`.
        shapes: how the scene's objects look.
        fps: frames a second; rows are 30 / fps ticks apart.
        start_tick: tick of the first frame; captions: (tick from which it shows, text), an empty text clears.
        width, height: pixels, even.
        camera: `follow` keeps the character in view from the front side, `side` from the side, `top` from above.
    """

    body_pos_w_m: FloatArray
    body_quat_w: FloatArray
    object_pose_w: FloatArray
    objects: tuple[str, ...] = ()
    shapes: tuple[SceneShape, ...] = ()
    fps: int = TICK_HZ
    start_tick: int = 0
    captions: tuple[tuple[int, str], ...] = ()
    width: int = 640
    height: int = 480
    camera: Camera = "follow"
    skeleton_id: str = field(default=CANONICAL.id)

    def tick_of(self, frame: int) -> int:
        """The tick that a frame shows."""
        return self.start_tick + frame * TICK_HZ // self.fps

    def caption_at(self, frame: int) -> str:
        """The text that shows at a frame."""
        tick = self.tick_of(frame)
        shown = [text for start, text in sorted(self.captions, key=lambda c: c[0]) if start <= tick]
        return shown[-1] if shown else ""


_ARRAYS = ("body_pos_w_m", "body_quat_w", "object_pose_w")


def save_job(job: VideoJob, folder: Path) -> None:
    """Write the job into an existing folder."""
    meta = {name: value for name, value in vars(job).items() if name not in _ARRAYS}
    meta["shapes"] = [asdict(shape) for shape in job.shapes]
    (folder / "job.json").write_text(json.dumps(meta))
    np.savez(folder / "arrays.npz", **{name: getattr(job, name) for name in _ARRAYS})


def load_job(folder: Path) -> VideoJob:
    """Read what `save_job` wrote."""
    meta = json.loads((folder / "job.json").read_text())
    shapes = tuple(
        SceneShape(
            shape["body"], shape["kind"], tuple(shape["size_m"]), tuple(shape["pos_b_m"]), tuple(shape["quat_b"]),
            tuple(shape["rgba"]),
        )
        for shape in meta.pop("shapes")
    )  # fmt: skip
    objects = tuple(meta.pop("objects"))
    captions = tuple((int(tick), str(text)) for tick, text in meta.pop("captions"))
    with np.load(folder / "arrays.npz", allow_pickle=False) as data:
        arrays = {name: data[name] for name in _ARRAYS}
    return VideoJob(**arrays, objects=objects, shapes=shapes, captions=captions, **meta)


def camera_path(job: VideoJob) -> tuple[FloatArray, FloatArray]:
    """Smoothed look-at points (T, 3) and the direction of view in radians about Z (T,) for the job's camera.

    The look-at point follows the pelvis over the floor with a lag-free smoothing over about a second; `follow` turns
    slowly so as to stay at the front side of the character, the others keep their direction.
    """
    pelvis = job.body_pos_w_m[:, 0].astype(np.float64)
    x, y = _smooth(pelvis[:, 0], job.fps), _smooth(pelvis[:, 1], job.fps)
    lookat = np.stack([x, y, np.full(len(pelvis), 0.85)], axis=-1)
    forward = _forward_xy(job)
    if job.camera == "follow":
        smooth = [_smooth(forward[:, k], 5 * job.fps) for k in range(2)]
        facing = np.unwrap(heading_of(np.stack(smooth, axis=-1)))
        return lookat, facing + np.deg2rad(180.0 - 50.0)
    start = float(heading_of(forward[0]))
    return lookat, np.full(len(pelvis), start + np.pi / 2)


def camera_distance_m(job: VideoJob) -> float:
    """How far the camera stays away: farther in a scene with objects, so that they are seen."""
    return (6.0 if job.camera == "top" else 4.0) + (1.8 if job.shapes else 0.0)


def _forward_xy(job: VideoJob) -> FloatArray:
    """(T, 2) horizontal facing from the pelvis rotation: its X axis."""
    w, x, y, z = np.moveaxis(job.body_quat_w[:, 0].astype(np.float64), -1, 0)
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z)], axis=-1)


def _smooth(x: FloatArray, width: int) -> FloatArray:
    """Moving average with held ends."""
    half = width // 2
    padded = np.concatenate([np.full(half, x[0]), x, np.full(half, x[-1])])
    return np.asarray(np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), mode="valid"))
