"""Heights of the robots' centres of mass above the axis of the plane, which their messages do not contain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from swarmabs_core.declaration import setting
from swarmabs_core.parameters import SettingError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from swarmabs_core.plant import Plane


@dataclass(frozen=True, slots=True)
class Body:
    """What a robot's message does not contain of its body."""

    center_height: float = setting(0.0, "height of the centre of mass above the plane's axis at th = 0", unit="m")


@dataclass(frozen=True, slots=True)
class CenterHeights:
    """The heights of all robots that ever take part."""

    center_heights: tuple[float, ...] = setting(
        (), "heights of the centres of mass of the members, in their order; none: all 0", unit="m", item=0.0
    )

    def above(self, plane: Plane, members: Sequence[int]) -> Mapping[int, float] | None:
        """Return the heights (m) of members by id; None if all masses, also the plane's, are at height 0."""
        heights = self.center_heights or (0.0,) * len(members)
        return dict(zip(members, heights, strict=True)) if any(heights) or plane.moment else None

    def refuse_another_number(self, members: Sequence[int]) -> None:
        """Raise `SettingError` unless there is no height, or one for each member."""
        if self.center_heights and len(self.center_heights) != len(members):
            raise SettingError(
                "center_heights",
                f"{len(self.center_heights)} heights for {len(members)} members",
                "give one for each member, or none",
            )
