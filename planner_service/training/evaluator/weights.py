"""The frozen evaluator on disk and in use: fp16 safetensors with the normaliser inside, a JSON card beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from planner_service.dip.features_torch import Normalizer
from planner_service.dip.saved import read_network, save_network
from planner_service.text.encoder import TextEncoder, pad_tokens
from planner_service.training.evaluator.network import FRAMES_A_TOKEN, EvaluatorConfig, EvaluatorNetwork
from shared.errors import InvalidInputError
from shared.motion.features import FEATURES

FORMAT = "motionloop-evaluator-1"
SHIPPED = Path(__file__).resolve().parent / "evaluator.safetensors"
BATCH = 64
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Evaluator:
    """Encoders ready for use.

    Attributes:
        network: in fp32 and evaluation mode; normalizer: of the features; encoder: gives the token features.
        sha256: of the weights' file.
    """

    network: EvaluatorNetwork
    normalizer: Normalizer
    encoder: TextEncoder
    sha256: str

    def embed_motions(self, motions: Sequence[npt.NDArray[np.floating]]) -> Array:
        """(N, E) embeddings of motions, each features (T >= 4, 263) at 20 fps.

        Raises InvalidInputError for one that is too short or too long.
        """
        out = []
        most = self.network.config.most_frames
        for motion in motions:
            if not FRAMES_A_TOKEN <= len(motion) <= most:
                raise InvalidInputError(
                    f"a motion of {len(motion)} frames", field="motion", allowed=f"{FRAMES_A_TOKEN}..{most} frames"
                )
        with torch.inference_mode():
            for at in range(0, len(motions), BATCH):
                features, length = pad_motions(motions[at : at + BATCH])
                normal = self.normalizer.normalize(features)
                out.append(self.network.motion(normal, length).double().numpy())
        return np.concatenate(out)

    def embed_texts(self, texts: Sequence[str]) -> Array:
        """(N, E) embeddings of sentences; each distinct one is computed once."""
        distinct = list(dict.fromkeys(texts))
        rows = []
        with torch.inference_mode():
            for at in range(0, len(distinct), BATCH):
                tokens, mask = pad_tokens(self.encoder.encode(distinct[at : at + BATCH]), self.encoder.spec.dim)
                rows.append(self.network.sentence(torch.from_numpy(tokens), torch.from_numpy(mask)).double().numpy())
        place = {text: i for i, text in enumerate(distinct)}
        return np.concatenate(rows)[[place[text] for text in texts]]


def pad_motions(motions: Sequence[npt.NDArray[np.floating]]) -> tuple[torch.Tensor, torch.Tensor]:
    """Motions (T_i, 263) as (B, T, 263) with zeros behind, T divisible by 4, and their lengths (B,)."""
    length = np.array([len(m) for m in motions])
    frames = -(-int(length.max()) // FRAMES_A_TOKEN) * FRAMES_A_TOKEN
    out = np.zeros((len(motions), frames, FEATURES), np.float32)
    for row, motion in enumerate(motions):
        out[row, : len(motion)] = motion
    return torch.from_numpy(out), torch.from_numpy(length)


def save_evaluator(path: Path, network: EvaluatorNetwork, normalizer: Normalizer, card: dict[str, object]) -> str:
    """Write weights (fp16) and `card` as PATH's JSON neighbour; returns the file's sha256."""
    return save_network(path, FORMAT, network.config, network, normalizer, card)


def load_evaluator(encoder: TextEncoder, path: Path = SHIPPED) -> Evaluator:
    """The evaluator in a file of `save_evaluator`.

    Raises:
        UnavailableError: there is no such file.
        InvalidInputError: the file holds something else, or was made with another text encoder.
    """
    network, normalizer, digest = read_network(path, FORMAT, "evaluator", _network)
    if network.config.text_encoder != encoder.spec.name:
        raise InvalidInputError(
            f"these weights do not fit the text encoder {encoder.spec.name!r}",
            field="text_encoder",
            allowed=network.config.text_encoder,
        )
    return Evaluator(network, normalizer, encoder, digest)


def _network(config: str) -> EvaluatorNetwork:
    return EvaluatorNetwork(EvaluatorConfig.model_validate_json(config))
