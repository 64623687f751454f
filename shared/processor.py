"""What the processor is good at."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path

_BF16 = frozenset({"avx512_bf16", "amx_bf16"})
_ONEDNN_WITHOUT = frozenset({"SSE41", "AVX", "AVX2", "AVX2_VNNI", "AVX2_VNNI_2", "AVX512_CORE", "AVX512_CORE_VNNI"})
_SWITCHES = {
    "ATEN_CPU_CAPABILITY": frozenset({"DEFAULT", "AVX2"}),
    "ONEDNN_MAX_CPU_ISA": _ONEDNN_WITHOUT,
    "DNNL_MAX_CPU_ISA": _ONEDNN_WITHOUT,
}
"""Variables that keep torch and oneDNN from what the processor has, with the values that leave no bfloat16."""


def bf16_pays(cpuinfo: Path = Path("/proc/cpuinfo"), environment: Mapping[str, str] = os.environ) -> bool:
    """Whether this processor multiplies in bfloat16 and may: about twice as fast as float32 then, and twenty times
    slower in training where it does not. The one place that decides, for training as for use."""
    if any(environment.get(name, "").upper() in values for name, values in _SWITCHES.items()):
        return False
    try:
        text = cpuinfo.read_text()
    except OSError:
        return False  # not Linux: no way to tell, and float32 is never wrong
    return any(_BF16 & set(flags.split()) for flags in re.findall(r"^flags\s*:(.*)$", text, re.MULTILINE))
