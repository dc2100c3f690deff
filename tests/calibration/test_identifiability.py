"""Words for what data do not tell, from information whose null direction is known."""

import numpy as np
import pytest

from calibration.solvers import covariance_and_lost

NAMES = ("half_angle", "b", "scale")


def seen_only(*directions: tuple[float, float, float]) -> np.ndarray:
    rows = np.array(directions)
    return 1e6 * rows.T @ rows


@pytest.mark.parametrize(
    ("seen", "values", "told"),
    [
        # d(log a) - d(log s) is seen: the ratio; with a plus, the product.
        (((0, 1, 0), (1, 0, -1)), (0.05, -5.0, 0.0067), "only the ratio of half_angle and scale"),
        (((0, 1, 0), (1, 0, 1)), (0.05, -5.0, 0.0067), "only the product of half_angle and scale"),
        # A negative parameter grows downwards.
        (((0, 0, 1), (1, 1, 0)), (0.05, -5.0, 0.0067), "only the ratio of half_angle and b"),
        (((0, 0, 1), (1, 3, 0)), (0.05, -5.0, 0.0067), "only a combination of half_angle and b"),
        (((1, 0, 0), (0, 1, 0)), (0.05, -5.0, 0.0067), "scale is not determined"),
    ],
)
def test_what_is_not_seen_is_said_with_a_remedy(seen, values, told):
    covariance, lost = covariance_and_lost(seen_only(*seen), NAMES, values)
    assert len(lost) == 1
    assert lost[0].startswith(told)
    assert "fix one, give a prior, or add" in lost[0]
    hidden = [name in told for name in NAMES]
    assert np.isinf(np.diag(covariance)[hidden]).all()
    assert np.isfinite(np.diag(covariance)[np.logical_not(hidden)]).all()
