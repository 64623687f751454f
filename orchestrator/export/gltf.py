"""A recording as glTF 2.0 binary (.glb): our mannequin, one node a joint, and the scene's objects, animated at 30 Hz.

glTF is Y up with metres; a model's front is +Z. So glTF's x is our Y (left), its y our Z (up), its z our X (forward):
a cyclic exchange of axes, written into the numbers. Source: glTF 2.0 specification, Khronos Group, 3.4 and 4.4.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from orchestrator.store.recordings import Recording
from shared.motion.figure import COLOURS, parts_of
from shared.motion.mesh import Mesh, box, capsule, cylinder, ellipsoid, joined
from shared.motion.rotations import matrix_from_quat, normalize, quat_conj, quat_mul
from shared.motion.skeleton import Skeleton
from shared.protocol.messages import TICK_HZ
from shared.scenes.schema import Part, SceneBody

Array = npt.NDArray[np.float64]
AXES = [1, 2, 0]
"""glTF's x, y, z are these of ours."""
OBJECT, OBJECT_RGBA = "object", (0.62, 0.45, 0.34, 1.0)
_FLOAT, _UINT32 = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
_WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def to_glb(recording: Recording) -> bytes:
    """The file's bytes.

    Args:
        recording: its first tick is second 0 of the animation; objects that are not in its scene are left out.
    """
    skeleton, scene = recording.skeleton, recording.scene
    file = _File()
    for name, rgba in (*COLOURS.items(), (OBJECT, OBJECT_RGBA)):
        file.material(name, rgba)
    bodies = () if scene is None else scene.bodies
    for colour in sorted({part.colour for body in bodies for part in body.parts if part.colour is not None}):
        file.material(_paint(colour), (*colour, 1.0))
    times = file.accessor(np.arange(len(recording)) / TICK_HZ, "SCALAR", bounds=True)
    positions = np.asarray(recording.arrays["body_pos_w_m"], dtype=np.float64)
    quats = normalize(recording.arrays["body_quat_w"])
    roots = [_add_character(file, skeleton, positions, quats, times)]
    shapes = {body.name: body for body in bodies}
    poses = np.asarray(recording.arrays["object_pose_w"], dtype=np.float64)
    for index, name in enumerate(recording.objects):
        if name in shapes:
            roots.append(_add_object(file, shapes[name], poses[:, index], times))
    return file.glb(roots, {"fps": TICK_HZ, "start_tick": recording.start_tick, "skeleton": skeleton.id})


def _add_character(file: _File, skeleton: Skeleton, pos_w_m: Array, quat_w: Array, times: int) -> int:
    first = len(file.nodes)
    for joint, name in enumerate(skeleton.names):
        parent = skeleton.parents[joint]
        turn = quat_w[:, joint] if parent < 0 else quat_mul(quat_conj(quat_w[:, parent]), quat_w[:, joint])
        turns = _gltf_quats(turn)
        node: dict[str, Any] = {"name": name, "rotation": turns[0].tolist()}
        meshes: dict[str, list[Mesh]] = {}
        for part in parts_of(skeleton, joint):
            meshes.setdefault(part.colour, []).append(part.mesh())
        if meshes:
            node["mesh"] = file.mesh(name, {colour: joined(solids) for colour, solids in meshes.items()})
        children = [first + child for child in skeleton.children(joint)]
        if children:
            node["children"] = children
        if parent < 0:
            node["translation"] = pos_w_m[0, joint, AXES].tolist()
            file.animate(len(file.nodes), "translation", times, pos_w_m[:, joint][:, AXES])
        else:
            node["translation"] = skeleton.offsets_m[joint, AXES].tolist()
        file.animate(len(file.nodes), "rotation", times, turns)
        file.nodes.append(node)
    return first


def _add_object(file: _File, body: SceneBody, pose_w: Array, times: int) -> int:
    """A scene object; pose_w (T, 7) position and quaternion."""
    number = len(file.nodes)
    solids: dict[str, list[Mesh]] = {}
    for part in body.parts:
        solids.setdefault(_paint(part.colour), []).append(_solid(part))
    places, turns = pose_w[:, :3][:, AXES], _gltf_quats(normalize(pose_w[:, 3:]))
    mesh = file.mesh(body.name, {paint: joined(meshes) for paint, meshes in solids.items()})
    node = {"name": body.name, "mesh": mesh, "translation": places[0].tolist(), "rotation": turns[0].tolist()}
    file.nodes.append(node)
    file.animate(number, "translation", times, places)
    file.animate(number, "rotation", times, turns)
    return number


