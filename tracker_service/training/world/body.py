"""The body in torch: generalised state, forward kinematics with gradients, mirror images.

Equal to `tracker_service.simulation.kinematics` in numpy (tests/tracker/test_world_body.py). B is the batch, J = 22
bodies, H hinges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from tracker_service.simulation.humanoid import Humanoid

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class State:
    """Generalised coordinates of B humanoids.

    Attributes:
        pos_w_m: (B, 3) of the root. rot_w: (B, 3, 3). hinge_rad: (B, H).
        linvel_w_mps: (B, 3). angvel_b_radps: (B, 3) in the root's frame. rate_radps: (B, H).
    """

    pos_w_m: Tensor
    rot_w: Tensor
    hinge_rad: Tensor
    linvel_w_mps: Tensor
    angvel_b_radps: Tensor
    rate_radps: Tensor

    @classmethod
    def of(cls, qpos: Tensor, qvel: Tensor) -> State:
        """From MuJoCo's qpos (B, 7+H) and qvel (B, 6+H)."""
        return cls(
            qpos[:, :3], matrix_from_quat(qpos[:, 3:7]), qpos[:, 7:], qvel[:, :3], qvel[:, 3:6], qvel[:, 6:]
        )  # fmt: skip

    def parts(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The six tensors, in the order of the attributes."""
        return (
            self.pos_w_m, self.rot_w, self.hinge_rad, self.linvel_w_mps, self.angvel_b_radps, self.rate_radps,
        )  # fmt: skip

    def detached(self) -> State:
        """The same state without its history."""
        return State(*(part.detach() for part in self.parts()))


@dataclass(frozen=True)
class Bodies:
    """World states of all bodies: pos_w_m (B, J, 3), rot_w (B, J, 3, 3), linvel_w_mps (B, J, 3)."""

    pos_w_m: Tensor
    rot_w: Tensor
    linvel_w_mps: Tensor


def square(rows: Tensor) -> Tensor:
    """(..., 9) entries row by row as (..., 3, 3)."""
    return rows.view(*rows.shape[:-1], 3, 3)


def matrix_from_quat(quat: Tensor) -> Tensor:
    """(..., 4) wxyz, normalised here, -> (..., 3, 3)."""
    w, x, y, z = (quat / quat.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return square(torch.stack(rows, -1))


def rotation_of(rotvec: Tensor) -> Tensor:
    """Rotation matrices (B, 3, 3) of rotation vectors (B, 3), Rodrigues."""
    length2 = (rotvec * rotvec).sum(-1)[:, None, None] + 1e-12
    angle = length2.sqrt()
    x, y, z = rotvec.unbind(-1)
    o = torch.zeros_like(x)
    cross = square(torch.stack([o, -z, y, z, o, -x, -y, x, o], -1))
    eye = torch.eye(3, dtype=rotvec.dtype, device=rotvec.device)
    return eye + torch.sin(angle) / angle * cross + (1 - torch.cos(angle)) / length2 * small_matmul(cross, cross)


def small_matmul(a: Tensor, b: Tensor) -> Tensor:
    """a @ b for many small matrices (..., I, K) (..., K, L): sums of products, several times faster than batched BLAS
    on 3 x 3."""
    out = a[..., :, 0:1] * b[..., 0:1, :]
    for k in range(1, a.shape[-1]):
        out = out + a[..., :, k : k + 1] * b[..., k : k + 1, :]
    return out


def rotate(m: Tensor, v: Tensor) -> Tensor:
    """m @ v for matrices (..., 3, 3) and vectors (..., 3)."""
    return m[..., 0] * v[..., 0:1] + m[..., 1] * v[..., 1:2] + m[..., 2] * v[..., 2:3]


def heading_frame(rot_w: Tensor) -> Tensor:
    """(B, 3, 3) whose columns are the heading frame's axes in the world: `row_vector @ it` goes into the frame."""
    forward = rot_w[:, :2, 0]
    c, s = (forward / forward.norm(dim=-1, keepdim=True).clamp(min=1e-6)).unbind(-1)
    o, one = torch.zeros_like(c), torch.ones_like(c)
    return square(torch.stack([c, -s, o, s, c, o, o, o, one], -1))


def into(frame: Tensor, vectors: Tensor) -> Tensor:
    """World vectors (B, N, 3) in the heading frame (B, 3, 3) of `heading_frame`."""
    x, y, z = vectors.unbind(-1)
    c, s = frame[:, 0, 0:1], frame[:, 1, 0:1]
    return torch.stack([c * x + s * y, c * y - s * x, z], -1)


def out_of(frame: Tensor, vectors: Tensor) -> Tensor:
    """Vectors (B, 3) of the heading frame in the world."""
    x, y, z = vectors.unbind(-1)
    c, s = frame[:, 0, 0], frame[:, 1, 0]
    return torch.stack([c * x - s * y, s * x + c * y, z], -1)


def tensor(array: npt.ArrayLike, device: torch.device | str = "cpu") -> Tensor:
    """float32 on the device."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).to(device)


class Kinematics:
    """Forward kinematics of a humanoid with gradients, level by level of its tree."""

    def __init__(self, human: Humanoid, device: torch.device | str = "cpu"):
        skeleton, hinges = human.skeleton, human.hinges
        self.bodies = len(skeleton)
        self.hinges = len(hinges)
        self._axes = tensor(hinges.axes, device)
        self._rest = tensor(hinges.axes_t_rest, device)
        # Absent hinges read a zero that is appended to the angles: a gather is cheaper than a scatter with gradient.
        slot = np.full((self.bodies - 1) * 3, self.hinges)
        slot[(hinges.joint_of - 1) * 3 + hinges.slot_of] = np.arange(self.hinges)
        self._slot = torch.from_numpy(slot).to(device)
        parents = np.array(skeleton.parents)
        depth = np.zeros(self.bodies, dtype=int)
        for joint in range(1, self.bodies):
            depth[joint] = depth[parents[joint]] + 1
        # Children stand behind their parents: each level is computed from the one before alone.
        self._levels: list[tuple[Tensor, Tensor, Tensor]] = []
        above = [0]
        order = [0]
        for d in range(1, int(depth.max()) + 1):
            joints = np.flatnonzero(depth == d)
            place = [above.index(int(parents[j])) for j in joints]
            self._levels.append(
                (
                    torch.tensor(joints - 1, device=device),
                    torch.tensor(place, device=device),
                    tensor(skeleton.offsets_m[joints], device),
                )
            )
            above = joints.tolist()
            order += above
        self._order = torch.argsort(torch.tensor(order)).to(device)

    def slots(self, values: Tensor) -> Tensor:
        """Hinge values (B, H) spread over (B, J-1, 3), absent hinges zero."""
        padded = torch.cat([values, torch.zeros_like(values[:, :1])], -1)
        return padded.index_select(1, self._slot).view(len(values), self.bodies - 1, 3)

    def __call__(self, state: State) -> Bodies:
        """World states of all bodies."""
        angles = self.slots(state.hinge_rad)
        sa, sb, sc = angles.sin().unbind(-1)
        ca, cb, cc = angles.cos().unbind(-1)
        euler = square(torch.stack(
            [
                cb * cc, -cb * sc, sb,
                sa * sb * cc + ca * sc, ca * cc - sa * sb * sc, -sa * cb,
                sa * sc - ca * sb * cc, ca * sb * sc + sa * cc, ca * cb,
            ], -1,
        ))  # fmt: skip
        local = small_matmul(small_matmul(self._axes, euler), self._rest)
        r1, r2, r3 = self.slots(state.rate_radps).unbind(-1)
        spin = rotate(self._axes, torch.stack([r1 + sb * r3, ca * r2 - sa * cb * r3, sa * r2 + ca * cb * r3], -1))
        pos, rot = state.pos_w_m[:, None], state.rot_w[:, None]
        vel, ang = state.linvel_w_mps[:, None], rotate(state.rot_w, state.angvel_b_radps)[:, None]
        all_pos, all_rot, all_vel = [pos], [rot], [vel]
        for joints, place, offset in self._levels:
            parent = rot.index_select(1, place)
            arm = rotate(parent, offset.expand(len(pos), -1, -1))
            turn = ang.index_select(1, place)
            pos = pos.index_select(1, place) + arm
            vel = vel.index_select(1, place) + torch.linalg.cross(turn, arm)
            ang = turn + rotate(parent, spin.index_select(1, joints))
            rot = small_matmul(parent, local.index_select(1, joints))
            all_pos.append(pos)
            all_rot.append(rot)
            all_vel.append(vel)
        return Bodies(*(torch.cat(parts, 1).index_select(1, self._order) for parts in (all_pos, all_rot, all_vel)))


class Mirror:
    """Left and right exchanged, in the plane y = 0: the body is symmetric, so a mirrored transition is a transition."""

    def __init__(self, human: Humanoid, device: torch.device | str = "cpu"):
        names = human.skeleton.names
        hinges = human.hinges

        def other(name: str) -> str:
            side, _, rest = name.partition("_")
            return {"left": f"right_{rest}", "right": f"left_{rest}"}.get(side, name)

        place = {(names[j], int(s)): h for h, (j, s) in enumerate(zip(hinges.joint_of, hinges.slot_of, strict=True))}
        swap = [place[other(names[j]), int(s)] for j, s in zip(hinges.joint_of, hinges.slot_of, strict=True)]
        # Sided hinges have mirrored axes and keep their angles; on the midline bending forward keeps its sign only.
        sign = [
            -1.0 if other(names[j]) == names[j] and s > 0 else 1.0
            for j, s in zip(hinges.joint_of, hinges.slot_of, strict=True)
        ]
        self._swap = torch.tensor(swap, device=device)
        self._sign = torch.tensor(sign, device=device)
        self._flip = torch.tensor([1.0, -1.0, 1.0], device=device)
        self._seat_flip = torch.tensor([1.0, -1.0, 1.0, -1.0, 1.0], device=device)
        self.joints = torch.tensor([human.skeleton.index(other(n)) for n in names], device=device)

    def hinge(self, values: Tensor) -> Tensor:
        """Angles, rates, targets or actions (..., H)."""
        return values[..., self._swap] * self._sign

    def state(self, s: State) -> State:
        """The mirror image of states."""
        f = self._flip
        return State(
            s.pos_w_m * f, s.rot_w * (f[:, None] * f[None, :]), self.hinge(s.hinge_rad), s.linvel_w_mps * f,
            -s.angvel_b_radps * f, self.hinge(s.rate_radps),
        )  # fmt: skip

    def some(self, s: State, which: Tensor) -> State:
        """States of which those where `which` (B,) is true are mirrored."""
        other = self.state(s)
        pick = [
            torch.where(which.view(-1, *[1] * (a.dim() - 1)), b, a)
            for a, b in zip(s.parts(), other.parts(), strict=True)
        ]
        return State(*pick)

    def some_hinges(self, values: Tensor, which: Tensor) -> Tensor:
        """Hinge values (B, H), mirrored where `which` (B,) is true."""
        return torch.where(which[:, None], self.hinge(values), values)

    def some_seats(self, seat: Tensor, which: Tensor) -> Tensor:
        """Seats (B, 5), as `training.seats.NO_SEAT` has them, mirrored where `which` (B,) is true."""
        return torch.where(which[:, None], seat * self._seat_flip, seat)
