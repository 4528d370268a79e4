"""The estimates of the region of attraction against values computed by hand."""

from __future__ import annotations

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config.theory import setting
from swarmabs_core.theory.state_feedback import corrected_eta, estimate, printed_eta, radius_squared

INERTIA = 0.5
# 0.0125 * 7.5^2 + 0.025 and 0.0125 * 5^2 + 0.025
AT_7_5, AT_5 = 0.728125, 0.3375


def test_the_radii_of_the_paper() -> None:
    assert radius_squared(0.2, corrected_eta(INERTIA, AT_7_5)) == pytest.approx(0.0326, abs=5e-5)
    assert radius_squared(0.2, corrected_eta(INERTIA, AT_5)) == pytest.approx(0.04, rel=1e-12)
    assert radius_squared(0.2, printed_eta(INERTIA, AT_5)) == pytest.approx(0.02, rel=1e-12)


def test_heavy_planes_have_one_eta() -> None:
    assert printed_eta(3.0, 1.0) == corrected_eta(3.0, 1.0) == 2.0


def test_the_papers_initial_state_has_the_true_error() -> None:
    # a(0) with g: 9.81 * 0.125 * (0.3552 - 0.3532 + 0.6762 - 0.4596), 0.125^2 * 1.8442; a_d(0) from tau = 3.1623 * 0.1
    torque, inertia = 9.81 * 0.125 * 0.2186, 0.015625 * 1.8442
    e_torque, e_inertia = 0.31623 - torque, 0.0125 * 0.31623**2 + 0.025 - inertia
    assert [e_torque, e_inertia] == pytest.approx([0.0482, -0.0026], abs=5e-5)
    found = estimate(setting(builtin("pd_het_4")))
    assert found is not None
    assert [found.setting.initial.torque, found.setting.initial.inertia] == pytest.approx([torque, inertia])
    assert found.error_squared(0.1, 0.0) == pytest.approx(0.01 + e_torque**2 + e_inertia**2, rel=1e-12)
    assert found.printed == pytest.approx(0.02)
    assert found.corrected == pytest.approx(0.04)


def test_the_torque_asked_for_is_limited() -> None:
    found = estimate(setting(builtin("pd_het_4")))
    assert found is not None
    e_torque, e_inertia = 5.0 - found.setting.initial.torque, AT_5 - found.setting.initial.inertia
    assert found.error_squared(0.0, 50.0) == pytest.approx(2500.0 + e_torque**2 + e_inertia**2, rel=1e-12)


def test_the_angles_bound_is_a_setting() -> None:
    found = estimate(setting(builtin("pd_het_4"), angle_max=0.4))
    assert found is not None
    assert found.corrected == pytest.approx(0.16)


def test_lqr_is_a_pd_law_with_other_gains() -> None:
    found = estimate(setting(builtin("pd_het_4", "controller.type=lqr")))
    assert found is not None
    assert [found.setting.law.k1, found.setting.law.k2] == pytest.approx([3.1623, 1.3066], abs=5e-5)


def test_there_is_none_for_arise() -> None:
    assert estimate(setting(builtin("arise_het_4"))) is None


def test_robots_that_join_later_are_not_there_yet() -> None:
    found = estimate(setting(builtin("pd_het_4", "faults.0={at: 1.0, kind: join, agent: 3}")))
    assert found is not None
    assert found.setting.initial.inertia == pytest.approx(0.015625 * (1.8442 - 0.6762))
