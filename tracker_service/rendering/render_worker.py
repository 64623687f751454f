"""The rendering process: `python -m tracker_service.rendering.render_worker FOLDER egl|osmesa|drawn [--probe]`.

A process of its own, because the graphics library is chosen when it is loaded, may be missing or crash, and must not
hold up the physics. Reads the job of `FOLDER`, writes `FOLDER/video.mp4`.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from shared.motion.skeleton import skeleton
from shared.protocol.rates import TICK_HZ
from tracker_service.rendering.video_job import VideoJob, camera_distance_m, camera_path, load_job

Frame = npt.NDArray[np.uint8]
BACKENDS = ("egl", "osmesa", "drawn")


def mujoco_frames(job: VideoJob) -> Iterator[Frame]:
    """(height, width, 3) uint8 frames of the mannequin, by MuJoCo's off-screen renderer."""
    import mujoco

    from tracker_service.rendering.mannequin import mannequin_model
    from tracker_service.rendering.shadows import FloorShadows

    bones = skeleton(job.skeleton_id)
    model = mannequin_model(bones, job.shapes, width=job.width, height=job.height)
    data = mujoco.MjData(model)
    bodies = [int(model.body(name).mocapid[0]) for name in bones.names]
    shown = {shape.body for shape in job.shapes}
    objects = [(o, int(model.body(f"object:{n}").mocapid[0])) for o, n in enumerate(job.objects) if n in shown]
    lookat, azimuth = camera_path(job)
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation = camera_distance_m(job), -89.0 if job.camera == "top" else -14.0
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, job.height, job.width)
    # Shadow maps would draw the scene three times over, most of the time of a frame without a graphics card.
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    shadows = FloorShadows(renderer.scene)
    try:
        for t in range(len(job.body_pos_w_m)):
            data.mocap_pos[bodies] = job.body_pos_w_m[t]
            data.mocap_quat[bodies] = job.body_quat_w[t]
            for o, body in objects:
                data.mocap_pos[body] = job.object_pose_w[t, o, :3]
                data.mocap_quat[body] = job.object_pose_w[t, o, 3:]
            mujoco.mj_kinematics(model, data)
            camera.lookat[:] = lookat[t]
            camera.azimuth = float(np.rad2deg(azimuth[t]))
            renderer.update_scene(data, camera)
            shadows.cast()
            yield np.asarray(renderer.render(), dtype=np.uint8)
    finally:
        renderer.close()


def with_captions(job: VideoJob, frames: Iterable[Frame]) -> Iterator[Frame]:
    """The frames with the caption of their tick and the time written over them."""
    font = ImageFont.load_default(size=max(12, job.height // 26))
    small = ImageFont.load_default(size=max(10, job.height // 36))
    for t, frame in enumerate(frames):
        image = Image.fromarray(frame)
        pen = ImageDraw.Draw(image, "RGBA")
        clock = f"{job.tick_of(t) / TICK_HZ:6.2f} s"
        pen.text((job.width - 10, 8), clock, font=small, fill=(40, 44, 52, 255), anchor="ra")
        text = job.caption_at(t)
        if text:
            wrapped = _wrap(text, font, job.width - 40)
            left, top, right, bottom = pen.multiline_textbbox((0, 0), wrapped, font=font)
            x, y = (job.width - (right - left)) / 2, job.height - (bottom - top) - 22
            pen.rounded_rectangle(
                [x - 10, y - 7, x + (right - left) + 10, y + (bottom - top) + 9], radius=7, fill=(24, 28, 36, 190)
            )
            pen.multiline_text((x - left, y - top), wrapped, font=font, fill=(255, 255, 255, 255), align="center")
        yield np.asarray(image, dtype=np.uint8)


def _wrap(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> str:
    """`text` in at most three lines of `width` pixels."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if lines[-1] and font.getlength(longer) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return "\n".join([*lines[:2], lines[2] + " ..."] if len(lines) > 3 else lines)


def write_mp4(path: Path, frames: Iterable[Frame], job: VideoJob) -> None:
    """Encode frames as H.264 that plays while it loads."""
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(
        str(path), (job.width, job.height), fps=job.fps, codec="libx264", pix_fmt_out="yuv420p",
        macro_block_size=2, quality=None,
        output_params=["-crf", "23", "-preset", "veryfast", "-movflags", "+faststart", "-threads", "1"],
    )  # fmt: skip
    writer.send(None)
    try:
        for frame in frames:
            writer.send(np.ascontiguousarray(frame))
    finally:
        writer.close()


def probe() -> None:
    """Render one tiny frame with the chosen library; fails in whatever way the library fails."""
    import mujoco

    model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, 16, 16)
    renderer.update_scene(data)
    renderer.render()
    renderer.close()


def main(argv: list[str]) -> int:
    """Command line; exit code 0 when the video (or the probe's frame) was made."""
    folder, backend = Path(argv[0]), argv[1]
    if backend != "drawn":
        os.environ["MUJOCO_GL"] = backend
        os.environ["PYOPENGL_PLATFORM"] = backend
    if "--probe" in argv:
        probe()
        return 0
    job = load_job(folder)
    if backend == "drawn":
        from tracker_service.rendering.drawn import draw_frames

        frames = draw_frames(job)
    else:
        frames = mujoco_frames(job)
    write_mp4(folder / "video.mp4", with_captions(job, frames), job)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
