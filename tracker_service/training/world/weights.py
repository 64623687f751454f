"""Weights of actor, critic and world model as fp16 safetensors: what ships, and what training goes on from."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from safetensors import SafetensorError
from safetensors.numpy import load, save_file
from torch import Tensor, nn

from shared.errors import InvalidInputError
from tracker_service.simulation.character_spec import HUMAN, Character
from tracker_service.training.env_settings import EnvSettings
from tracker_service.training.world.imagination import OBSERVATION_CLIP
from tracker_service.training.world.learner import Learner

Tensors = dict[str, npt.NDArray[np.generic]]
TRAINING_SUFFIX = "_training"
"""`learned.safetensors` drives the body; `learned_training.safetensors` holds critic and world model beside it."""


def training_file(actor: Path) -> Path:
    """Where critic and world model of an actor's file are."""
    return actor.with_name(actor.stem + TRAINING_SUFFIX + actor.suffix)


def _linear(layers: nn.Sequential, prefix: str = "") -> dict[str, Tensor]:
    linear = [m for m in layers if isinstance(m, nn.Linear)]
    named = {f"{prefix}w{i}": m.weight for i, m in enumerate(linear)}
    return named | {f"{prefix}b{i}": m.bias for i, m in enumerate(linear)}


def _half(tensors: dict[str, Tensor]) -> Tensors:
    return {name: t.detach().cpu().numpy().astype(np.float16) for name, t in tensors.items()}


def export_learner(learner: Learner, out: Path, card: dict[str, Any], character: Character = HUMAN) -> Path:
    """Write the averaged actor with its normaliser and card, and critic and model beside it; the actor's path.

    Args:
        card: facts for people: samples, hours, command, commit, metrics.
        character: whom it was trained with; it drives no other.
    """
    actor = _half(_linear(learner.averaged))
    sight = {"mean": learner.sight.mean.cpu().numpy(), "std": learner.sight.std.cpu().numpy()}
    model = learner.model
    training = _half(_linear(learner.critic, "critic_") | _linear(model.net, "model_"))
    training |= {f"model_{n}": getattr(model, n).cpu().numpy() for n in ("mean", "std", "scale")}
    out.parent.mkdir(parents=True, exist_ok=True)
    save_file({**sight, **actor}, str(out))
    save_file(training, str(training_file(out)))
    for path in (out, training_file(out)):
        path.chmod(0o644)
    facts = {
        "version": hashlib.sha256(out.read_bytes()).hexdigest()[:12],
        "skeleton": character.skeleton_id,
        "character": character.name,
        "layers": len(actor) // 2,
        "action_scale_rad": EnvSettings().action_scale_rad,
        "observation_clip": OBSERVATION_CLIP,
        "observation": "heights" if learner.heights else "flat",
        **card,
    }
    out.with_suffix(".json").write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    return out


def _read(path: Path) -> Tensors:
    try:
        return dict(load(path.read_bytes()))
    except (OSError, SafetensorError) as error:
        raise InvalidInputError(f"no weights at {path}: {error}", field="init") from error


@torch.no_grad()
def _fill(layers: dict[str, Tensor], tensors: Tensors, path: Path) -> None:
    for name, parameter in layers.items():
        if name not in tensors:
            raise InvalidInputError(f"{path.name} lacks {name}", field="init", allowed=", ".join(layers))
        given = torch.from_numpy(tensors[name].astype(np.float32))
        if given.dim() != parameter.dim() or any(g > p for g, p in zip(given.shape, parameter.shape, strict=True)):
            wanted = "x".join(str(n) for n in parameter.shape)
            raise InvalidInputError(f"{path.name}: {name} is too large", field="init", allowed=f"up to {wanted}")
        # Inputs and hidden units that came since stand behind the old ones and count for nothing yet: the network does
        # what it did, and has room to learn.
        old = tuple(slice(n) for n in given.shape)
        if given.dim() == 2:
            parameter[: given.shape[0]] = 0.0
        parameter[old] = given


@torch.no_grad()
def _fill_buffer(buffer: Tensor, values: npt.NDArray[np.generic]) -> None:
    buffer[: len(values)].copy_(torch.from_numpy(values.astype(np.float32)))


def warm_start(learner: Learner, actor_path: Path) -> bool:
    """Take over shipped weights: the actor, and critic and model where they lie beside it.

    Returns:
        whether critic and model were there.

    Raises:
        InvalidInputError: a file is missing, damaged, or larger than the learner's networks.
    """
    actor = _read(actor_path)
    for net in (learner.actor, learner.averaged):
        _fill(_linear(net), actor, actor_path)
    _fill_buffer(learner.sight.mean, actor["mean"])
    _fill_buffer(learner.sight.std, actor["std"])
    path = training_file(actor_path)
    if not path.exists():
        return False
    rest = _read(path)
    for net in (learner.critic, learner.target_critic):
        _fill(_linear(net, "critic_"), rest, path)
    _fill(_linear(learner.model.net, "model_"), rest, path)
    for name in ("mean", "std", "scale"):
        _fill_buffer(getattr(learner.model, name), rest[f"model_{name}"])
    return True
