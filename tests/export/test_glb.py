"""glTF read by pygltflib, posed by its own node hierarchy, and compared with the recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pygltflib
import pytest

from orchestrator.client import Motion
from orchestrator.export.gltf import to_glb
from orchestrator.store.recordings import Recording
from shared.motion.figure import COLOURS, parts_of
from shared.motion.ik import standing_clip
from shared.motion.kinematics import forward_kinematics
from shared.motion.mesh import Mesh, box, capsule, cylinder, ellipsoid
from shared.motion.rotations import matrix_from_6d, matrix_from_quat, quat_from_matrix, rotvec_from_matrix
from shared.motion.skeleton import CANONICAL
from shared.scenes.files import parse_scene

GLTF_AXES = [1, 2, 0]
"""glTF's x, y, z are our Y (left), Z (up), X (forward)."""
_WIDTH = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_DTYPE = {pygltflib.FLOAT: "<f4", pygltflib.UNSIGNED_INT: "<u4"}


def numbers(file: pygltflib.GLTF2, index: int) -> np.ndarray:
    """An accessor's numbers, (count, width)."""
    accessor = file.accessors[index]
    view = file.bufferViews[accessor.bufferView]
    width, dtype = _WIDTH[accessor.type], _DTYPE[accessor.componentType]
    blob = file.binary_blob()
    return np.frombuffer(blob, dtype, accessor.count * width, view.byteOffset).reshape(-1, width).astype(np.float64)


class Posed:
    """World transforms of all nodes at a key of the animation."""

    def __init__(self, file: pygltflib.GLTF2):
        self.file = file
        self.moves: dict[tuple[int, str], np.ndarray] = {}
        animation = file.animations[0]
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            self.times = numbers(file, sampler.input)[:, 0]
            self.moves[channel.target.node, channel.target.path] = numbers(file, sampler.output)

    def at(self, key: int) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Name -> position (3,) and rotation (3, 3) in the world."""
        out: dict[str, tuple[np.ndarray, np.ndarray]] = {}

        def visit(index: int, origin: np.ndarray, turn: np.ndarray) -> None:
            node = self.file.nodes[index]
            move = self.moves.get((index, "translation"))
            place = np.array(node.translation) if move is None else move[key]
            x, y, z, w = self.moves[index, "rotation"][key]
            position, rotation = origin + turn @ place, turn @ matrix_from_quat([w, x, y, z])
            out[node.name] = (position, rotation)
            for child in node.children or []:
                visit(child, position, rotation)

        for root in self.file.scenes[self.file.scene].nodes:
            visit(root, np.zeros(3), np.eye(3))
        return out


def test_a_glb_has_the_recordings_positions_and_rotations(folder: Path, motion: Motion) -> None:
    posed = Posed(pygltflib.GLTF2().load(str(folder / "motion.glb")))
    assert np.allclose(posed.times, np.arange(len(motion)) / 30, atol=1e-5)
    for key in (0, len(motion) // 3, len(motion) // 2, len(motion) - 1):
        nodes = posed.at(key)
        assert nodes.keys() == set(motion.joints)
        for joint, name in enumerate(motion.joints):
            position, rotation = nodes[name]
            assert np.linalg.norm(position - motion.positions_w_m[key, joint][GLTF_AXES]) < 0.001, (key, name)
            wanted = matrix_from_quat(motion.quats_w[key, joint])[GLTF_AXES][:, GLTF_AXES]
            assert np.degrees(np.linalg.norm(rotvec_from_matrix(rotation @ wanted.T))) < 0.1, (key, name)


def test_neighbouring_keys_turn_the_short_way(folder: Path) -> None:
    for (_, path), values in Posed(pygltflib.GLTF2().load(str(folder / "motion.glb"))).moves.items():
        if path == "rotation":
            assert np.allclose(np.linalg.norm(values, axis=-1), 1.0, atol=1e-5)
            assert (np.sum(values[1:] * values[:-1], axis=-1) > 0).all()


def test_the_mannequin_stands_on_the_floor_and_is_as_tall_as_the_skeleton(folder: Path) -> None:
    file = pygltflib.GLTF2().load(str(folder / "motion.glb"))
    nodes = Posed(file).at(0)
    points = []
    for node in file.nodes:
        position, rotation = nodes[node.name]
        for primitive in file.meshes[node.mesh].primitives if node.mesh is not None else []:
            vertices = numbers(file, primitive.attributes.POSITION)
            accessor = file.accessors[primitive.attributes.POSITION]
            assert np.allclose(accessor.min, vertices.min(axis=0))
            assert np.allclose(accessor.max, vertices.max(axis=0))
            faces = numbers(file, primitive.indices)
            assert faces.max() < len(vertices)
            points.append(vertices @ rotation.T + position)
    cloud = np.concatenate(points)
    assert abs(cloud[:, 1].min()) < 0.02
    assert cloud[:, 1].max() == pytest.approx(CANONICAL.height_m, abs=0.06)
    assert [m.name for m in file.materials] == [*COLOURS, "object"]
    assert file.asset.extras["fps"] == 30


@pytest.mark.parametrize(
    ("solid", "volume_m3"),
    [
        (box((0.1, 0.2, 0.3)), 8 * 0.1 * 0.2 * 0.3),
        (ellipsoid((0.1, 0.2, 0.3), around=80), 4 / 3 * np.pi * 0.1 * 0.2 * 0.3),
        (cylinder(0.2, 0.5, around=80), np.pi * 0.04 * 1.0),
        (capsule(0.1, (0, 0, -0.2), (0.0, 0.0, 0.3), around=80), np.pi * 0.01 * 0.5 + 4 / 3 * np.pi * 0.001),
    ],
)
def test_solids_are_closed_and_look_outwards(solid: Mesh, volume_m3: float) -> None:
    """By the divergence theorem the signed volume is right only if every triangle is there and faces outwards."""
    a, b, c = (solid.vertices_m[solid.faces[:, i]] for i in range(3))
    assert float(np.sum(a * np.cross(b, c)) / 6) == pytest.approx(volume_m3, rel=0.03)
    outward = np.cross(b - a, c - a)
    large = np.linalg.norm(outward, axis=-1) > 1e-9
    assert (np.sum(outward * solid.normals[solid.faces[:, 0]], axis=-1)[large] > 0).all()
    assert np.allclose(np.linalg.norm(solid.normals, axis=-1), 1.0)


def test_every_part_of_the_mannequin_looks_outwards_and_both_sides_match() -> None:
    for joint, name in enumerate(CANONICAL.names):
        for part in parts_of(CANONICAL, joint):
            solid = part.mesh()
            a, b, c = (solid.vertices_m[solid.faces[:, i]] for i in range(3))
            assert np.sum(a * np.cross(b, c)) / 6 > 1e-6, (name, part.kind)
        other = CANONICAL.mirror_map[joint]
        mine, theirs = ([p.mesh().vertices_m for p in parts_of(CANONICAL, j)] for j in (joint, other))
        for one, two in zip(mine, theirs, strict=True):
            flip = [1.0, -1.0, 1.0]
            assert np.allclose(one.min(axis=0), np.minimum(two.min(axis=0) * flip, two.max(axis=0) * flip), atol=0.002)


def test_objects_of_the_scene_move_as_recorded() -> None:
    scene = parse_scene(
        """
