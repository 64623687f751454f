"""Numbers of learning through a world model."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class WorldSettings(BaseModel):
    """How much of what is done in an iteration, and how. Ticks are of 1/30 s.

    Attributes:
        hidden: of actor and critic. model_hidden: of the world model.
        buffer_ticks: rows of the replay ring. collect_ticks: simulated ticks of all environments an iteration.
        model_updates, model_batch, model_ticks: fitting of the model over windows.
        critic_updates, critic_batch, critic_ticks: n-step returns from the ring.
        policy_updates, policy_batch, horizon, recent_ticks: imagined rollouts that start from the last so many rows.
        spread: of exploration noise; environments explore with 0, 1/2, 1 and 2 times that.
        averaging: share of the weights' running average that an update leaves.
        smoothness: cost of changing the action from tick to tick. power: cost of mechanical power in kW.
        calm: cost of the joints' mean squared acceleration ((m/s2)^2) where the reference stands still.
        mirrored_share: of the model's windows that are seen in the mirror.
        bf16: hidden layers in bfloat16; None where the processor has it.
        recorded: updates replayed from a CUDA graph; None where the networks are on a graphics card.
        compiled: imagined ticks compiled; None where a C++ compiler is.
    """

    model_config = ConfigDict(frozen=True)
    hidden: tuple[int, ...] = (512, 256)
    model_hidden: tuple[int, ...] = (512, 512)
    buffer_ticks: int = Field(default=480, ge=32)
    collect_ticks: int = Field(default=2, ge=1)
    model_updates: int = Field(default=3, ge=1)
    model_batch: int = Field(default=512, ge=8)
    model_ticks: int = Field(default=6, ge=1)
    critic_updates: int = Field(default=2, ge=1)
    critic_batch: int = Field(default=2048, ge=8)
    critic_ticks: int = Field(default=12, ge=1)
    policy_updates: int = Field(default=1, ge=1)
    policy_batch: int = Field(default=512, ge=8)
    horizon: int = Field(default=12, ge=1)
    recent_ticks: int = Field(default=240, ge=16)
    gamma: float = Field(default=0.97, gt=0, lt=1)
    policy_rate: float = 3e-4
    model_rate: float = 7e-4
    critic_rate: float = 1e-3
    policy_gradient_norm: float = 0.1
    spread: float = Field(default=0.12, gt=0)
    averaging: float = Field(default=0.995, gt=0, lt=1)
    smoothness: float = 0.02
    power: float = 0.0
    calm: float = 0.0
    mirrored_share: float = Field(default=0.5, ge=0, le=1)
    bf16: bool | None = None
    recorded: bool | None = None
    compiled: bool | None = None
