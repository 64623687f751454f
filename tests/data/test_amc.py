"""ASF and AMC: rates, units, names, and what is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from shared.data.importer import import_path
from shared.errors import InvalidInputError
from shared.motion.io.files import read_motion
from shared.motion.io.options import ReadOptions
from tests.data.captures import FRAMES, amc, asf, asf_amc


def test_amc_has_no_rate_and_it_is_said(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc())
    raw = read_motion(path)
    assert raw.fps == 30.0 and "30 frames per second assumed" in raw.warnings[0]
    fast = read_motion(path, ReadOptions(fps=120.0))
    assert fast.fps == 120.0 and not any("rate" in warning for warning in fast.warnings)
    assert read_motion(asf_amc(tmp_path / "b", asf(), amc(":DEGREES\n:SAMPLES-PER-SECOND 60"))).fps == 60.0


def test_radians_and_degrees_are_the_same_motion(tmp_path: Path) -> None:
    want = read_motion(asf_amc(tmp_path / "a", asf(), amc())).positions_w_m
    rad = np.pi / 180
    for k, (skeleton, motion) in enumerate(
        [
            (asf("rad"), amc("", rad)),
            (asf("rad"), amc(":DEGREES")),
            (asf("deg"), amc(":RADIANS", rad)),
            (asf("deg"), amc("")),
            (asf("rad"), amc(":radians", rad)),
        ]
    ):
        got = read_motion(asf_amc(tmp_path / f"b{k}", skeleton, motion)).positions_w_m
        np.testing.assert_allclose(got, want, atol=1e-5)


@pytest.mark.parametrize("names", [("01.ASF", "01_01.AMC"), ("A.ASF", "a_walk.amc"), ("other.Asf", "01_01.Amc")])
def test_upper_and_lower_case_are_the_same(tmp_path: Path, names: tuple[str, str]) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc(), names)
    assert len(read_motion(path)) == FRAMES
    assert len(import_path(tmp_path / "a", tmp_path / "out")) == 1


def test_the_longest_name_of_a_skeleton_that_fits_is_taken(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc(), ("01_0.asf", "01_01.amc"))
    (path.parent / "0.asf").write_text("not one")
    (path.parent / "02.asf").write_text("not one")
    assert len(read_motion(path)) == FRAMES
    (path.parent / "01_0.asf").unlink()
    (path.parent / "0.asf").unlink()
    (path.parent / "03.asf").write_text("not one")
    with pytest.raises(InvalidInputError, match=r"no ASF skeleton for it.*02.asf, 03.asf"):
        read_motion(path)


def test_bones_of_another_convention_are_found(tmp_path: Path) -> None:
    """Acclaim joints are the far ends of bones; where a thigh begins its parent ends."""
    names = {"lhipjoint": "LHip", "lfemur": "LeftThigh", "ltibia": "LeftShin", "lfoot": "LeftFoot"}
    names |= {"rhipjoint": "RHip", "rfemur": "RightThigh", "rtibia": "RightShin", "rfoot": "RightFoot"}
    want = read_motion(asf_amc(tmp_path / "a", asf(), amc()))
    got = read_motion(asf_amc(tmp_path / "b", asf(names=names), amc(names=names)))
    for mark in ("left_hip", "left_knee", "left_ankle", "right_knee"):
        at = got.positions_w_m[:, got.landmarks()[mark]]
        np.testing.assert_allclose(at, want.positions_w_m[:, want.landmarks()[mark]], atol=1e-9)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("lfoot 0.00000000\n", "", "frame 1 has no lfoot|lfoot does not occur"),
        ("root 0 16 0.6000 0 0 0", "root 0 16 0.6000 0 0", r"line 13: root has 5 values where its skeleton has 6"),
        ("root 0 16 0.6000 0 0 0", "root 0 16 nan 0 0 0", r"line 13: a value of root is not finite"),
        ("root 0 16 0.6000 0 0 0", "root 0 16 x 0 0 0", r"line 13: .* not a number"),
    ],
)
def test_wrong_rows_of_an_amc_are_named(tmp_path: Path, old: str, new: str, what: str) -> None:
    path = asf_amc(tmp_path / "a", asf(), amc().replace(old, new, 1))
    with pytest.raises(InvalidInputError, match=what):
        read_motion(path)


def test_an_amc_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf(), "\n".join(amc().splitlines()[:-3]))
    with pytest.raises(InvalidInputError, match="cut off"):
        read_motion(path)


def test_a_wrong_row_of_an_asf_is_named(tmp_path: Path) -> None:
    path = asf_amc(tmp_path / "a", asf().replace("length 7.2", "length long", 1), amc())
    with pytest.raises(InvalidInputError, match=r"^01.asf: line \d+: 'length long'"):
        read_motion(path)