name: two
bodies:
  - name: crate
    mass_kg: 5
    position_w_m: [1, 0, 0.4]
    parts:
      - {shape: box, size_m: [0.2, 0.3, 0.4]}
      - {shape: cylinder, size_m: [0.1, 0.5], position_b_m: [1, 0, 0], rotation_deg: [0, 90, 0], colour: [1, 0, 0]}
  - {name: ball, shape: sphere, size_m: [0.15], mass_kg: 1, position_w_m: [0, 2, 0.15]}
"""
    )
    count = 40
    clip = standing_clip(count, 30)
    _, world = forward_kinematics(CANONICAL, clip.root_pos_w_m, matrix_from_6d(clip.rotations_6d))
    poses = np.zeros((count, 3, 7), "<f4")
    poses[..., 3] = 1.0
    poses[:, 0, 0] = np.linspace(1.0, 2.0, count)
    half = np.linspace(0.0, 4.0, count) / 2
    poses[:, 0, 3], poses[:, 0, 6] = np.cos(half), np.sin(half)
    arrays: dict[str, np.ndarray] = {
        "body_pos_w_m": clip.positions_w_m.astype("<f4"),
        "body_quat_w": quat_from_matrix(world).astype("<f4"),
        "body_linvel_w_mps": np.zeros((count, 22, 3), "<f4"),
        "contacts": np.ones((count, 4), "|u1"),
        "object_pose_w": poses,
        "tracking_error_m": np.zeros(count, "<f4"),
        "fallen": np.zeros(count, "|u1"),
        "reference_pos_w_m": clip.positions_w_m.astype("<f4"),
    }
    data = to_glb(Recording(30, arrays, ("crate", "ball", "gone"), "human", scene))
    file = pygltflib.GLTF2().load_from_bytes(data)
    posed = Posed(file)
    assert {"crate", "ball"} <= posed.at(0).keys()
    assert "gone" not in posed.at(0)
    position, rotation = posed.at(count - 1)["crate"]
    assert np.allclose(position, [0.0, 0.0, 2.0], atol=1e-5)
    # 4 rad about our Z is 4 rad about glTF's Y.
    assert np.allclose(rotation @ [0.0, 0.0, 1.0], [np.sin(4.0), 0.0, np.cos(4.0)], atol=1e-5)
    node = next(node for node in file.nodes if node.name == "crate")
    plain, red = file.meshes[node.mesh].primitives
    assert [file.materials[p.material].name for p in (plain, red)] == ["object", "object_ff0000"]
    points = numbers(file, red.attributes.POSITION)  # in glTF's axes: our Y, Z, X
    assert np.allclose(points.min(axis=0), [-0.1, -0.1, 0.5], atol=2e-3)
    assert np.allclose(points.max(axis=0), [0.1, 0.1, 1.5], atol=2e-3)
    assert file.asset.extras["start_tick"] == 30
