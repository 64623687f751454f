"""Networks on disk: fp16 safetensors with the normaliser and the configuration inside, and a JSON card beside them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import torch
from pydantic import BaseModel, ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from planner_service.dip.features_torch import Normalizer
from planner_service.text.pretrained import file_sha256
from shared.errors import InvalidInputError, UnavailableError

Network = TypeVar("Network", bound=nn.Module)
PREFIX = "network."


def save_network(
    path: Path, kind: str, config: BaseModel, network: nn.Module, normalizer: Normalizer, card: dict[str, object]
) -> str:
    """Write weights (fp16) and `card` as PATH's JSON neighbour; returns the file's sha256.

    Args:
        kind: name of the format, which `read_network` asks for.
    """
    tensors = {f"{PREFIX}{k}": v.detach().cpu().half().contiguous() for k, v in network.state_dict().items()}
    tensors["normalizer.mean"] = normalizer.mean.cpu().float().contiguous()
    tensors["normalizer.std"] = normalizer.std.cpu().float().contiguous()
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix(".part")
    save_file(tensors, str(scratch), {"format": kind, "config": config.model_dump_json()})
    scratch.chmod(0o644)  # readable by the user a container runs as
    scratch.rename(path)
    digest = file_sha256(path)
    path.with_suffix(".json").write_text(json.dumps({**card, "sha256": digest}, indent=1) + "\n", encoding="utf-8")
    return digest


def read_network(path: Path, kind: str, field: str, build: Callable[[str], Network]) -> tuple[Network, Normalizer, str]:
    """A network in fp32 and evaluation mode, its normaliser, and the file's sha256.

    Args:
        field: named in errors. build: makes the network from its configuration as JSON.

    Raises:
        UnavailableError: there is no such file.
        InvalidInputError: the file holds something else.
    """
    if not path.is_file():
        raise UnavailableError(f"no weights at {path}", field=field)
    try:
        with safe_open(str(path), framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118 - not a dict
        if metadata.get("format") != kind:
            raise InvalidInputError(f"{path} has format {metadata.get('format')}", field=field, allowed=kind)
        network = build(metadata["config"])
        network.load_state_dict({k.removeprefix(PREFIX): v for k, v in tensors.items() if k.startswith(PREFIX)})
        normalizer = Normalizer(tensors["normalizer.mean"], tensors["normalizer.std"])
    except (SafetensorError, ValidationError, KeyError, RuntimeError) as error:
        raise InvalidInputError(f"{path} does not hold what it should: {error}", field=field, allowed=kind) from error
    if not all(torch.isfinite(t).all() for t in tensors.values()):
        raise InvalidInputError(f"{path} holds values that are not finite", field=field, allowed="finite")
    return network.eval().requires_grad_(False), normalizer, file_sha256(path)
