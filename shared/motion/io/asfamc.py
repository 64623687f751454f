"""ASF + AMC: Acclaim skeletons (CMU, HDM05) and their motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from shared.errors import InvalidInputError
from shared.motion.io.bvh import assemble
from shared.motion.io.raw import Array, RawMotion, compose, euler_matrix

_INCH_M = 0.0254


@dataclass
class _Bone:
    direction: Array
    length: float
    axis: Array
    dof: list[str]


def _axis_matrix(angles_deg: Array, order: str) -> Array:
    """Rotation of an ASF axis statement: 'XYZ' turns about X first, so the product runs the other way round."""
    order = order.lower()
    return euler_matrix(order[::-1], np.radians(np.asarray(angles_deg)[..., ::-1]))


def _read_asf(path: Path) -> tuple[dict[str, _Bone], list[tuple[str, str]], float, list[str], Array]:
    """Bones by name, (child, parent) pairs in order, metres per unit, the root's channels and its axis matrix."""
    bones: dict[str, _Bone] = {}
    links: list[tuple[str, str]] = []
    unit = 1.0
    root_order = ["tx", "ty", "tz", "rx", "ry", "rz"]
    root_axis = np.eye(3)
    section = ""
    name, bone = "", _Bone(np.zeros(3), 0.0, np.eye(3), [])
    axis_order, orientation = "XYZ", np.zeros(3)
    for line in path.read_text(encoding="latin-1").splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0].startswith(":"):
            section = words[0][1:].lower()
            continue
        key = words[0].lower()
        if section == "units" and key == "length":
            unit = _INCH_M / float(words[1])
        elif section == "root":
            if key == "order":
                root_order = [w.lower() for w in words[1:]]
            elif key == "axis":
                axis_order = words[1]
            elif key == "orientation":
                orientation = np.array([float(w) for w in words[1:4]])
            root_axis = _axis_matrix(orientation, axis_order)
        elif section == "bonedata":
            if key == "begin":
                bone = _Bone(np.zeros(3), 0.0, np.eye(3), [])
            elif key == "name":
                name = words[1]
            elif key == "direction":
                bone.direction = np.array([float(w) for w in words[1:4]])
            elif key == "length":
                bone.length = float(words[1])
            elif key == "axis":
                bone.axis = _axis_matrix(np.array([float(w) for w in words[1:4]]), words[4])
            elif key == "dof":
                bone.dof = [w.lower() for w in words[1:]]
            elif key == "end":
                bones[name] = bone
        elif section == "hierarchy" and key not in ("begin", "end"):
            links.extend((child, words[0]) for child in words[1:])
    if not bones or not links:
        raise InvalidInputError(f"{path.name}: not an ASF skeleton", field="asf")
    return bones, links, unit, root_order, root_axis


def _read_amc(path: Path) -> dict[str, Array]:
    """Values per bone, (T, channels)."""
    values: dict[str, list[list[float]]] = {}
    frames = 0
    for line in path.read_text(encoding="latin-1").splitlines():
        words = line.split()
        if not words or words[0][0] in "#:":
            continue
        if len(words) == 1 and words[0].isdigit():
            frames += 1
        else:
            values.setdefault(words[0], []).append([float(w) for w in words[1:]])
    if frames == 0 or any(len(v) != frames for v in values.values()):
        raise InvalidInputError(f"{path.name}: frames are missing values", field="amc")
    return {name: np.array(rows) for name, rows in values.items()}


def read_asf_amc(asf: str | Path, amc: str | Path, fps: float, unit_m: float | None = None) -> RawMotion:
    """Read an ASF skeleton and one AMC motion of it. Joint `x` is the far end of the bone `x`; `root` the root.

    Args:
        asf: skeleton file; Y up.
        amc: motion file; it carries no rate.
        fps: its frames per second.
        unit_m: metres per unit; None takes 0.0254 m over the ASF's `length` unit (CMU, HDM05: 0.45 inch).

    Raises:
        InvalidInputError: a malformed file, or a skeleton without recognisable legs.
    """
    asf, amc = Path(asf), Path(amc)
    try:
        bones, links, unit, root_order, root_axis = _read_asf(asf)
        motion = _read_amc(amc)
    except (ValueError, IndexError) as error:
        raise InvalidInputError(f"{amc.name}: not readable ASF + AMC ({error})", field="amc") from error
    names = ["root"] + [child for child, _ in links]
    if len(set(names)) != len(names) or any(n not in bones for n in names[1:]):
        raise InvalidInputError(f"{asf.name}: the hierarchy names bones that are not defined", field="asf")
    index = {name: i for i, name in enumerate(names)}
    parents = (-1,) + tuple(index[parent] for _, parent in links)
    if "root" not in motion or any(p >= i for i, p in enumerate(parents)):
        raise InvalidInputError(f"{amc.name}: no root, or bones out of order", field="amc")
    frames = len(motion["root"])

    # The far end of bone x moves with x's own rotation, while in a joint tree it would move with its parent's:
    # so the rotation of x is applied first and its end is placed with it.
    root = motion["root"]
    place = {c: root[:, i] for i, c in enumerate(root_order)}
    position = np.stack([place["tx"], place["ty"], place["tz"]], axis=-1)
    turn = [c for c in root_order if c[0] == "r"]
    rotation = euler_matrix("".join(c[1] for c in turn)[::-1], np.radians(np.stack([place[c] for c in turn[::-1]], -1)))
    local = np.broadcast_to(np.eye(3), (frames, len(names), 3, 3)).copy()
    local[:, 0] = root_axis @ rotation @ root_axis.T
    offsets = np.zeros((len(names), 3))
    for name, i in index.items():
        if name == "root":
            continue
        bone = bones[name]
        offsets[i] = bone.direction * bone.length
        dof = [d for d in bone.dof if d[0] == "r"]
        if name in motion and dof:
            columns = [bone.dof.index(d) for d in dof]
            angles = np.radians(motion[name][:, columns])
            m = euler_matrix("".join(d[1] for d in dof)[::-1], angles[:, ::-1])
            local[:, i] = bone.axis @ m @ bone.axis.T
    _, world = compose(parents, offsets, position, local)
    positions = np.empty((frames, len(names), 3))
    positions[:, 0] = position
    for i in range(1, len(names)):
        positions[:, i] = positions[:, parents[i]] + world[:, i] @ offsets[i]
    return assemble(
        tuple(names), parents, offsets, positions, world, fps, str(amc), "y", unit if unit_m is None else unit_m
    )
