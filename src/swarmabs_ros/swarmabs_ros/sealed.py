"""The keys of a node of a sealed swarm, which only such a node needs the package cryptography for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from swarmabs_config.installation import lacking

if TYPE_CHECKING:
    from swarmabs_core.realtime.seals import SealFiles, Seals


def seals_in(files: SealFiles, author: int) -> Seals | None:
    """Return the keys of an author in files, None if its swarm is not sealed.

    Raises
    ------
    InputError
        If the files cannot be used, or the package cryptography is missing.
    """
    if not files.key:
        return None
    try:
        from swarmabs_config import seals  # noqa: PLC0415 - cryptography is optional
    except ModuleNotFoundError as error:
        raise lacking(error, "a node that signs its states") from error
    return seals.opened(files, author)
