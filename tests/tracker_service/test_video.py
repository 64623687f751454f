"""Videos: really encoded, really different from frame to frame, and never failing for want of a graphics library."""

from __future__ import annotations

from pathlib import Path

import imageio_ffmpeg
import numpy as np
import numpy.typing as npt
import pytest

from shared.motion.rotations import quat_from_matrix
from shared.protocol.messages import CreateCharacter, Render, StateFrame, Video
from shared.protocol.transport import ServiceClient
from tests.tracker_service.support import standing_plan, step
from tracker_service.rendering import render
from tracker_service.rendering.drawn import draw_frames
from tracker_service.rendering.render import Backend, RenderingError, VideoRenderer
from tracker_service.rendering.render_worker import with_captions
from tracker_service.rendering.scene_shapes import OBJECT_RGBA, SceneShape
from tracker_service.rendering.shadows import floor_projection
from tracker_service.rendering.video_job import VideoJob, camera_path, load_job, save_job


def job(frames: int = 6, **changes: object) -> VideoJob:
    positions = standing_plan(frames, sway_rad=0.8)
    quats = np.tile(quat_from_matrix(np.eye(3)), (frames, 22, 1))
    poses = np.tile([0.8, 0.5, 0.2, 1.0, 0.0, 0.0, 0.0], (frames, 1, 1))
    values: dict[str, object] = {
        "body_pos_w_m": positions, "body_quat_w": quats, "object_pose_w": poses, "objects": ("crate",),
        "shapes": (SceneShape("crate", "box", (0.2, 0.2, 0.2)),), "width": 160, "height": 120,
    }  # fmt: skip
    return VideoJob(**{**values, **changes})  # type: ignore[arg-type]


def frames_of(mp4: bytes, folder: Path) -> npt.NDArray[np.uint8]:
    path = folder / "video.mp4"
    path.write_bytes(mp4)
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    return np.stack([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader])


def test_a_job_survives_its_journey(tmp_path: Path) -> None:
    sent = job(captions=((0, "hello"), (3, "")), camera="side")
    save_job(sent, tmp_path)
    got = load_job(tmp_path)
    assert (got.shapes, got.captions, got.objects, got.camera) == (sent.shapes, sent.captions, sent.objects, "side")
    np.testing.assert_array_equal(got.body_pos_w_m, sent.body_pos_w_m)
    assert [got.caption_at(t) for t in (0, 2, 3)] == ["hello", "hello", ""]


@pytest.mark.parametrize("backend", ["any", "drawn"])
def test_video_shows_moving_arms_and_captions(backend: str, tmp_path: Path) -> None:
    chosen: tuple[Backend, ...] = ("drawn",) if backend == "drawn" else ("egl", "osmesa", "drawn")
    video = VideoRenderer(chosen).render(job(captions=((3, "a person waves"),)))
    assert backend == "any" or (video.renderer == "drawn" and "libegl1" in (video.note or ""))
    frames = frames_of(video.mp4, tmp_path).astype(int)
    assert frames.shape == (6, 120, 160, 3)
    assert np.abs(frames[4] - frames[0])[:95].max() > 40, "the arms swing"
    caption = frames[:, 104:114, 70:90].mean(axis=(1, 2, 3))
    assert caption[:3].min() > caption[4:].max() + 30, "the caption's dark box is there from its tick on"


def test_without_any_graphics_library_it_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LD_LIBRARY_PATH", "/nonexistent")
    monkeypatch.setattr(VideoRenderer, "_works", lambda self, backend: False)
    video = VideoRenderer().render(job(2))
    assert video.renderer == "drawn"
    assert video.note == render.INSTALL_NOTE


def test_a_library_that_fails_in_mid_video_falls_back(monkeypatch: pytest.MonkeyPatch) -> None:
    renderer = VideoRenderer(("osmesa", "drawn"))
    monkeypatch.setattr(renderer, "_works", lambda backend: True)
    monkeypatch.setenv("PYTHONSTARTUP", "")
    broken = job(2, shapes=(SceneShape("crate", "teapot", (0.2,)),))
    video = renderer.render(broken)
    assert video.renderer == "drawn"
    assert "osmesa failed" in (video.note or "")


def test_fewer_frames_keep_the_time(tmp_path: Path) -> None:
    half = job(6, fps=15, captions=((6, "late"),))
    assert [half.tick_of(t) for t in range(6)] == [0, 2, 4, 6, 8, 10]
    assert [half.caption_at(t) for t in (2, 3)] == ["", "late"]
    path = tmp_path / "video.mp4"
    path.write_bytes(VideoRenderer(("drawn",)).render(half).mp4)
    assert next(imageio_ffmpeg.read_frames(str(path)))["duration"] == pytest.approx(6 / 15, abs=0.05)


def test_closing_ends_it(tmp_path: Path) -> None:
    renderer = VideoRenderer(("drawn",))
    renderer.close()
    with pytest.raises(RenderingError):
        renderer.render(job(2))


def test_camera_keeps_the_character_in_view() -> None:
    frames = 90
    walk = job(frames)
    moved = walk.body_pos_w_m + np.linspace(0, 4, frames)[:, None, None] * np.array([1.0, 0.0, 0.0])
    for camera in ("follow", "side", "top"):
        lookat, azimuth = camera_path(job(frames, body_pos_w_m=moved, camera=camera))
        assert np.linalg.norm(lookat[:, :2] - moved[:, 0, :2], axis=-1).max() < 0.8
        assert np.abs(np.diff(azimuth)).max() < 0.1


def test_captions_do_not_change_frames_without_text() -> None:
    blank = np.full((120, 160, 3), 200, np.uint8)
    (plain,) = with_captions(job(1), [blank])
    assert (plain[40:] == blank[40:]).all()
    (texted,) = with_captions(job(1, captions=((0, "x " * 200),)), [blank])
    assert (texted[40:] != blank[40:]).any()


def test_render_over_the_wire(client: ServiceClient) -> None:
    client.ask(CreateCharacter(tracker="pd"), StateFrame, "filmed", timeout_s=20.0)
    step(client, "filmed", 5)
    video = client.ask(Render(width=128, height=96, captions=[(0, "hi")]), Video, "filmed", timeout_s=120.0)
    assert video.mp4[4:8].tobytes() == b"ftyp"


def test_a_shadow_lies_on_the_floor_along_the_light() -> None:
    x, y, z = floor_projection((0.5, -0.25, -1.0)) @ np.array([1.0, 2.0, 2.0])
    np.testing.assert_allclose([x, y], [2.0, 1.5])
    assert 0 < z < 0.01


def test_objects_are_drawn_too_and_hide_what_is_behind_them() -> None:
    seen = []
    for place in ([1.2, 0.9, 0.2, 1, 0, 0, 0], [50.0, 0.0, 0.2, 1, 0, 0, 0]):
        frame = next(draw_frames(job(object_pose_w=np.tile(place, (6, 1, 1)))))
        red, green, blue = (round(255 * c) for c in OBJECT_RGBA[:3])
        seen.append(int((frame == [red, green, blue]).all(axis=-1).sum()))
    assert seen[0] > 100
    assert seen[0] > 10 * seen[1]
