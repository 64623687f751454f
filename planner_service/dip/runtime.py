"""What runs DiP's blocks, chosen at start by a fixed rule: what is installed and what the processor has.

Never by timing: the same machine makes the same plans, bit for bit, at every start.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Literal

from planner_service.dip.blocks import Blocks, TorchBlocks
from planner_service.dip.network import DipNetwork
from shared.errors import UnavailableError
from shared.processor import bf16_pays

log = logging.getLogger(__name__)

Runtime = Literal["auto", "torch", "openvino"]


@dataclass(frozen=True)
class Chosen:
    """The blocks to use.

    Attributes:
        name: runtime and precision, e.g. "openvino bfloat16".
        quick: for all steps but the last; exact: for the last, in float32. What rounding does to an early step the
            later ones put right; in the last it is a tremble of the body (docs/experiments_planner.md).
    """

    name: str
    quick: Blocks
    exact: Blocks


def choose_blocks(network: DipNetwork, runtime: Runtime = "auto", bf16: bool | None = None, threads: int = 1) -> Chosen:
    """OpenVINO where the extra `fast` is installed, else torch; bfloat16 where the processor multiplies in it.

    Raises UnavailableError where OpenVINO is asked for by name and does not load.
    """
    rounded = bf16_pays() if bf16 is None else bf16
    precision = "bfloat16" if rounded else "float32"
    if runtime != "torch":
        try:
            from planner_service.dip.openvino_blocks import OpenVinoBlocks
        except ImportError as error:
            if runtime == "openvino":
                raise UnavailableError(
                    f"OpenVINO does not load (pip install 'motionloop[fast]'): {error}", field="runtime"
                ) from error
            log.info("plans are made by torch: %s", error)
        else:
            exact = OpenVinoBlocks(network, False, threads)
            return Chosen(f"openvino {precision}", OpenVinoBlocks(network, True, threads) if rounded else exact, exact)
    plain = TorchBlocks(network)
    return Chosen(f"torch {precision}", TorchBlocks(network, bf16=True) if rounded else plain, plain)


def usual_steps(trained: int, bf16: bool | None = None) -> int:
    """Diffusion steps to take where nobody says how many: all where bfloat16 is multiplied in, half elsewhere.

    Half cost half, and plans are nearly as good (docs/experiments_planner.md).
    """
    rounded = bf16_pays() if bf16 is None else bf16
    return trained if rounded else max(1, trained // 2)
