"""DiP's transformer blocks in OpenVINO, the optional extra `fast`: the same numbers as `blocks.TorchBlocks`, sooner.

The graph is put together here, operator by operator: it is small, and nothing has to be traced or written to disk.
Shapes as in `blocks`; rows and memory tokens may be any number.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from planner_service.dip.blocks import Memory
from planner_service.dip.network import DecoderLayer, DipNetwork
from planner_service.dip.openvino_core import core, openvino, ops

Node = Any
"""An output of an OpenVINO graph; its stubs know no better."""


class OpenVinoBlocks:
    """The blocks in OpenVINO on the CPU, in one stream.

    Args:
        network: whose blocks.
        bf16: compute in bfloat16 wherever the processor multiplies in it.
        threads: CPU threads.
    """

    def __init__(self, network: DipNetwork, bf16: bool = False, threads: int = 1):
        options = {
            "INFERENCE_PRECISION_HINT": "bf16" if bf16 else "f32",
            "INFERENCE_NUM_THREADS": threads,
            "NUM_STREAMS": 1,
            "ENABLE_CPU_PINNING": False,
        }
        compiled = core().compile_model(_graph(network), "CPU", options)
        self._request = compiled.create_infer_request()

    def __call__(self, tokens: Tensor, memory: Memory) -> Tensor:
        """See `blocks.Blocks`."""
        given = [t.numpy() for t in (tokens.contiguous(), memory.keys, memory.bias, memory.values)]
        found = self._request.infer(given, share_inputs=True, share_outputs=True)[0]
        return torch.from_numpy(found.copy())  # the next call writes over what is shared


def _graph(network: DipNetwork) -> Any:
    """Inputs tokens (R, T, W), keys (D, R, C, W), bias (D, R, 1, C), values (D, R, C, W); output (R, N, W)."""
    config = network.config
    width, heads, frames = config.width, config.heads, config.prefix_frames + config.plan_frames
    depth = len(network.layers)
    tokens = ops.parameter([-1, frames, width], np.float32, "tokens")
    keys = ops.parameter([depth, -1, -1, width], np.float32, "keys")
    bias = ops.parameter([depth, -1, 1, -1], np.float32, "bias")
    values = ops.parameter([depth, -1, -1, width], np.float32, "values")
    memory = [_unstack(each, depth) for each in (keys, bias, values)]
    x: Node = tokens
    for number, layer in enumerate(network.layers):
        assert isinstance(layer, DecoderLayer)
        keep = config.plan_frames if number == depth - 1 else frames
        x = _block(layer, x, [each[number] for each in memory], frames, keep, heads)
    return openvino.Model([x], [tokens, keys, bias, values], "dip_blocks")


def _block(layer: DecoderLayer, x: Node, memory: list[Node], frames: int, keep: int, heads: int) -> Node:
    """One block: (R, T, W) -> its last `keep` tokens."""
    first = layer.norm_first
    tail = x if keep == frames else _last(x, frames, keep)
    tail = ops.add(tail, _attend(layer, _norm(x, layer.norm1) if first else x, frames, keep, heads))
    if not first:
        tail = _norm(tail, layer.norm1)
    y = _norm(tail, layer.norm2) if first else tail
    tail = ops.add(tail, _cross(y, memory, _array(layer.cross_attention.out.bias), heads))
    if not first:
        tail = _norm(tail, layer.norm2)
    hidden = ops.gelu(_linear(_norm(tail, layer.norm3) if first else tail, layer.ff1), "erf")
    tail = ops.add(tail, _linear(hidden, layer.ff2))
    return tail if first else _norm(tail, layer.norm3)


def _attend(layer: DecoderLayer, y: Node, frames: int, keep: int, heads: int) -> Node:
    """Self-attention of the last `keep` tokens to all."""
    own = layer.self_attention
    width = own.out.in_features
    depth = width // heads
    wanted = y if keep == frames else _last(y, frames, keep)

    def split(z: Node, tokens: int) -> Node:
        return ops.transpose(ops.reshape(z, [0, tokens, heads, depth], True), [0, 2, 1, 3])

    weight, bias = _array(own.key_value.weight), _array(own.key_value.bias)
    query = split(_linear(wanted, own.query), keep)
    key = split(_product(y, weight[:width], bias[:width]), frames)
    value = split(_product(y, weight[width:], bias[width:]), frames)
    out = ops.transpose(ops.scaled_dot_product_attention(query, key, value), [0, 2, 1, 3])
    return _linear(ops.reshape(out, [0, keep, width], True), own.out)


def _cross(y: Node, memory: list[Node], out_bias: npt.NDArray[np.float32], heads: int) -> Node:
    """Cross-attention, see `blocks.Memory`."""
    keys, bias, values = memory
    scores = ops.add(ops.matmul(y, keys, False, True), bias)
    by_head = ops.softmax(ops.reshape(scores, [0, 0, heads, -1], True), -1)
    weights = ops.reshape(by_head, [0, 0, -1], True)
    return ops.add(ops.matmul(weights, values, False, False), ops.constant(out_bias))


def _norm(x: Node, norm: nn.LayerNorm) -> Node:
    centred = ops.mvn(x, [-1], True, norm.eps, "inside_sqrt")
    return ops.add(ops.multiply(centred, ops.constant(_array(norm.weight))), ops.constant(_array(norm.bias)))


def _linear(x: Node, linear: nn.Linear) -> Node:
    return _product(x, _array(linear.weight), _array(linear.bias))


def _product(x: Node, weight: npt.NDArray[np.float32], bias: npt.NDArray[np.float32]) -> Node:
    return ops.add(ops.matmul(x, ops.constant(weight), False, True), ops.constant(bias))


def _last(x: Node, frames: int, keep: int) -> Node:
    """The last `keep` of the tokens (R, T, W)."""
    return ops.slice(x, [frames - keep], [frames], [1], [1])


def _unstack(x: Node, depth: int) -> list[Node]:
    return [ops.squeeze(part, [0]) for part in ops.split(x, 0, depth).outputs()]


def _array(parameter: Tensor) -> npt.NDArray[np.float32]:
    return parameter.detach().float().contiguous().numpy()
