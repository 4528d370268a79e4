"""The packages import as the contracts in ``pyproject.toml`` allow."""

import os
import subprocess
import sys

import pytest
from tests.processes import ROOT


@pytest.mark.timeout(300)
def test_imports_keep_to_the_contracts() -> None:
    program = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=ROOT,
        env={**os.environ, "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
