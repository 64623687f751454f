"""A mannequin to look at: a MuJoCo scene without physics whose bodies are put where the log says.

It is separate from the physics humanoid, so that a video shows recorded body poses exactly and any character with the
same skeleton can be drawn. Lengths come from the skeleton, girths from its stature.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco

from shared.motion.figure import COLOURS, Part, parts_of
from shared.motion.skeleton import Skeleton
from tracker_service.rendering.scene_shapes import SceneShape

KEY_LIGHT = "key"
KEY_LIGHT_DIR = (-0.45, 0.35, -0.85)

_KINDS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
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
    for name, rgba in COLOURS.items():
        spec.add_material(name=name, rgba=list(rgba), specular=0.25, shininess=0.35)


def _dress(spec: mujoco.MjSpec, body: mujoco.MjsBody, skeleton: Skeleton, joint: int) -> None:
    """Give the body of one joint its shapes, in the T-pose frame (X forward, Y left, Z up)."""
    for part in parts_of(skeleton, joint):
        if part.kind == "limb":
            mesh = _limb_mesh(spec, body.name, part)
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh, material=part.colour, contype=0, conaffinity=0
            )
        elif part.kind == "capsule":
            body.add_geom(
                type=_KINDS[part.kind], fromto=[0, 0, 0, *part.end_m], size=[*part.size_m, 0.0, 0.0],
                material=part.colour, contype=0, conaffinity=0,
            )  # fmt: skip
        else:
            body.add_geom(
                type=_KINDS[part.kind], size=[*part.size_m, 0.0, 0.0][:3], pos=list(part.position_m),
                material=part.colour, contype=0, conaffinity=0,
            )  # fmt: skip


def _limb_mesh(spec: mujoco.MjSpec, body: str, part: Part) -> str:
    """Add the mesh of a limb; its name."""
    triangles = part.mesh()
    name = f"{body}_mesh"
    mesh = spec.add_mesh(name=name)
    mesh.uservert, mesh.usernormal = triangles.vertices_m.ravel().tolist(), triangles.normals.ravel().tolist()
    mesh.userface = mesh.userfacenormal = triangles.faces.ravel().tolist()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return name


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
