"""A loss and its gradients, computed as written or replayed from a recording.

On a graphics card an update is some ten thousand small kernels, and starting each takes longer than running it. There
the forward and backward pass is recorded once as a CUDA graph and replayed on new inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import torch
from torch import Tensor, nn

WARM_UPS = 3


class Pass:
    """Gradients of a loss.

    Args:
        compute: from input tensors to the loss and whatever else is wanted, all tensors, without waiting for any.
        parameters: they get gradients, and nothing else has any.
        recorded: replay a recording; inputs must then keep their shapes, and a step may change gradients but must
            leave the tensors that hold them.
    """

    def __init__(
        self, compute: Callable[..., Sequence[Tensor]], parameters: Iterable[nn.Parameter], recorded: bool
    ):  # fmt: skip
        self._compute, self._parameters, self._recorded = compute, list(parameters), recorded
        self._graph: torch.cuda.CUDAGraph | None = None
        self._inputs: list[Tensor] = []
        self._outputs: list[Tensor] = []

    def __call__(self, *inputs: Tensor) -> list[Tensor]:
        """What `compute` gives for these inputs, detached; the parameters' gradients are those of its first, the loss.

        What a recording gives is overwritten by the next call.
        """
        if not self._recorded:
            return self._run(inputs)
        if self._graph is None:
            self._graph = self._record(inputs)
        for kept, given in zip(self._inputs, inputs, strict=True):
            kept.copy_(given)
        self._graph.replay()
        return self._outputs

    def _run(self, inputs: Sequence[Tensor]) -> list[Tensor]:
        for parameter in self._parameters:
            parameter.grad = None
        out = self._compute(*inputs)
        out[0].backward()  # type: ignore[no-untyped-call]
        return [value.detach() for value in out]

    def _record(self, inputs: Sequence[Tensor]) -> torch.cuda.CUDAGraph:
        self._inputs = [given.clone() for given in inputs]
        side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(WARM_UPS):
                self._run(self._inputs)
        torch.cuda.current_stream().wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        for parameter in self._parameters:
            parameter.grad = None
        with torch.cuda.graph(graph):
            self._outputs = self._run(self._inputs)
        return graph
