"""How much of a soak is run: a little by every test run, much with ``--full``, hours with a profile of hypothesis."""

from __future__ import annotations

from hypothesis import HealthCheck, Phase, settings

_SLOW = (HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example)
_NOT_MADE_SIMPLER = (Phase.explicit, Phase.reuse, Phase.generate)  # each run takes seconds

FEW = settings(
    max_examples=3,
    derandomize=True,
    database=None,
    deadline=None,
    phases=_NOT_MADE_SIMPLER,
    suppress_health_check=_SLOW,
)
"""The same few runs each time."""
LONG = settings(
    max_examples=settings().max_examples if settings.get_current_profile_name() == "hours" else 50,
    deadline=None,
    phases=_NOT_MADE_SIMPLER,
    suppress_health_check=_SLOW,
    print_blob=True,
)
"""Other runs each time; what fails is kept by hypothesis and run first the next time."""
