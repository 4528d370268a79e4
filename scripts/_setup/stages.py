"""The stages of the set-up: virtual environment, packages, CMake files of the ROS wheels, colcon."""

from __future__ import annotations

import glob
import json
import os
import re
import shutil
import subprocess
from typing import Dict, Mapping, Optional, Sequence

from _setup import environment, machine, state
from _setup.checkout import Checkout
from _setup.children import run_logged
from _setup.report import UNSUITABLE, SetupError, Stage

# Part of every key; increase it when a stage changes, so that it runs again.
STAGE_VERSION = 1
LOCKS = ("run.lock", "build.lock")
# Commands and options that need extra packages, which their first start installs.
EXTRA_LOCKS = {
    "bench": "bench.lock",
    "deploy": "deploy.lock",
    "docs": "docs.lock",
    "export": "sweep.lock",
    "foxglove": "foxglove.lock",
    "soak": "test.lock",
    "sweep": "sweep.lock",
    "test": "test.lock",
    "view": "view.lock",
}
NEEDED_BYTES = 1_200_000_000
FINISHED = re.compile(r"^Finished <<< (\w+) ", re.MULTILINE)  # what colcon says of a package that is built
MANY = 4  # the message names up to this number of packages
PIP_INSTALL = (
    *(
        "-m",
        "pip",
        "install",
        "--require-hashes",
        "--no-deps",
        "--no-input",
        "--no-compile",
        "--progress-bar=off",
    ),
    *("--no-build-isolation", "--use-pep517", "--disable-pip-version-check"),
)
NOT_COMPILED = r"/(tests?|testing|colcon_[a-z_]+|docutils|pip)/"


def make_environment(checkout: Checkout, python: machine.Interpreter, environ: Mapping[str, str], lock: int) -> None:
    """Recreate .venv and install the locked packages for runs and builds."""
    free = shutil.disk_usage(checkout.root).free
    if free < NEEDED_BYTES:
        raise SetupError(
            f"{checkout.root} has {free / 1e6:.0f} MB free; the set-up needs {NEEDED_BYTES / 1e6:.0f} MB",
            UNSUITABLE,
        )
    state.remove_stamp(checkout.environment_stamp)
    stage = Stage(f"virtual environment, Python {python.version} ({python.path})")
    remove_tree(checkout.venv)
    clean = environment.clean(environ, checkout.venv)
    run_logged([python.path, "-I", "-m", "venv", checkout.venv], checkout.log("setup-venv.log"), clean, lock)
    stage.done()
    stage = Stage("packages for runs and builds (downloads about 200 MB)")
    install_setuptools(checkout, checkout.log("setup-setuptools.log"), clean, lock)
    install_locked(checkout, LOCKS, checkout.log("setup-packages.log"), clean, lock, stage)
    point_cmake_files(checkout, clean)
    stage.done()
    state.write_stamp(
        checkout.environment_stamp,
        key=environment_key(checkout, python.path, python.version),
        python=python.path,
        version=python.version,
    )


def environment_key(checkout: Checkout, python: str, version: str) -> str:
    """Key of the virtual environment, including its location, since it contains absolute paths."""
    locks = [state.file_key(checkout.lock(name)) for name in LOCKS]
    return state.text_key(STAGE_VERSION, checkout.root, python, version, locks)


def current_environment(checkout: Checkout, wanted: Optional[machine.Interpreter]) -> Dict[str, str]:
    """Stamp of the virtual environment if it is complete, up to date and has the wanted Python; else empty."""
    stamp = state.read_stamp(checkout.environment_stamp)
    if not stamp or not os.access(checkout.python, os.X_OK):
        return {}
    if wanted and (wanted.path, wanted.version) != (stamp.get("python"), stamp.get("version")):
        return {}
    key = environment_key(checkout, stamp.get("python", ""), stamp.get("version", ""))
    return stamp if stamp.get("key") == key else {}


def forget_outdated_extras(checkout: Checkout) -> None:
    """Remove stamps of extra packages whose lock has changed, so that the next command reinstalls them."""
    for extra in EXTRA_LOCKS.values():
        stamp = checkout.extra_stamp(extra)
        if state.read_stamp(stamp).get("key") != state.file_key(checkout.lock(extra)):
            state.remove_stamp(stamp)


