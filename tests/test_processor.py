"""bfloat16 follows the processor, in training as in use."""

from __future__ import annotations

from pathlib import Path

import pytest

from shared.processor import bf16_pays

WITH = "processor\t: 0\nmodel name\t: A\nflags\t\t: fpu avx512f avx512_bf16 amx_tile\n"
WITHOUT = "processor\t: 0\nmodel name\t: avx512_bf16\nflags\t\t: fpu avx2 avx512f\n"


@pytest.mark.parametrize(
    ("text", "pays"), [(WITH, True), (WITHOUT, False), (WITHOUT + WITH, True), ("flags\t: amx_bf16", True), ("", False)]
)
def test_the_flags_decide(tmp_path: Path, text: str, pays: bool) -> None:
    (tmp_path / "cpuinfo").write_text(text)
    assert bf16_pays(tmp_path / "cpuinfo", {}) is pays


@pytest.mark.parametrize(
    ("name", "value", "pays"),
    [
        ("ATEN_CPU_CAPABILITY", "avx2", False),
        ("ATEN_CPU_CAPABILITY", "avx512", True),
        ("ONEDNN_MAX_CPU_ISA", "AVX2", False),
        ("DNNL_MAX_CPU_ISA", "avx512_core", False),
        ("ONEDNN_MAX_CPU_ISA", "AVX512_CORE_BF16", True),
    ],
)
def test_what_is_switched_off_does_not_count(tmp_path: Path, name: str, value: str, pays: bool) -> None:
    (tmp_path / "cpuinfo").write_text(WITH)
    assert bf16_pays(tmp_path / "cpuinfo", {name: value}) is pays


def test_where_nothing_can_be_read_float32_is_used(tmp_path: Path) -> None:
    assert not bf16_pays(tmp_path / "none", {})


def test_training_and_use_take_the_same_answer() -> None:
    pytest.importorskip("torch")
    from planner_service.training import trainer

    assert trainer.TrainSettings().bf16 is bf16_pays()
