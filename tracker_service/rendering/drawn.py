"""The skeleton drawn without any graphics library: a pin-hole camera, a floor grid, shaded limbs, by Pillow."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from shared.motion.mesh import box, capsule, cylinder, ellipsoid
from shared.motion.rotations import matrix_from_quat
from shared.motion.skeleton import Skeleton, skeleton
from tracker_service.rendering.scene_shapes import SceneShape
from tracker_service.rendering.video_job import VideoJob, camera_distance_m, camera_path

FloatArray = npt.NDArray[np.floating]
Frame = npt.NDArray[np.uint8]
Rgb = tuple[int, int, int]

_BACKGROUND: Rgb = (222, 229, 236)
_GRID: Rgb = (190, 197, 205)
_SHADOW: Rgb = (170, 176, 184)
_COLOURS: dict[str, Rgb] = {"left": (82, 140, 178), "right": (204, 120, 87), "mid": (150, 140, 125)}
_NEAR_M = 0.1


class _Camera:
    """Pin-hole camera at `distance_m` from `lookat`, looking along `azimuth` and `elevation` (radians)."""

    def __init__(self, lookat: FloatArray, azimuth: float, elevation: float, distance_m: float, size: tuple[int, int]):
        ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
        self.forward = np.array([ca * ce, sa * ce, se])
        self.right = np.array([sa, -ca, 0.0])
        self.up = np.cross(self.right, self.forward)
        self.eye = lookat - distance_m * self.forward
        self.focal = 0.5 * size[1] / np.tan(np.deg2rad(20.0))
        self.centre = (size[0] / 2, size[1] / 2)

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (..., 2) and depths (...) of world points (..., 3)."""
        rel = points - self.eye
        depth = rel @ self.forward
        safe = np.maximum(depth, _NEAR_M)
        x = self.centre[0] + self.focal * (rel @ self.right) / safe
        y = self.centre[1] - self.focal * (rel @ self.up) / safe
        return np.stack([x, y], axis=-1), depth


def draw_frames(job: VideoJob) -> Iterator[Frame]:
    """(height, width, 3) uint8 frames of the job, without captions."""
    bones = skeleton(job.skeleton_id)
    lookat, azimuth = camera_path(job)
    elevation, distance = np.deg2rad(-89.0 if job.camera == "top" else -14.0), camera_distance_m(job)
    solids = [(shape, _corners(shape)) for shape in job.shapes]
    for t in range(len(job.body_pos_w_m)):
        camera = _Camera(lookat[t], float(azimuth[t]), float(elevation), distance, (job.width, job.height))
        poses = dict(zip(job.objects, job.object_pose_w[t].astype(np.float64), strict=True))
        placed = [(_placed(corners, poses.get(shape.body or "")), shape.rgba) for shape, corners in solids]
        yield _draw(bones, job.body_pos_w_m[t].astype(np.float64), placed, camera, job)


def _corners(shape: SceneShape) -> FloatArray:
    """(V, 3) points of a shape's surface in its object's frame."""
    size = shape.size_m
    if shape.kind == "box":
        points = box(size).vertices_m
    elif shape.kind == "cylinder":
        points = cylinder(size[0], size[1]).vertices_m
    elif shape.kind == "capsule":
        points = capsule(size[0], (0.0, 0.0, -size[1]), (0.0, 0.0, size[1])).vertices_m
    else:
        points = ellipsoid(size if shape.kind == "ellipsoid" else size * 3).vertices_m
    return points @ matrix_from_quat(np.array(shape.quat_b)).T + np.array(shape.pos_b_m)


def _placed(points: FloatArray, pose_w: FloatArray | None) -> FloatArray:
    """Points of an object in the world; pose_w (7,), None for what is fixed in the world."""
    if pose_w is None:
        return points
    return points @ matrix_from_quat(pose_w[3:]).T + pose_w[:3]


