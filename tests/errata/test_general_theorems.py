"""Section Stability: the two general theorems."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp


def test_coupling_must_be_dominated_on_the_axes_too() -> None:
    """thm. GeneralStability asks for eq. inequality where z_p and z_a are both not 0; one of them suffices to fail.

    z_p' = -z_p + z_p/(1 + z_a^2), z_a' = -z_a with V = z_p^2/2 + z_a^2/2: uncoupled -z_p^2 - z_a^2, coupled
    z_p^2/(1 + z_a^2).
    """

    def margin(zp: float, za: float) -> float:
        return (zp**2 + za**2) - zp**2 / (1.0 + za**2)

    random = np.random.default_rng(0).uniform(-2.0, 2.0, (1000, 2))
    assert min(margin(zp, za) for zp, za in random) > 0.0  # all that is printed holds, and lyap_zero: 0 at 0

    start = np.array([1.0, 1.0])
    found = solve_ivp(lambda _, z: [-z[0] + z[0] / (1.0 + z[1] ** 2), -z[1]], (0.0, 40.0), start, rtol=1e-9, atol=1e-12)
    assert abs(found.y[0, -1] - np.sqrt(0.5)) < 1e-6  # z_p does not go to 0
    # The right condition, everywhere but at the origin, refuses it: on the axis z_a = 0 the margin is 0.
    assert margin(1.0, 0.0) == 0.0

    # With half of the coupling the right condition holds, and z_p does go to 0.
    assert min((zp**2 + za**2) - 0.5 * zp**2 for zp, za in [*random, (1.0, 0.0), (0.0, 1.0)]) > 0.0
    found = solve_ivp(lambda _, z: [-z[0] + 0.5 * z[0] / (1.0 + z[1] ** 2), -z[1]], (0.0, 40.0), start, rtol=1e-9)
    assert np.abs(found.y[:, -1]).max() < 1e-6


def test_constrained_domain_counts_bounded_states_twice() -> None:
    """thm. GeneralConstrainedStability: D_c = D_pc x D_ac x R^dim(y_p) x R^dim(y_a), though w holds y already."""
    z_p, z_a, y_p, y_a = 3, 2, 5, 0  # those of ARISE with single integrators
    state = z_p + y_p + z_a + y_a
    w_p, w_a = z_p + y_p, z_a + y_a  # w = (z, y), of which D_pc and D_ac are sets
    assert w_p + w_a + y_p + y_a != state
    assert w_p + w_a == state
