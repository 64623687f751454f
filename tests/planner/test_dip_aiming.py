"""Plans that keep what they are asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from planner_service.dip.aiming import MOST_M, MOST_ROOT_MPS, Aim, aimed, aims_of, toes_of
from planner_service.dip.conditions import JOINT_SLOTS, SLOT_JOINTS, KeyframeBatch, TargetBatch
from planner_service.dip.features_torch import plan_to_positions
from planner_service.training.dataset import WindowSampler, load_material
from shared.data.corpus import Corpus
from shared.motion.features import ROOT_HEIGHT, ROOT_VELOCITY
from shared.motion.skeleton import CANONICAL
from tests.planner.dip_helpers import write_small_corpus

FRAME = 25
WRIST, ELBOW, FOOT, PELVIS = CANONICAL.indices("right_wrist", "right_elbow", "left_foot", "pelvis")


@pytest.fixture(scope="module")
def plans(tmp_path_factory: pytest.TempPathFactory) -> Tensor:
    folder: Path = tmp_path_factory.mktemp("corpus")
    material = load_material(Corpus.load(write_small_corpus(folder / "v")), "train", 60)
    return WindowSampler(material, 20, 40, 0).draw(2).features[:, 20:]


def asked(plans: Tensor, slot: str, off_m: Tensor, kicks: bool = False) -> tuple[list[Aim], Tensor]:
    """The aim of the first plan's joint, `off_m` from where it is, and that place."""
    targets = TargetBatch.none(len(plans), 40)
    number = JOINT_SLOTS.index(slot)
    place = plan_to_positions(plans, 20)[0][0, FRAME - 1, SLOT_JOINTS[number]] + off_m
    targets.position_m[0, number] = place
    targets.position_valid[0, number] = True
    targets.position_frame[0, number] = FRAME
    return aims_of(targets, None, [kicks] * len(plans)), place


def test_a_hand_comes_to_its_place_and_nothing_but_its_arm_is_moved(plans: Tensor) -> None:
    off = torch.tensor([0.1, -0.05, 0.12])
    aims, place = asked(plans, "right_wrist", off)
    before, after = (plan_to_positions(p, 20)[0] for p in (plans, aimed(plans, aims)))
    torch.testing.assert_close(after[0, FRAME - 1, WRIST], place, atol=1e-5, rtol=0)
    torch.testing.assert_close(after[0, FRAME - 1, ELBOW] - before[0, FRAME - 1, ELBOW], off / 2, atol=1e-5, rtol=0)
    others = [joint for joint in range(22) if joint not in (WRIST, ELBOW)]
    torch.testing.assert_close(after[:, :, others], before[:, :, others])
    torch.testing.assert_close(after[1], before[1])
    moved = (after - before)[0, :, WRIST].norm(dim=-1)
    assert moved[0] < 1e-4 and moved[-1] < 0.01, "it leaves and comes back in time"
    step = torch.diff((after - before)[0, :, WRIST], dim=0).norm(dim=-1)
    assert step.max() < 0.2 * off.norm()


def test_what_is_out_of_reach_is_approached(plans: Tensor) -> None:
    aims, place = asked(plans, "right_wrist", torch.tensor([0.0, 0.9, 0.0]))
    after = plan_to_positions(aimed(plans, aims), 20)[0]
    assert float((after[0, FRAME - 1, WRIST] - place).norm()) == pytest.approx(0.9 - MOST_M, abs=1e-4)


def test_the_root_goes_there_and_on_as_before(plans: Tensor) -> None:
    off = torch.tensor([0.08, -0.1, 0.0])
    aims, place = asked(plans, "traj", off)
    out = aimed(plans, aims)
    before, after = (plan_to_positions(p, 20)[0] for p in (plans, out))
    torch.testing.assert_close(after[0, FRAME - 1, PELVIS, :2], place[:2], atol=1e-4, rtol=0)
    torch.testing.assert_close((after - before)[0, -1, :, :2], off[:2].expand(22, 2), atol=1e-4, rtol=0)
    torch.testing.assert_close(after[..., 2], before[..., 2])
    assert float((out - plans)[0, 0, ROOT_VELOCITY].norm()) < 0.3 * float((out - plans)[0, 12, ROOT_VELOCITY].norm())


def test_the_root_is_moved_no_faster_than_legs_can(plans: Tensor) -> None:
    aims, place = asked(plans, "traj", torch.tensor([2.0, 0.0, 0.0]))
    after = plan_to_positions(aimed(plans, aims), 20)[0]
    left = float((after[0, FRAME - 1, PELVIS] - place)[:2].norm())
    assert left == pytest.approx(2.0 - MOST_ROOT_MPS * FRAME / 20, abs=1e-3)


def test_a_foot_comes_to_its_place_but_a_kick_is_the_networks_business(plans: Tensor) -> None:
    off = torch.tensor([0.0, 0.1, 0.05])
    aims, place = asked(plans, "left_foot", off)
    after = plan_to_positions(aimed(plans, aims), 20)[0]
    torch.testing.assert_close(after[0, FRAME - 1, FOOT], place, atol=1e-5, rtol=0)
    assert toes_of(aims, 0) == {"left": [FRAME - 1]}
    assert toes_of(aims, 1) == {}
    assert asked(plans, "left_foot", off, kicks=True)[0] == []


@pytest.mark.parametrize(("sunk_m", "lifted_m"), [(0.06, 0.06), (-0.06, 0.0)])
def test_who_sits_is_lifted_out_of_the_seat_and_moved_no_other_way(
    plans: Tensor, sunk_m: float, lifted_m: float
) -> None:
    seated = plans.clone()
    seated[:, :, ROOT_HEIGHT] -= 0.5
    aims, _ = asked(seated, "pelvis", torch.tensor([0.1, 0.1, sunk_m]))
    before, after = (plan_to_positions(p, 20)[0] for p in (seated, aimed(seated, aims)))
    assert float((after - before)[0, FRAME - 1, PELVIS, 2]) == pytest.approx(lifted_m, abs=1e-5)
    torch.testing.assert_close(after[..., :2], before[..., :2])


def test_a_pose_is_kept_with_its_feet(plans: Tensor) -> None:
    keys = KeyframeBatch.none(len(plans), 40)
    positions = plan_to_positions(plans, 20)[0]
    rng = np.random.default_rng(0)
    keys.position_m[1, FRAME - 1] = positions[1, FRAME - 1] + torch.from_numpy(rng.normal(0, 0.03, (22, 3))).float()
    keys.mask[1, FRAME - 1] = True
    after = plan_to_positions(aimed(plans, aims_of(TargetBatch.none(2, 40), keys, [False, False])), 20)[0]
    torch.testing.assert_close(after[1, FRAME - 1], keys.position_m[1, FRAME - 1], atol=1e-4, rtol=0)
    alone = KeyframeBatch(keys.position_m, keys.mask & (torch.arange(22) == FOOT))
    assert [aim.joint for aim in aims_of(TargetBatch.none(2, 40), alone, [False, False])] == [FOOT]
    assert aims_of(TargetBatch.none(2, 40), alone, [False, True]) == []
