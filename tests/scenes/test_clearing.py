"""Room for a body among objects."""

from __future__ import annotations

import numpy as np
import pytest

from shared.scenes.clearing import RING_M, clear_of
from shared.scenes.files import load_scene
from shared.scenes.schema import Scene


def test_a_body_on_the_sofa_is_put_before_it_or_beside_it() -> None:
    sofa = load_scene("sofa")  # it reaches from x = -1.85 to -0.95, y from -1.35 to 1.35
    for on, shortest_m in (((-1.1, 0.2), 0.5), ((-1.7, 0.2), 0.5), ((-1.4, 1.5), 0.2)):
        place = clear_of(sofa, on, 0.35)
        assert np.linalg.norm(place - on) == pytest.approx(shortest_m, abs=1.5 * RING_M)
        assert (np.abs(place - [-1.4, 0.0]) >= [0.8 - 1e-9, 1.7 - 1e-9]).any()
    for free in ((0.0, 0.0), (-0.59, 0.0), (-1.4, 1.71)):
        np.testing.assert_array_equal(clear_of(sofa, free, 0.35), free)


def test_a_turned_object_is_left_along_its_own_sides_and_ground_is_no_obstacle() -> None:
    block = {"name": "t", "shape": "box", "size_m": [1.0, 0.2, 0.4], "position_w_m": [2, 1, 0.4], "heading_deg": 90}
    table = Scene.model_validate({"bodies": [block]})
    np.testing.assert_allclose(clear_of(table, (2.1, 1.5), 0.3), (2.5, 1.5), atol=0.2)
    ramp = Scene.model_validate({"bodies": [{**block, "ground": True}]})
    np.testing.assert_array_equal(clear_of(ramp, (2.1, 1.5), 0.3), (2.1, 1.5))


@pytest.mark.parametrize("gap_m", [0.8, 1.0])
def test_between_two_objects_it_keeps_clear_of_both(gap_m: float) -> None:
    room = Scene.model_validate(
        {"bodies": [{"name": name, "shape": "cylinder", "size_m": [0.3, 0.5], "position_w_m": [x, 0, 0.5],
                     "mass_kg": 5} for name, x in (("a", 0.0), ("b", gap_m))]}
    )  # fmt: skip
    place = clear_of(room, (gap_m / 2, 0.05), 0.3)
    for x in (0.0, gap_m):
        assert np.abs(place - [x, 0.0]).max() >= 0.6 - 1e-9
    assert abs(place[1]) < 0.7
