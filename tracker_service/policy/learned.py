"""The trained policy in numpy: a small MLP from a safetensors file, normaliser included; no torch."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, Field
from safetensors import SafetensorError
from safetensors.numpy import load

from shared.errors import InvalidInputError
from shared.motion.rotations import matrix_from_quat
from shared.plugins.interfaces import TrackerObservation, TrackerSpec
from shared.protocol.messages import SERVO_TARGETS, TICK_HZ
from tracker_service.policy.observations import PREVIEW_TICKS, PolicyInput, feedforward_targets, observe

F32 = npt.NDArray[np.float32]
Array = npt.NDArray[np.floating]

WEIGHTS = Path(__file__).parent.parent / "weights" / "learned.safetensors"
SILU_FLOOR = np.float32(-80.0)
"""Below this SiLU is zero in float32, and its exponential would overflow."""


class PolicyCard(BaseModel):
    """What the JSON card beside the weights says that inference needs (other fields are for people)."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    version: str
    skeleton: str
    character: str
    layers: int = Field(ge=1)
    action_scale_rad: float = Field(gt=0)
    observation_clip: float = Field(gt=0)
    observation: Literal["flat", "heights"] = "flat"


class PolicyNetwork:
    """Normaliser and MLP with SiLU between the layers.

    Args:
        tensors: `mean`, `std` (D,), and `w{i}` (out, in), `b{i}` (out,) for each layer.
        layers: how many. clip: normalised observations stay within +-clip.
    """

    def __init__(self, tensors: dict[str, npt.NDArray[np.generic]], layers: int, clip: float):
        wanted = ["mean", "std", *(f"{k}{i}" for i in range(layers) for k in "wb")]
        missing = [name for name in wanted if name not in tensors]
        if missing:
            raise InvalidInputError(
                f"the weights lack {', '.join(missing)}", field="weights", allowed=", ".join(wanted)
            )
        self._mean, self._std = (tensors[k].astype(np.float32) for k in ("mean", "std"))
        self._weights = [np.ascontiguousarray(tensors[f"w{i}"].astype(np.float32).T) for i in range(layers)]
        self._biases = [tensors[f"b{i}"].astype(np.float32) for i in range(layers)]
        self._clip = np.float32(clip)

    @property
    def sizes(self) -> tuple[int, int]:
        """Lengths of observation and action."""
        return len(self._mean), len(self._biases[-1])

    def __call__(self, observation: F32) -> F32:
        """(B, D) -> (B, H) actions, clipped to +-1."""
        x = np.clip((observation - self._mean) / self._std, -self._clip, self._clip)
        for i, (w, b) in enumerate(zip(self._weights, self._biases, strict=True)):
            x = x @ w + b
            if i < len(self._weights) - 1:
                x = x / (1.0 + np.exp(-np.maximum(x, SILU_FLOOR)))
        return np.asarray(np.clip(x, -1.0, 1.0), dtype=np.float32)


class LearnedTracker:
    """Servo targets = led reference + scaled action of the policy.

    Args:
        weights: safetensors file with a JSON card of the same name beside it.
        damping_ratio_s: (H,) damping over stiffness of the servos.

    Raises:
        InvalidInputError: file missing or not of this kind.
    """

    def __init__(self, damping_ratio_s: Array, weights: Path = WEIGHTS):
        card_path = weights.with_suffix(".json")
        try:
            raw = weights.read_bytes()
            self.card = PolicyCard.model_validate(json.loads(card_path.read_text(encoding="utf-8")))
            tensors = load(raw)
        except (OSError, ValueError, SafetensorError) as error:
            raise InvalidInputError(f"no tracker weights at {weights}: {error}", field="weights") from error
        self.network = PolicyNetwork(tensors, self.card.layers, self.card.observation_clip)
        self._ratio = damping_ratio_s
        self.spec = TrackerSpec(
            name="learned",
            version=self.card.version,
            weights_sha256=hashlib.sha256(raw).hexdigest(),
            skeleton=self.card.skeleton,
            fps=TICK_HZ,
            action_spaces=(SERVO_TARGETS,),
            characters=(self.card.character,),
            gets_up=True,
        )

    def reset(self, character_ids: Sequence[str]) -> None:
        """It keeps no state."""

    def act(self, character_ids: Sequence[str], observations: Sequence[TrackerObservation]) -> Array:
        """(B, H) servo targets in radians."""
        seen = observe(policy_input(observations))
        if self.card.observation == "heights":
            seen = np.concatenate([seen, support_heights(observations)], axis=-1)
        action = self.network(seen)
        ref = np.stack([o.ref_hinge_rad[:2] for o in observations])
        led = feedforward_targets(ref[:, 0], ref[:, 1], TICK_HZ, self._ratio)
        return led + self.card.action_scale_rad * action


def support_heights(observations: Sequence[TrackerObservation]) -> F32:
    """(B, 12) heights of the ground grid, under the feet and under the pelvis; zeros on a flat floor."""
    rows = [np.concatenate([o.ground_height_w_m, o.foot_height_w_m, o.seat_height_w_m]) for o in observations]
    return np.asarray(rows, dtype=np.float32)


def policy_input(observations: Sequence[TrackerObservation]) -> PolicyInput:
    """Observations of several characters as one batch."""
    rows = [ticks - 1 for ticks in PREVIEW_TICKS]
    return PolicyInput(
        pos_w_m=np.stack([o.body_pos_w_m for o in observations]),
        linvel_w_mps=np.stack([o.body_linvel_w_mps for o in observations]),
        root_rot_w=matrix_from_quat(np.stack([o.body_quat_w[0] for o in observations])),
        root_angvel_w_radps=np.stack([o.body_angvel_w_radps[0] for o in observations]),
        hinge_rad=np.stack([o.hinge_pos_rad for o in observations]),
        hinge_vel_radps=np.stack([o.hinge_vel_radps for o in observations]),
        ref_pos_w_m=np.stack([o.ref_pos_w_m[rows] for o in observations]),
        ref_linvel_w_mps=np.stack([o.ref_linvel_w_mps[0] for o in observations]),
        ref_root_rot_w=matrix_from_quat(np.stack([o.ref_quat_w[0, 0] for o in observations])),
        ref_hinge_rad=np.stack([o.ref_hinge_rad[rows] for o in observations]),
    )
