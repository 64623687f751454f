"""A mannequin to look at: a MuJoCo scene without physics whose bodies are put where the log says.

It is separate from the physics humanoid, so that a video shows recorded body poses exactly and any character with the
same skeleton can be drawn. Lengths come from the skeleton, girths from its stature.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import numpy.typing as npt

from shared.motion.skeleton import Skeleton
from tracker_service.simulation.scene_shapes import SceneShape, Vec

KEY_LIGHT = "key"
KEY_LIGHT_DIR = (-0.45, 0.35, -0.85)
BODY_RGBA = (0.86, 0.80, 0.71, 1.0)
LEFT_RGBA = (0.32, 0.55, 0.70, 1.0)
RIGHT_RGBA = (0.80, 0.47, 0.34, 1.0)
JOINT_RGBA = (0.25, 0.26, 0.30, 1.0)


_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
}

# Outlines of limb segments: (place along the segment, radius as a fraction of stature), by the joint they begin at.
_OUTLINES: dict[str, tuple[tuple[float, float], ...]] = {
    "hip": ((0.0, 0.043), (0.12, 0.047), (0.35, 0.044), (0.7, 0.034), (0.9, 0.029), (1.0, 0.028)),
    "knee": ((0.0, 0.028), (0.12, 0.029), (0.3, 0.034), (0.5, 0.030), (0.8, 0.020), (1.0, 0.019)),
    "shoulder": ((0.0, 0.028), (0.15, 0.029), (0.45, 0.026), (0.8, 0.021), (1.0, 0.020)),
    "elbow": ((0.0, 0.020), (0.2, 0.023), (0.5, 0.020), (0.85, 0.014), (1.0, 0.013)),
    "collar": ((0.0, 0.034), (0.5, 0.034), (1.0, 0.030)),
    "neck": ((0.0, 0.032), (0.5, 0.029), (1.15, 0.029)),
}
# Ellipsoids of trunk and head by joint: centre, half sizes (fractions of stature), material.
_TRUNK: dict[str, tuple[tuple[Vec, Vec, str], ...]] = {
    "pelvis": (((-0.002, 0, -0.008), (0.062, 0.096, 0.060), "joint"), ((0.0, 0, 0.032), (0.057, 0.086, 0.058), "body")),
    "spine1": (((0.002, 0, 0.030), (0.055, 0.080, 0.070), "body"),),
    "spine2": (((0.005, 0, 0.020), (0.060, 0.088, 0.078), "body"),),
    "spine3": (((0.0, 0, 0.040), (0.065, 0.102, 0.085), "body"),),
    "head": (((0.006, 0, 0.046), (0.052, 0.044, 0.063), "body"), ((0.049, 0, 0.054), (0.011, 0.032, 0.010), "joint")),
}
_EXTENT_M = 2.5


def mannequin_model(
    skeleton: Skeleton,
    shapes: Sequence[SceneShape] = (),
    *,
    width: int = 640,
    height: int = 480,
) -> mujoco.MjModel:
    """Model with one mocap body a joint (named as the joint), one a scene object, a checkered floor and lights."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0.0, 0.0, 0.0]
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = 40.0
    visual.quality.numslices, visual.quality.numstacks = 20, 10  # vertices cost time without a graphics card
    visual.quality.offsamples = 0  # several samples a pixel double the time of software rendering
    visual.map.znear, visual.map.zfar = 0.02, 30.0
    spec.stat.extent, spec.stat.center = _EXTENT_M, [0.0, 0.0, 1.0]
    visual.headlight.ambient = [0.32, 0.32, 0.34]
    visual.headlight.diffuse = [0.18, 0.18, 0.18]
    visual.headlight.specular = [0.0, 0.0, 0.0]
    visual.rgba.haze = [0.83, 0.87, 0.91, 1.0]
    _backdrop(spec)
    world = spec.worldbody
    world.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.25], material="floor", contype=0, conaffinity=0
    )
    world.add_light(
        name=KEY_LIGHT, type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 6], dir=list(KEY_LIGHT_DIR),
        castshadow=False, diffuse=[0.72, 0.69, 0.64], specular=[0.18, 0.18, 0.18], ambient=[0, 0, 0],
    )  # fmt: skip
    world.add_light(
        name="fill", type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 6], dir=[0.6, -0.5, -0.6],
        castshadow=False, diffuse=[0.22, 0.24, 0.28], specular=[0, 0, 0], ambient=[0, 0, 0],
    )  # fmt: skip
    for joint, name in enumerate(skeleton.names):
        body = world.add_body(name=name, mocap=True, pos=skeleton.rest_positions_m[joint].tolist())
        _dress(spec, body, skeleton, joint)
    _add_objects(spec, shapes)
    return spec.compile()


