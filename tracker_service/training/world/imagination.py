"""One imagined tick: see, act, let the model move the body, judge. Compiled where a C++ compiler is."""

from __future__ import annotations

import importlib.util
import shutil
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from shared.protocol.rates import TICK_HZ
from tracker_service.simulation.humanoid import Humanoid
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.world.body import Bodies, Kinematics, State, tensor
from tracker_service.training.world.model import WorldModel
from tracker_service.training.world.sight import Reference, observe, servo_targets, tick_reward

OBSERVATION_CLIP = 5.0
Flat = tuple[Tensor, ...]


class Sight(nn.Module):
    """Fixed normalisation of observations (D,), clipped."""

    mean: Tensor
    std: Tensor

    def __init__(self, size: int):
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def forward(self, observation: Tensor) -> Tensor:
        """(B, D) normalised."""
        return ((observation - self.mean) / self.std).clamp(-OBSERVATION_CLIP, OBSERVATION_CLIP)


def mixed(layers: nn.Sequential, x: Tensor, bf16: bool) -> Tensor:
    """`layers(x)`, all but the last in bfloat16 where asked."""
    if not bf16:
        out: Tensor = layers(x)
        return out
    with torch.autocast(x.device.type, dtype=torch.bfloat16):
        hidden = layers[:-1](x)
    last: Tensor = layers[-1](hidden.float())
    return last


@dataclass(frozen=True)
class Imagined:
    """What an imagined tick gave: the state and bodies arrived at, reward (B,), distances (B, J), raw action and the
    servo's mean mechanical power (B,) in kW."""

    state: State
    bodies: Bodies
    reward: Tensor
    distance_m: Tensor
    action: Tensor
    power_kw: Tensor


class Imagination:
    """Imagined ticks of one humanoid's model under an actor.

    Args:
        bf16: hidden layers in bfloat16. compiled: with torch.compile.
    """

    def __init__(
        self, human: Humanoid, env: EnvSettings, kinematics: Kinematics, sight: Sight, actor: nn.Sequential,
        model: WorldModel, bf16: bool, compiled: bool, device: torch.device | str = "cpu",
    ):  # fmt: skip
        self._kinematics, self._sight, self._actor, self._model = kinematics, sight, actor, model
        self._bf16 = bf16
        self._scale = env.action_scale_rad
        self._lead = tensor(human.damping / human.stiffness * TICK_HZ, device)
        self._stiffness, self._damping = tensor(human.stiffness, device), tensor(human.damping, device)
        self._limits = tensor(human.hinges.lower, device), tensor(human.hinges.upper, device)
        wrap: Callable[[Callable[..., Flat]], Callable[..., Flat]] = (
            (lambda f: torch.compile(f, dynamic=False)) if compiled else (lambda f: f)
        )
        self._tick_flat = wrap(self._plain_tick)
        self._model_flat = wrap(self._plain_model)

    def tick(self, state: State, bodies: Bodies, ref: Reference, heights: Tensor) -> Imagined:
        """See, act and arrive one tick later; `ref` previews from the next tick on."""
        flat = self._tick_flat(
            *state.parts(), bodies.pos_w_m, bodies.rot_w, bodies.linvel_w_mps, heights, *vars(ref).values()
        )
        return Imagined(State(*flat[:6]), Bodies(*flat[6:9]), *flat[9:])

    def _plain_tick(self, *flat: Tensor) -> Flat:
        state, bodies, heights, ref = State(*flat[:6]), Bodies(*flat[6:9]), flat[9], Reference(*flat[10:])
        observation = observe(state, bodies, ref, heights)
        action = mixed(self._actor, self._sight(observation), self._bf16)
        target = servo_targets(action, ref, self._lead, self._scale, self._limits)
        after = self._advance(state, bodies, target, heights)
        seen = self._kinematics(after)
        reward, distance = tick_reward(after, seen, ref)
        torque = self._stiffness * (target - after.hinge_rad) - self._damping * after.rate_radps
        power = (torque * after.rate_radps).abs().sum(-1) * 1e-3
        return (
            *after.parts(), seen.pos_w_m, seen.rot_w, seen.linvel_w_mps, reward, distance, action, power,
        )  # fmt: skip

    def model_tick(self, state: State, bodies: Bodies, target: Tensor, heights: Tensor) -> tuple[State, Bodies]:
        """The model alone, under given servo targets."""
        flat = self._model_flat(*state.parts(), bodies.pos_w_m, bodies.rot_w, bodies.linvel_w_mps, target, heights)
        return State(*flat[:6]), Bodies(*flat[6:9])

    def _plain_model(self, *flat: Tensor) -> Flat:
        after = self._advance(State(*flat[:6]), Bodies(*flat[6:9]), flat[9], flat[10])
        seen = self._kinematics(after)
        return (*after.parts(), seen.pos_w_m, seen.rot_w, seen.linvel_w_mps)

    def _advance(self, state: State, bodies: Bodies, target: Tensor, heights: Tensor) -> State:
        model = self._model
        x = model.inputs(state, bodies, target, heights)
        return model.moved(state, mixed(model.net, x, self._bf16) * model.scale)


def can_compile(device: torch.device) -> bool:
    """Whether torch.compile finds what it needs here: a C++ compiler, and Triton for a graphics card."""
    if device.type == "cuda" and importlib.util.find_spec("triton") is None:
        return False
    return shutil.which("g++") is not None or shutil.which("clang++") is not None