def _hull(points: FloatArray) -> list[tuple[float, float]]:
    """Corners of the convex hull of points (N, 2), by Andrew's monotone chain."""
    ordered = sorted({(float(x), float(y)) for x, y in points})

    def chain(way: list[tuple[float, float]]) -> list[tuple[float, float]]:
        out: list[tuple[float, float]] = []
        for x, y in way:
            while len(out) > 1:
                (ax, ay), (bx, by) = out[-2], out[-1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                out.pop()
            out.append((x, y))
        return out[:-1]

    return chain(ordered) + chain(ordered[::-1])


def _draw(
    bones: Skeleton,
    joints: FloatArray,
    solids: list[tuple[FloatArray, tuple[float, ...]]],
    camera: _Camera,
    job: VideoJob,
) -> Frame:
    image = Image.new("RGB", (job.width, job.height), _BACKGROUND)
    pen = ImageDraw.Draw(image)
    _draw_floor(pen, camera, joints[0])
    flat = joints * np.array([1.0, 1.0, 0.0])
    pixels, depth = camera.project(flat)
    for child in range(1, len(bones)):
        _limb(pen, pixels, depth, bones.parents[child], child, camera.focal, _SHADOW)
    body_m = float(camera.project(joints[0])[1])
    hulls = sorted(((camera.project(points), rgba) for points, rgba in solids), key=lambda h: -float(h[0][1].mean()))
    for (outline, depths), rgba in hulls:
        if depths.mean() > body_m:
            _solid(pen, outline, depths, rgba)
    pixels, depth = camera.project(joints)
    order = sorted(range(1, len(bones)), key=lambda j: -float(depth[j]))
    for child in order:
        side = bones.names[child].partition("_")[0]
        _limb(pen, pixels, depth, bones.parents[child], child, camera.focal, _COLOURS.get(side, _COLOURS["mid"]))
    head = bones.index("head")
    if depth[head] > _NEAR_M:
        radius = 0.11 * camera.focal / depth[head]
        x, y = pixels[head] - np.array([0.0, 0.06 * camera.focal / depth[head]])
        pen.ellipse([x - radius, y - radius, x + radius, y + radius], fill=_COLOURS["mid"])
    for (outline, depths), rgba in hulls:
        if depths.mean() <= body_m:
            _solid(pen, outline, depths, rgba)
    return np.asarray(image, dtype=np.uint8)


def _solid(pen: ImageDraw.ImageDraw, pixels: FloatArray, depth: FloatArray, rgba: tuple[float, ...]) -> None:
    """The silhouette of a solid from its projected points."""
    if float(depth.min()) > _NEAR_M:
        red, green, blue = (round(255 * c) for c in rgba[:3])
        edge = (red * 2 // 3, green * 2 // 3, blue * 2 // 3)
        pen.polygon(_hull(pixels), fill=(red, green, blue), outline=edge)


def _limb(
    pen: ImageDraw.ImageDraw, pixels: FloatArray, depth: FloatArray, a: int, b: int, focal: float, colour: Rgb
) -> None:
    if min(depth[a], depth[b]) <= _NEAR_M:
        return
    width = max(2, round(0.075 * focal / float(depth[b])))
    pen.line([tuple(pixels[a]), tuple(pixels[b])], fill=colour, width=width)
    for joint in (a, b):
        x, y = pixels[joint]
        pen.ellipse([x - width / 2, y - width / 2, x + width / 2, y + width / 2], fill=colour)


def _draw_floor(pen: ImageDraw.ImageDraw, camera: _Camera, root: FloatArray) -> None:
    """Lines a metre apart around the character, cut at the camera's plane."""
    span = 8
    x0, y0 = np.floor(root[0]), np.floor(root[1])
    for k in range(-span, span + 1):
        for ends in (
            ([x0 + k, y0 - span, 0.0], [x0 + k, y0 + span, 0.0]),
            ([x0 - span, y0 + k, 0.0], [x0 + span, y0 + k, 0.0]),
        ):
            line = np.linspace(np.array(ends[0]), np.array(ends[1]), 2 * span + 1)
            pixels, depth = camera.project(line)
            for i in range(len(line) - 1):
                if depth[i] > _NEAR_M and depth[i + 1] > _NEAR_M:
                    pen.line([tuple(pixels[i]), tuple(pixels[i + 1])], fill=_GRID, width=1)