def _backdrop(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.70, 0.79, 0.88], rgb2=[0.93, 0.94, 0.95], width=256, height=256,
    )  # fmt: skip
    spec.add_texture(
        name="grid", type=mujoco.mjtTexture.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE, rgb1=[0.67, 0.70, 0.73], rgb2=[0.60, 0.63, 0.67],
        markrgb=[0.80, 0.82, 0.85], width=512, height=512,
    )  # fmt: skip
    floor = spec.add_material(name="floor", texrepeat=[1, 1], texuniform=True, reflectance=0.0, specular=0.1)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    for name, rgba in (("body", BODY_RGBA), ("left", LEFT_RGBA), ("right", RIGHT_RGBA), ("joint", JOINT_RGBA)):
        spec.add_material(name=name, rgba=list(rgba), specular=0.25, shininess=0.35)


def _geom(body: mujoco.MjsBody, kind: str, size: Vec, pos: npt.ArrayLike, material: str, quat: Vec = ()) -> None:
    """One geom; missing half sizes are zero."""
    full = [*size, 0.0, 0.0, 0.0][:3]
    body.add_geom(
        type=_KINDS[kind], size=full, pos=np.asarray(pos, dtype=float).tolist(),
        quat=list(quat or (1.0, 0.0, 0.0, 0.0)), material=material, contype=0, conaffinity=0,
    )  # fmt: skip


def _segment(spec: mujoco.MjSpec, body: mujoco.MjsBody, end_m: npt.NDArray[np.float64], part: str, scale: float) -> str:
    """Add the mesh of a limb from the body's origin to `end_m` (a surface of revolution with round ends); its name."""
    length = float(np.linalg.norm(end_m))
    places, radii = np.array(_OUTLINES[part]).T
    along = np.linspace(places[0], places[-1], 13)
    radius = np.interp(along, places, radii) * scale
    cap = np.linspace(0.0, np.pi / 2, 6)[1:]
    x = np.concatenate([(along[0] * length - radius[0] * np.sin(cap))[::-1], along * length,
                        along[-1] * length + radius[-1] * np.sin(cap)])  # fmt: skip
    r = np.concatenate([(radius[0] * np.cos(cap))[::-1], radius, radius[-1] * np.cos(cap)])
    vertices, normals, faces = _revolve(x, np.maximum(r, 1e-5), end_m / length)
    name = f"{body.name}_mesh"
    mesh = spec.add_mesh(name=name)
    mesh.uservert, mesh.usernormal = vertices.ravel().tolist(), normals.ravel().tolist()
    mesh.userface = mesh.userfacenormal = faces.ravel().tolist()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return name