def _solid(part: Part) -> Mesh:
    """A part in its body's frame."""
    size = part.size_m
    if part.shape == "box":
        solid = box(size)
    elif part.shape == "sphere":
        solid = ellipsoid(size * 3)
    elif part.shape == "cylinder":
        solid = cylinder(size[0], size[1])
    else:
        solid = capsule(size[0], (0.0, 0.0, -size[1]), (0.0, 0.0, size[1]))
    return solid.turned(matrix_from_quat(np.array(part.quat_b))).moved(part.position_b_m)


def _paint(colour: tuple[float, float, float] | None) -> str:
    """Name of the material of a colour."""
    return OBJECT if colour is None else "object_" + "".join(f"{round(255 * c):02x}" for c in colour)


def _gltf_quats(quat: Array) -> Array:
    """(T, 4) wxyz in our axes -> xyzw in glTF's, neighbours on the same side of the sphere."""
    turned = quat[:, [2, 3, 1, 0]]
    flips = np.cumprod(np.where(np.sum(turned[1:] * turned[:-1], axis=-1) < 0, -1.0, 1.0))
    return turned * np.concatenate([[1.0], flips])[:, None]


class _File:
    """A glTF document under construction: its JSON lists and its binary buffer."""

    def __init__(self) -> None:
        self.nodes: list[dict[str, Any]] = []
        self._materials: dict[str, int] = {}
        self._document: dict[str, list[dict[str, Any]]] = {
            name: [] for name in ("materials", "meshes", "accessors", "bufferViews")
        }
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        self._buffer = bytearray()

    def material(self, name: str, rgba: tuple[float, ...]) -> None:
        """Add a matt material of an sRGB colour (glTF wants it linear)."""
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in rgba[:3]]
        look = {"baseColorFactor": [*linear, rgba[3]], "metallicFactor": 0.0, "roughnessFactor": 0.65}
        self._materials[name] = len(self._document["materials"])
        self._document["materials"].append({"name": name, "pbrMetallicRoughness": look})

    def accessor(self, values: npt.NDArray[Any], kind: str, bounds: bool = False, target: int | None = None) -> int:
        """Add numbers (float32, or uint32 for indices); the accessor's number."""
        integers = target == _INDICES
        data = np.ascontiguousarray(values, "<u4" if integers else "<f4").reshape(-1, _WIDTH[kind])
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._buffer), "byteLength": data.nbytes}
        if target is not None:
            view["target"] = target
        self._buffer += data.tobytes()
        entry: dict[str, Any] = {
            "bufferView": len(self._document["bufferViews"]), "count": len(data), "type": kind,
            "componentType": _UINT32 if integers else _FLOAT,
        }  # fmt: skip
        if bounds:
            entry |= {"min": data.min(axis=0).tolist(), "max": data.max(axis=0).tolist()}
        self._document["bufferViews"].append(view)
        self._document["accessors"].append(entry)
        return len(self._document["accessors"]) - 1

    def mesh(self, name: str, solids: dict[str, Mesh]) -> int:
        """Add a mesh of one solid a material; its number."""
        primitives = [
            {
                "attributes": {
                    "POSITION": self.accessor(solid.vertices_m[:, AXES], "VEC3", bounds=True, target=_VERTICES),
                    "NORMAL": self.accessor(solid.normals[:, AXES], "VEC3", target=_VERTICES),
                },
                "indices": self.accessor(solid.faces, "SCALAR", target=_INDICES),
                "material": self._materials[material],
            }
            for material, solid in solids.items()
        ]
        self._document["meshes"].append({"name": name, "primitives": primitives})
        return len(self._document["meshes"]) - 1

    def animate(self, node: int, path: str, times: int, values: Array) -> None:
        """Let a node's translation or rotation follow the values (T, 3 or 4)."""
        output = self.accessor(values, "VEC3" if path == "translation" else "VEC4")
        self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
        self._samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})

    def glb(self, roots: list[int], extras: dict[str, Any]) -> bytes:
        """The whole as GLB: header, JSON chunk, binary chunk."""
        document = {
            "asset": {"version": "2.0", "generator": "motionloop", "extras": extras},
            "scene": 0,
            "scenes": [{"name": "motionloop", "nodes": roots}],
            "nodes": self.nodes,
            **self._document,
            "animations": [{"name": "motion", "samplers": self._samplers, "channels": self._channels}],
            "buffers": [{"byteLength": len(self._buffer)}],
        }
        text = json.dumps(document, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        binary = bytes(self._buffer) + b"\0" * (-len(self._buffer) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(binary), 0x004E4942) + binary
        return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks
