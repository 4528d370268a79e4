"""Section Stability: the two general theorems."""

import numpy as np
from scipy.integrate import solve_ivp


def test_coupling_must_be_dominated_on_the_axes_too() -> None:
    """thm. GeneralStability asks for eq. inequality where z_p and z_a are both not 0; one of them suffices to fail.

    z_p' = -z_p + c z_p/(1 + z_a^2), z_a' = -z_a with V = z_p^2/2 + z_a^2/2: uncoupled -z_p^2 - z_a^2, coupled
    c z_p^2/(1 + z_a^2). The right condition, everywhere but at the origin, holds for c = 1/2 and refuses c = 1.
    """

    def rates(_: float, z: np.ndarray, c: float) -> list[float]:
        return [-z[0] + c * z[0] / (1.0 + z[1] ** 2), -z[1]]

    inside = np.random.default_rng(0).uniform(-2.0, 2.0, (1000, 2))
    for c, end, on_the_axis in ((1.0, np.sqrt(0.5), 0.0), (0.5, 0.0, 0.5)):
        zp, za = np.vstack([inside, [1.0, 0.0]]).T
        margin = zp**2 + za**2 - c * zp**2 / (1.0 + za**2)
        assert margin[:-1].min() > 0.0  # all that is printed holds
        assert margin[-1] == on_the_axis
        solution = solve_ivp(rates, (0.0, 40.0), (1.0, 1.0), args=(c,), rtol=1e-9, atol=1e-12)
        assert abs(solution.y[0, -1] - end) < 1e-6  # with c = 1, z_p does not go to 0


def test_constrained_domain_counts_bounded_states_twice() -> None:
    """thm. GeneralConstrainedStability: D_c = D_pc x D_ac x R^dim(y_p) x R^dim(y_a), though w holds y already."""
    z_p, z_a, y_p, y_a = 3, 2, 5, 0  # those of ARISE with single integrators
    w_p, w_a = z_p + y_p, z_a + y_a  # w = (z, y), of which D_pc and D_ac are sets
    assert w_p + w_a == z_p + y_p + z_a + y_a != w_p + w_a + y_p + y_a