def _revolve(
    x: npt.NDArray[np.float64], r: npt.NDArray[np.float64], axis: npt.NDArray[np.float64], around: int = 14
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Vertices and normals (len(x) * around, 3) and triangles of the outline r(x) turned about `axis`."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    u = np.cross(axis, helper)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle = np.arange(around) * (2 * np.pi / around)
    radial = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v
    slope_x, slope_r = np.gradient(x), np.gradient(r)
    normals = slope_x[:, None, None] * radial - slope_r[:, None, None] * axis
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    vertices = x[:, None, None] * axis + r[:, None, None] * radial
    ring, spoke = np.meshgrid(np.arange(len(x) - 1), np.arange(around), indexing="ij")
    a, b = ring * around + spoke, ring * around + (spoke + 1) % around
    faces = np.concatenate([np.stack([a, b, a + around], -1), np.stack([b, b + around, a + around], -1)])
    return vertices.reshape(-1, 3), normals.reshape(-1, 3), faces.reshape(-1, 3)


def _dress(spec: mujoco.MjSpec, body: mujoco.MjsBody, skeleton: Skeleton, joint: int) -> None:
    """Give the body of one joint its shapes, in the T-pose frame (X forward, Y left, Z up)."""
    name, h = skeleton.names[joint], skeleton.height_m
    side = name.partition("_")[0]
    part = name.removeprefix("left_").removeprefix("right_")
    material = side if side in ("left", "right") else "body"
    if part in _OUTLINES:
        end = skeleton.offsets_m[skeleton.children(joint)[0]]
        mesh = _segment(spec, body, end, part, h)
        colour = {"collar": "body", "neck": "joint"}.get(part, material)
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, material=colour, contype=0, conaffinity=0)
    if part in ("hip", "knee", "shoulder", "elbow"):
        _geom(body, "sphere", (_OUTLINES[part][0][1] * 1.08 * h,), (0, 0, 0), "joint")
    elif part == "ankle":
        _dress_foot(body, skeleton, joint, material)
    elif part == "foot":
        length, drop = 0.036 * h, -0.0095 * h
        _geom(body, "box", (length / 2, 0.026 * h, 0.0085 * h), (length / 2 - 0.002, 0, drop), material)
        _geom(body, "cylinder", (0.026 * h, 0.0085 * h), (length - 0.002, 0, drop), material)
    elif part == "wrist":
        out = float(np.sign(skeleton.offsets_m[joint][1]))
        _geom(body, "ellipsoid", (0.024 * h, 0.050 * h, 0.013 * h), (0, out * 0.042 * h, 0), material)
        _geom(body, "sphere", (0.0165 * h,), (0, 0, 0), "joint")
    elif part in _TRUNK:
        for (x, y, z), size, colour in _TRUNK[part]:
            _geom(body, "ellipsoid", (size[0] * h, size[1] * h, size[2] * h), (x * h, y * h, z * h), colour)


def _dress_foot(body: mujoco.MjsBody, skeleton: Skeleton, joint: int, material: str) -> None:
    """Heel and instep: from the heel behind the ankle to the ball of the foot."""
    h = skeleton.height_m
    toe = skeleton.offsets_m[skeleton.children(joint)[0]]
    sole = toe[2] - 0.018 * h
    heel = -0.030 * h
    thick = 0.0125 * h
    middle = ((toe[0] + heel) / 2, 0.0, sole + thick)
    _geom(body, "box", ((toe[0] - heel) / 2, 0.026 * h, thick), middle, material)
    _geom(body, "cylinder", (0.026 * h, thick), (heel, 0.0, sole + thick), material)
    top = np.array([toe[0] * 0.72, 0.0, sole + 2.0 * thick])
    body.add_geom(
        type=_KINDS["capsule"], fromto=[0, 0, 0, *top.tolist()], size=[0.0225 * h, 0, 0], material=material,
        contype=0, conaffinity=0,
    )  # fmt: skip
    _geom(body, "sphere", (0.024 * h,), (0, 0, 0), "joint")


def _add_objects(spec: mujoco.MjSpec, shapes: Sequence[SceneShape]) -> None:
    bodies: dict[str, mujoco.MjsBody] = {}
    for shape in shapes:
        if shape.body is None:
            parent = spec.worldbody
        elif shape.body in bodies:
            parent = bodies[shape.body]
        else:
            parent = bodies[shape.body] = spec.worldbody.add_body(name=f"object:{shape.body}", mocap=True)
        parent.add_geom(
            type=_KINDS[shape.kind], size=[*shape.size_m, 0.0, 0.0, 0.0][:3], pos=list(shape.pos_b_m),
            quat=list(shape.quat_b), rgba=list(shape.rgba), contype=0, conaffinity=0,
        )  # fmt: skip
