"""Generalised advantages against a hand-computed example; truncation is not termination."""

from __future__ import annotations

import numpy as np

from tracker_service.training.storage import Rollout, advantages, valid


def rollout() -> Rollout:
    r = Rollout.empty(3, 4, 1, 1)
    r.rewards[:] = 1.0
    r.values[:] = np.array([[2.0], [3.0], [4.0]])
    r.last_values[:] = 5.0
    return r


def test_by_hand() -> None:
    gamma, lam = 0.9, 0.5
    r = rollout()
    r.terminated[1, 1] = True
    r.truncated[1, 2] = True
    r.truncated_values[1, 2] = 10.0
    r.exploded[1, 3] = True
    got = advantages(r, gamma, lam)
    # Undisturbed: deltas 1 + .9 x (3, 4, 5) - (2, 3, 4) = 1.7, 1.6, 1.5, summed with weight .45.
    last = 1.5
    middle = 1.6 + 0.45 * last
    np.testing.assert_allclose(got[:, 0], [1.7 + 0.45 * middle, middle, last], rtol=1e-6)
    # Terminated at step 1: nothing follows, 1 - 3 = -2.
    np.testing.assert_allclose(got[:, 1], [1.7 + 0.45 * -2.0, -2.0, last], rtol=1e-6)
    # Truncated at step 1: the final observation's value follows, 1 + 9 - 3 = 7.
    np.testing.assert_allclose(got[:, 2], [1.7 + 0.45 * 7.0, 7.0, last], rtol=1e-6)
    # Exploded at step 1: that step is worth nothing to learn from.
    np.testing.assert_allclose(got[:, 3], [1.7, 0.0, last], rtol=1e-6)
    assert not valid(r)[1, 3]
    assert valid(r).sum() == 11