def install_extra(checkout: Checkout, command: str, environ: Mapping[str, str], lock: int) -> None:
    """Add the locked packages of a command to a complete virtual environment.

    Installed packages do not change, so swarms can run meanwhile. An interrupted installation is repeated.
    """
    extra = EXTRA_LOCKS[command]
    key = state.file_key(checkout.lock(extra))
    if state.read_stamp(checkout.extra_stamp(extra)).get("key") == key:
        return
    stage = Stage(f"packages for swarm {command}")
    forget_unfinished(checkout)
    clean = environment.clean(environ, checkout.venv)
    install_locked(checkout, (extra,), checkout.log(f"setup-{command}.log"), clean, lock, stage)
    state.write_stamp(checkout.extra_stamp(extra), key=key)
    stage.done()


def forget_unfinished(checkout: Checkout) -> None:
    """Make pip reinstall packages that an interrupted pip has left incomplete.

    These have no RECORD, which pip writes last.
    """
    packages = os.path.join(glob.escape(checkout.venv), "lib", "python3.*", "site-packages", "*.dist-info")
    for described in glob.glob(packages):
        if not os.path.exists(os.path.join(described, "RECORD")):
            remove_tree(described)


def install_setuptools(checkout: Checkout, log: str, environ: Mapping[str, str], lock: int) -> None:
    """Install the locked setuptools, which builds source packages."""
    with open(checkout.lock("run.lock"), encoding="utf-8") as file:
        entry = locked_entry(file.read(), "setuptools")
    requirements = os.path.join(checkout.venv, "setuptools.lock")
    with open(requirements, "w", encoding="utf-8") as file:
        file.write(entry)
    run_logged([checkout.python, *PIP_INSTALL, "-r", requirements], log, environ, lock)


def install_locked(
    checkout: Checkout, names: Sequence[str], log: str, environ: Mapping[str, str], lock: int, stage: Stage
) -> None:
    """Install exactly the requirements of the lock files, each verified by its hash."""
    requirements = [part for name in names for part in ("-r", checkout.lock(name))]
    pip = [checkout.python, *PIP_INSTALL, *requirements]
    run_logged(pip, log, environ, lock, lambda text: stage.progress(pip_progress(text)))
    # Compile now: otherwise hundreds of nodes that start together would each compile their imports.
    stage.progress("compiling")
    modules = glob.glob(os.path.join(checkout.venv, "lib", "python3.*", "site-packages"))
    compiler = [checkout.python, "-m", "compileall", "-q", "-j", "0", "-x", NOT_COMPILED, *modules]
    run_logged(compiler, f"{log}.compile", environ, lock)


def locked_entry(text: str, name: str) -> str:
    """One requirement of a lock file with its hashes."""
    found = re.search(rf"^{re.escape(name)}==(?:[^\n]*\\\n)*[^\n]*\n", text, re.MULTILINE)
    if not found:
        raise SetupError(f"run.lock does not pin {name}; restore it from the repository", UNSUITABLE)
    return found.group()


def pip_progress(text: str) -> str:
    """Progress of pip according to its log."""
    if "\nInstalling collected packages" in text:
        return "unpacking"
    return f"{text.count('Collecting ')} downloaded"


def point_cmake_files(checkout: Checkout, environ: Mapping[str, str]) -> None:
    """Set the Python and numpy include folders in the CMake files of the wheels to those of this machine."""
    asked = "import json, numpy, sysconfig as s; print(json.dumps([s.get_path('include'), numpy.get_include()]))"
    answer = subprocess.run([checkout.python, "-c", asked], env=dict(environ), stdout=subprocess.PIPE, check=True)
    python_include, numpy_include = json.loads(answer.stdout)
    for path in glob.glob(os.path.join(checkout.venv, "share", "*", "cmake", "*.cmake")):
        with open(path, encoding="utf-8") as file:
            found = file.read()
        rewritten = point_includes(found, python_include, numpy_include)
        if rewritten != found:
            with open(path, "w", encoding="utf-8") as file:
                file.write(rewritten)


def point_includes(text: str, python_include: str, numpy_include: str) -> str:
    """Return CMake code with the include folders of the build machine replaced."""
    text = re.sub(r"/opt/python/[^/;\"]+/include/python3\.\d+", lambda _: python_include, text)
    built_numpy = r"/opt/python/[^/;\"]+/lib/python3\.\d+/site-packages/numpy/_?core/include"
    return re.sub(built_numpy, lambda _: numpy_include, text)


