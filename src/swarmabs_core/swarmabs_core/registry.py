"""Parts of the system that are looked up by name: first built-in parts, then plug-ins from installed packages.

A package provides a part as an entry point. Installed packages are searched only for names that are not built in, so a
run with built-in parts has no overhead.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from swarmabs_core.errors import InputError
from swarmabs_core.parameters import Parameter, resolve

if TYPE_CHECKING:
    from collections.abc import Iterator
    from importlib.metadata import EntryPoint

    from swarmabs_core.parameters import Settings

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_PATH = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)*")
_REMEDY = "repair the package, or uninstall it"


class PluginError(InputError):
    """A plug-in of an installed package cannot be used."""

    def __init__(self, problem: str, remedy: str) -> None:
        super().__init__(" ".join(problem.split()), remedy)


ContextT = TypeVar("ContextT")
MadeT = TypeVar("MadeT")


@dataclass(frozen=True, slots=True)
class Part(Generic[ContextT, MadeT]):
    """An entry of a registry; a package provides one such object.

    The scenario's schema and the parameters of nodes follow from its settings. `make` creates the part from all
    settings, checked, and a context, which is what it may know about the system. The description is a short phrase.
    """

    name: str
    settings: tuple[Parameter, ...]
    make: Callable[[Settings, ContextT], MadeT]
    description: str = ""


class Registry(Mapping[str, Part[ContextT, MadeT]], Generic[ContextT, MadeT]):
    """Parts of one sort by name.

    A look-up loads at most one package; iteration yields all names without loading any. The built-in parts are also in
    the mapping `built_in`.

    Parameters
    ----------
    noun : str
        Name for such a part in errors.
    group : str
        Entry point group of the packages' parts.
    shape : type
        Required type of the object behind an entry point.
    built_in : tuple of Part
        The built-in parts, which no package can replace.
    methods : tuple of str
        Methods that objects made by a part must have.
    """

    def __init__(
        self,
        noun: str,
        group: str,
        shape: type[Part[ContextT, MadeT]],
        built_in: tuple[Part[ContextT, MadeT], ...],
        methods: tuple[str, ...],
    ) -> None:
        self._noun = noun
        self.group = group
        self._shape = shape
        self.built_in: Mapping[str, Part[ContextT, MadeT]] = {part.name: part for part in built_in}
        self._methods = methods
        self._loaded: dict[str, Part[ContextT, MadeT]] = {}
        self._packages: dict[str, tuple[str, str]] = {}

    def __getitem__(self, name: str) -> Part[ContextT, MadeT]:
        """Return a part.

        Raises
        ------
        KeyError
            If there is no part with this name.
        PluginError
            If the package that provides it is unusable; the text names the package and the problem.
        """
        if name in self.built_in:
            return self.built_in[name]
        if name not in self._loaded:
            self._loaded[name] = self._load(name, self._brought()[name])
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in self.built_in or name in self._loaded or name in self._brought()

    def __iter__(self) -> Iterator[str]:
        yield from self.built_in
        yield from sorted(self._brought())

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def find(self, name: str) -> Part[ContextT, MadeT]:
        """Look up a part by a name from the user.

        Raises
        ------
        InputError
            If there is no part with this name, or the package that provides it is unusable.
        """
        try:
            return self[name]
        except KeyError:
            raise InputError(f"there is no {self._noun} {name!r}", f"available: {', '.join(sorted(self))}") from None

    def make(self, name: str, settings: Settings, context: ContextT) -> MadeT:
        """Create the object of a part; omitted settings have their defaults.

        Raises
        ------
        InputError
            If the name is unknown, a setting is invalid, or the object lacks a required method.
        """
        part = self.find(name)
        instance = part.make(resolve(part.settings, settings, owner=f"{self._noun} {name!r}"), context)
        for method in self._methods:
            if not callable(getattr(instance, method, None)):
                what = f"{self._noun} {name!r} makes an object of type {type(instance).__name__}"
                raise PluginError(f"{what}, which has no method {method}", _REMEDY)
        return instance

    def package(self, name: str) -> tuple[str, str] | None:
        """Return name and version of the package that provides a part; None for a built-in part."""
        self.find(name)
        return self._packages.get(name)

    def forget(self) -> None:
        """Forget the parts from packages: each is loaded again on its next look-up."""
        self._loaded.clear()
        self._packages.clear()

    def _brought(self) -> dict[str, list[EntryPoint]]:
        """Return the entry points of all installed packages by name."""
        from importlib.metadata import entry_points  # noqa: PLC0415 - built-in parts do not need it

        points: dict[str, list[EntryPoint]] = {}
        for point in entry_points(group=self.group):
            if point.name in self.built_in:
                raise PluginError(
                    f"{_origin(point)} provides a {self._noun} {point.name!r}, which is a built-in name",
                    "rename it, or uninstall the package",
                )
            points.setdefault(point.name, []).append(point)
        return points

    def _load(self, name: str, points: list[EntryPoint]) -> Part[ContextT, MadeT]:
        point, *others = points
        if others:
            origins = " and ".join(sorted(_origin(provider) for provider in points))
            raise PluginError(f"{self._noun} {name!r} is provided by {origins}", "uninstall all but one")
        what = f"{self._noun} {name!r} ({point.value} of {_origin(point)})"
        try:
            part = point.load()
        except Exception as error:  # a foreign module may raise anything; the error must name its package
            raise PluginError(f"{what} cannot be loaded: {type(error).__name__}: {error}", _REMEDY) from error
        if not isinstance(part, self._shape):
            problem = f"is an object of type {type(part).__name__}, not a {self._shape.__name__}"
            raise PluginError(f"{what} {problem}", _REMEDY)
        if problem := problem_of(name, part):
            raise PluginError(f"{what} {problem}", _REMEDY)
        if point.dist is not None:
            self._packages[name] = (point.dist.name, point.dist.version)
        return part


def _origin(point: EntryPoint) -> str:
    return "a package" if point.dist is None else f"package {point.dist.name} {point.dist.version}"


def problem_of(name: str, part: Any) -> str:
    """Return what is wrong with the content of a part of the right type; empty if nothing is."""
    if part.name != name or not _NAME.fullmatch(name):
        return f"is named {part.name!r}; entry point and object need the same name of lower-case letters, digits and _"
    if not callable(part.make):
        return "has no function make"
    settings = part.settings
    if not isinstance(settings, tuple) or not all(isinstance(parameter, Parameter) for parameter in settings):
        return "has settings that are not a tuple of Parameter"
    names, taken = {parameter.name for parameter in settings}, {"type"}
    for setting in settings:
        parents = {setting.name[: dot.start()] for dot in re.finditer(r"\.", setting.name)}
        if not _PATH.fullmatch(setting.name) or setting.name in taken or parents & (names | {"type"}):
            return f"has a setting {setting.name!r}, whose name is malformed or already taken"
        taken.add(setting.name)
        if not isinstance(setting.default, (bool, int, float, str, tuple)):
            return f"has a setting {setting.name!r} whose default is a {type(setting.default).__name__}"
        try:
            setting.check(setting.default)
        except InputError as error:
            return f"has a default outside its own bounds: {error}"
    return ""
