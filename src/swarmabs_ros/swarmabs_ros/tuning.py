"""The gains of a node in real time: parameters that may be set while it is not active."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcl_interfaces.msg import SetParametersResult

from swarmabs_core.errors import InputError
from swarmabs_ros.parameters import NO_SIM_TIME, SIM_TIME, plain

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from rclpy.lifecycle import LifecycleNode
    from rclpy.parameter import Parameter as RosParameter

    from swarmabs_core.parameters import Parameter
    from swarmabs_ros.runner import Settings

    Tune = Callable[[Settings], Callable[[], None]]


def gains_among(table: Iterable[Parameter], parts: tuple[str, ...]) -> tuple[Parameter, ...]:
    """Return the parameters of a table with or below the names `parts`, except for those that select a type."""

    def tunable(name: str) -> bool:
        return not name.endswith(".type") and any(name == part or name.startswith(f"{part}.") for part in parts)

    return tuple(parameter for parameter in table if tunable(parameter.name))


class Tuning:
    """The settings of a node, including gains, which may be set while the node is not active.

    Attributes
    ----------
    settings : Settings
        The current values.
    """

    def __init__(self, settings: Settings, gains: Iterable[Parameter]) -> None:
        self.settings = settings
        self._gains = {parameter.name: parameter for parameter in gains}
        self._tune: Tune | None = None
        self._install: Callable[[], None] | None = None
        self._next: tuple[Settings, Callable[[], None] | None] = settings, None

    def configured(self, tune: Tune | None) -> None:
        """Register how a behaviour created from the current settings adopts new gains; None: no behaviour."""
        self._tune, self._install = tune, None

    def taken(self) -> Callable[[], None] | None:
        """Return a callable that installs the gains set since the behaviour was created, None if there are none."""
        install, self._install = self._install, None
        return install

    def serve(self, node: LifecycleNode, state: Callable[[], str]) -> None:
        """Register callbacks for parameter changes; `state` returns the node's lifecycle state."""

        def check(parameters: list[RosParameter]) -> SetParametersResult:
            try:
                self._check(node.get_name(), state(), parameters)
            except InputError as error:
                return SetParametersResult(successful=False, reason=str(error))
            return SetParametersResult(successful=True)

        def adopt(parameters: list[RosParameter]) -> None:
            self.settings, self._install = self._next
            for parameter in parameters:
                value = plain(parameter.value)
                node.get_logger().info(f"{parameter.name} set to {list(value) if isinstance(value, tuple) else value}")

        node.add_on_set_parameters_callback(check)
        node.add_post_set_parameters_callback(adopt)

    def _check(self, name: str, state: str, parameters: list[RosParameter]) -> None:
        """Raise `InputError` if the parameters cannot be set; otherwise store the result in `_next`."""
        new = {}
        for parameter in parameters:
            if parameter.name == SIM_TIME and parameter.value:
                raise InputError(NO_SIM_TIME)
            if parameter.name in self._gains:
                new[parameter.name] = self._gains[parameter.name].check(plain(parameter.value))
        if new and state not in {"unconfigured", "inactive"}:
            raise InputError(
                f"parameter {min(new)}: {name} is {state}, and gains take effect when it is activated; "
                f"deactivate it first: ros2 lifecycle set {name} deactivate"
            )
        settings = self.settings.changed(new)
        self._next = settings, self._install
        if new and self._tune is not None:
            self._next = settings, self._tune(settings)
