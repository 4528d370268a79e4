"""Each package in ``src`` is one that ROS tools can build, test and release: manifest, change log, ament linters.

`colcon test` runs these tests for its package, and those of the package in the folder of its name (``colcon.pkg``).
"""

import ast
import configparser
import re
import sys
from collections.abc import Iterable
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from catkin_pkg.package import Package, parse_package
from catkin_pkg.package_version import get_forthcoming_label, rename_section
from tests.processes import ROOT

SOURCES = ROOT / "src"
NAMES = sorted(path.parent.name for path in SOURCES.glob("*/package.xml"))
KEYS = {
    "control": "python-control-pip",
    "lz4": "mcap-ros2-support",
    "markupsafe": "python3-jinja2",
    "mcap": "mcap-ros2-support",
    "mcap_ros2": "mcap-ros2-support",
    "mpl_toolkits": "python3-matplotlib",
    "pydantic_core": "python3-pydantic",
    "rosbags": "python3-rosbags-pip",
    "urdf_parser_py": "urdfdom_py",
    "zstandard": "mcap-ros2-support",
}
"""The rosdep keys of modules that have neither their own name nor that of Debian's package."""
WITHOUT_KEY = {"dask", "distributed", "foxglove", "gmpy2", "playwright", "pyarrow"}
"""Modules that rosdep does not know; all are optional, or of tests only."""
DISTRIBUTIONS = {"foxglove": "foxglove-sdk", "markupsafe": "jinja2", "mpl_toolkits": "matplotlib", "yaml": "PyYAML"}
LINTERS = {
    "ament_flake8": ["--config", str(ROOT / "scripts" / "ament_flake8.ini")],
    "ament_pep257": ["--convention", "numpy", "--add-ignore", "D105", "D107", "D401", "--"],
}
"""Arguments of the linters of ament: what ruff formats, or knows better, is left out."""

each_package = pytest.mark.parametrize("name", NAMES)


class Imports(ast.NodeVisitor):
    """Collect the top-level modules that a file imports when it runs."""

    def __init__(self) -> None:
        self.found: set[str] = set()

    def visit_If(self, node: ast.If) -> None:
        if ast.unparse(node.test) != "TYPE_CHECKING":
            self.generic_visit(node)

    def visit_Import(self, node: ast.Import) -> None:
        self.found |= {alias.name.partition(".")[0] for alias in node.names}

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        if not node.level:
            self.found.add(str(node.module).partition(".")[0])


def imported(files: Iterable[Path]) -> set[str]:
    visitor = Imports()
    for file in files:
        visitor.visit(ast.parse(file.read_text(encoding="utf-8")))
    return visitor.found - set(sys.stdlib_module_names)


def imported_by(name: str) -> set[str]:
    modules = (path for path in (SOURCES / name).rglob("*.py") if path.name != "setup.py")
    return imported(modules) - {name}


def manifest(name: str) -> Package:
    return parse_package(str(SOURCES / name))


def is_declared(module: str, keys: set[str]) -> bool:
    return module in WITHOUT_KEY or bool(keys & {module, f"python3-{module}", KEYS.get(module, module)})


def distributions(name: str, *options: str) -> set[str]:
    """Return what a package asks pip for: requirements of a setup.cfg, without versions."""
    setup = configparser.ConfigParser()
    setup.read(SOURCES / name / "setup.cfg", encoding="utf-8")
    sections = [setup.get("options", option, fallback="") for option in options]
    if not options and setup.has_section("options.extras_require"):
        sections = list(setup["options.extras_require"].values())
    return {re.split(r"[<>=]", line)[0] for section in sections for line in section.split()}


@each_package
def test_manifest_is_valid_and_agrees_with_all_others(name: str) -> None:
    warnings: list[str] = []
    found = parse_package(str(SOURCES / name), warnings=warnings)
    assert (found.name, found.package_format, found.licenses, warnings) == (name, 3, ["Apache-2.0"], [])
    assert found.version == manifest("swarmabs_core").version
    if (SOURCES / name / "setup.cfg").exists():
        setup = configparser.ConfigParser()
        setup.read(SOURCES / name / "setup.cfg", encoding="utf-8")
        assert dict(setup["metadata"]) | {"name": name, "version": found.version} == dict(setup["metadata"])


@each_package
def test_what_is_imported_is_declared(name: str) -> None:
    found, modules = manifest(name), imported_by(name)
    keys = {entry.name for entry in found.exec_depends}
    assert {module for module in modules if not is_declared(module, keys)} == set()
    assert {key for key in keys if key.startswith("python3-")} <= {
        KEYS.get(module, f"python3-{module}") for module in modules
    }
    tested = {*imported((ROOT / "tests" / name).rglob("*.py")), *imported([ROOT / "tests" / "conftest.py"])}
    needed = tested - {"tests", *NAMES}  # those above a package would make a circle
    keys |= {entry.name for entry in found.test_depends}
    assert {module for module in needed if not is_declared(module, keys)} == set()


def test_colcon_finds_an_order_in_which_to_build() -> None:
    needed = {name: (*manifest(name).build_depends, *manifest(name).exec_depends) for name in NAMES}
    TopologicalSorter({name: {entry.name for entry in entries} for name, entries in needed.items()}).prepare()


@pytest.mark.parametrize("name", [name for name in NAMES if (SOURCES / name / "setup.cfg").exists()])
def test_pip_is_asked_for_what_is_imported(name: str) -> None:
    required = distributions(name, "install_requires") - {"setuptools"}
    wheels = {DISTRIBUTIONS.get(module, module) for module in imported_by(name)}
    assert required <= wheels
    known = {
        wheel for package in NAMES for wheel in distributions(package, "install_requires") | distributions(package)
    }
    assert wheels & known <= required | distributions(name)


@each_package
@pytest.mark.filterwarnings("ignore:nodes.Node.traverse:DeprecationWarning")  # within catkin_pkg
def test_change_log_is_what_bloom_reads_once_the_release_tool_has_dated_it(name: str) -> None:
    version, text = manifest(name).version, (SOURCES / name / "CHANGELOG.rst").read_text(encoding="utf-8")
    assert f"\nChangelog for package {name}\n" in text
    if label := get_forthcoming_label(text):
        text = rename_section(text, label, f"{version} (2026-01-01)")
    log = populate_changelog_from_rst(Changelog(name), text)
    assert log.get_content_of_version(version)


@pytest.mark.system
@pytest.mark.ament
@each_package
@pytest.mark.parametrize("linter", LINTERS)
def test_ament_linters(linter: str, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    check = pytest.importorskip(f"{linter}.main", exc_type=ImportError)
    folders = [str(path.parent) for path in (SOURCES / name).glob("*/*.py")]
    code = check.main([*LINTERS[linter], *sorted(set(folders))]) if folders else 0
    assert code == 0, "".join(capfd.readouterr())
