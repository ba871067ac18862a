"""The package is what the schema says, and its types hold."""

from __future__ import annotations

import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[1]


def test_the_generated_files_are_what_the_schema_says() -> None:
    done = subprocess.run([sys.executable, str(ROOT / "generate.py"), "--check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_types_hold(tmp_path: pathlib.Path) -> None:
    files = [str(ROOT / "src/posed"), str(ROOT / "generate.py"), str(ROOT / "tests")]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(tmp_path), *files],
        capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stdout