def changed_packages(checkout: Checkout, owner: str) -> Dict[str, str]:
    """Names and keys of the packages that are not installed or have changed since."""
    keys = {
        name: state.content_key(os.path.join(checkout.source, name), STAGE_VERSION, owner)
        for name in state.packages_in(checkout.source)
    }
    return {name: key for name, key in keys.items() if state.read_stamp(checkout.package_stamp(name)).get("key") != key}


def install_changed(
    checkout: Checkout,
    key: str,
    colcon: Sequence[str],
    environ: Mapping[str, str],
    lock: int,
    cmake_arguments: Sequence[str] = (),
) -> None:
    """Update install/ from src/: rebuild changed packages from scratch, remove deleted ones.

    Packages depend on each other only at run time, so dependents of a changed package are not rebuilt.
    """
    owner = os.path.join(checkout.install, state.STAMPS, "owner")
    if state.read_stamp(owner).get("key") != key:
        forget_install(checkout)
        state.write_stamp(owner, key=key)
    changed = changed_packages(checkout, key)
    stamps = os.path.join(checkout.install, state.STAMPS, "*.package")
    stamped = {os.path.basename(path)[: -len(".package")] for path in glob.glob(stamps)}
    for name in sorted(stamped - set(state.packages_in(checkout.source))):
        uninstall(checkout, name)
    if not changed:
        return
    if any(os.path.exists(os.path.join(checkout.source, name, "CMakeLists.txt")) for name in changed):
        machine.check_build_tools(environ)
    stage = Stage(f"building {', '.join(changed) if len(changed) <= MANY else f'{len(changed)} packages'}")
    for name in changed:
        uninstall(checkout, name)
    remove_tree(checkout.log("colcon"))
    command = [*colcon, "--log-base", checkout.log("colcon"), "build", "--merge-install"]
    command += ["--base-paths", checkout.source]
    command += ["--build-base", checkout.build, "--install-base", checkout.install]
    command += ["--event-handlers", "console_cohesion+", "desktop_notification-", "terminal_title-"]
    command += ["--packages-select", *changed, "--cmake-args", "-DBUILD_TESTING=OFF", "--no-warn-unused-cli"]
    command += cmake_arguments
    environ = dict(environ, COLCON_HOME=os.path.join(checkout.build, ".colcon"))  # ignores the user's defaults

    stamped.clear()

    def watch(log: str) -> None:
        """Stamp each package once it is built, so that a set-up after an interruption continues there."""
        for name in set(FINISHED.findall(log)) - stamped:
            stamped.add(name)
            state.write_stamp(checkout.package_stamp(name), key=changed[name])
        stage.progress(f"{len(stamped)} of {len(changed)} packages")

    run_logged(command, checkout.log("setup-build.log"), environ, lock, watch)
    for name in set(changed) - stamped:
        state.write_stamp(checkout.package_stamp(name), key=changed[name])
    stage.done()


def uninstall(checkout: Checkout, package: str) -> None:
    """Remove everything that a package has installed or left in build, starting with its stamp."""
    state.remove_stamp(checkout.package_stamp(package))
    remove_tree(os.path.join(checkout.build, package))
    installed = (
        f"include/{package}",
        f"lib/{package}",
        f"lib/lib{package}__*.so",
        f"lib/python3.*/site-packages/{package}",
        f"lib/python3.*/site-packages/{package}-*",
        f"share/{package}",
        f"share/ament_index/resource_index/*/{package}",
        f"share/colcon-core/packages/{package}",
    )
    for pattern in installed:
        for path in glob.glob(os.path.join(glob.escape(checkout.install), pattern)):
            remove_tree(path)


def forget_install(checkout: Checkout) -> None:
    """Remove everything built for another environment, starting with the stamps."""
    for folder in (os.path.join(checkout.install, state.STAMPS), checkout.install, checkout.build):
        remove_tree(folder)


def remove_tree(path: str) -> None:
    """Remove a file or a folder with its contents, if it exists."""
    if os.path.isdir(path) and not os.path.islink(path):
        shutil.rmtree(path)
    else:
        state.remove_stamp(path)
