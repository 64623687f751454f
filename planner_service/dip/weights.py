"""DiP's weights on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planner_service.dip.config import DipConfig
from planner_service.dip.features_torch import Normalizer
from planner_service.dip.network import DipNetwork
from planner_service.dip.saved import read_network, save_network

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
    return save_network(path, FORMAT, network.config, network, normalizer, card)


def load_weights(path: Path) -> DipWeights:
    """Network in fp32 and evaluation mode.

    Raises:
        UnavailableError: there is no such file.
        InvalidInputError: the file holds something else.
    """
    return DipWeights(*read_network(path, FORMAT, "weights", _network))


def _network(config: str) -> DipNetwork:
    return DipNetwork(DipConfig.model_validate_json(config))
