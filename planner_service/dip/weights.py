"""DiP's weights on disk: fp16 safetensors with the normaliser inside, and a JSON card beside them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from pydantic import ValidationError
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from planner_service.dip.config import DipConfig
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork
from planner_service.text.pretrained import file_sha256
from shared.errors import InvalidInputError, UnavailableError

FORMAT = "motionloop-dip-1"
SHIPPED = Path(__file__).resolve().parent.parent / "weights" / "dip_small.safetensors"


@dataclass(frozen=True)
class DipWeights:
    """A network ready for use, its normaliser, and what the file says of itself."""

    network: DipNetwork
    normalizer: Normalizer
    sha256: str


def save_weights(path: Path, network: DipNetwork, normalizer: Normalizer, card: dict[str, object]) -> str:
    """Write weights (fp16) and `card` as PATH's JSON neighbour; returns the file's sha256."""
    tensors = {f"network.{k}": v.detach().half().contiguous() for k, v in network.state_dict().items()}
    tensors["normalizer.mean"] = normalizer.mean.float().contiguous()
    tensors["normalizer.std"] = normalizer.std.float().contiguous()
    path.parent.mkdir(parents=True, exist_ok=True)
    scratch = path.with_suffix(".part")
    save_file(tensors, str(scratch), {"format": FORMAT, "config": network.config.model_dump_json()})
    scratch.chmod(0o644)  # readable by the user a container runs as
    scratch.rename(path)
    digest = file_sha256(path)
    path.with_suffix(".json").write_text(json.dumps({**card, "sha256": digest}, indent=1) + "\n", encoding="utf-8")
    return digest


def load_weights(path: Path) -> DipWeights:
    """Network in fp32 and evaluation mode.

    Raises:
        UnavailableError: there is no such file.
        InvalidInputError: the file holds something else.
    """
    if not path.is_file():
        raise UnavailableError(f"no DiP weights at {path}", field="weights")
    try:
        with safe_open(str(path), framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}  # noqa: SIM118 - not a dict
        if metadata.get("format") != FORMAT:
            raise InvalidInputError(f"{path} has format {metadata.get('format')}", field="weights", allowed=FORMAT)
        network = DipNetwork(DipConfig.model_validate_json(metadata["config"]))
        prefix = "network."
        network.load_state_dict({k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)})
        normalizer = Normalizer(tensors["normalizer.mean"], tensors["normalizer.std"])
    except (SafetensorError, ValidationError, KeyError, RuntimeError) as error:
        raise InvalidInputError(f"{path} holds no DiP weights: {error}", field="weights", allowed=FORMAT) from error
    if not all(torch.isfinite(t).all() for t in tensors.values()):
        raise InvalidInputError(f"{path} holds values that are not finite", field="weights", allowed="finite")
    return DipWeights(network.eval().requires_grad_(False), normalizer, file_sha256(path))
