"""Shipped files refer to shipped files: every page, path and module that a file names is in the repository."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
_LISTED = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
SHIPPED = [name for name in sorted(_LISTED) if (ROOT / name).is_file()]
TEXTS = [
    name
    for name in SHIPPED
    if name.endswith((".py", ".md", ".toml", ".c", ".h", "Makefile", ".ci/run"))
    and name != "sitl_tests/architecture/test_documents.py"  # names what it looks for
]
NAMES = {Path(name).name for name in SHIPPED}
FOLDERS = {str(parent) for name in SHIPPED for parent in Path(name).parents}

# rooms whose README is the theory of every file in them
THEORY = [f"companion/core/{room}" for room in ("clock", "kernels", "stereo", "tracking", "trigger", "wing")]
THEORY += ["companion/calibration"]

# what our programs and the build write, and what a test invents
WRITTEN = {
    "report.md",
    "notes.md",
    "companion/native/kernels.so",
    "companion/core/wing/effects/damping/cubic_damping.py",
}
# papers and trackers of the workshop, which a reader of the repository does not have
UNSHIPPED = re.compile(r"\b(?:DESIGN|FACTS|GLOSSARY|BRIEF)\b|\b[Ii]ssue #?\d+\b")

_PAGE = re.compile(r"(?<![\w/])[\w./-]*[\w-]\.md\b")
_PATH = re.compile(
    r"(?<![\w/.~<{-])(?:companion|sitl_tests|tools|config|mission_scripts)(?:/[\w*-]+)+"
    r"(?:\.(?:py|md|toml|c|h|so|png|html\.j2|html|css|service|rules))?(?![\w<{])"
)
_MODULE = re.compile(
    r":(?:mod|class|func|data|meth|attr):`~?((?:companion|mission_scripts|tools|sitl_tests)(?:\.\w+)+)`"
)


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _module_exists(dotted: str) -> bool:
    """Whether a dotted name begins with a module of ours, and goes on with a name that stands in it."""
    words = dotted.split(".")
    for length in range(len(words), 0, -1):
        stem = "/".join(words[:length])
        for file in (f"{stem}.py", f"{stem}/__init__.py"):
            if file in SHIPPED:
                return length == len(words) or re.search(rf"\b{words[length]}\b", _text(file)) is not None
    return False


def _path_exists(path: str) -> bool:
    return path in FOLDERS or path in WRITTEN or f"{path}.py" in SHIPPED or any(ROOT.glob(path))


@pytest.mark.parametrize("name", TEXTS)
def test_no_document_is_named_that_is_not_shipped(name: str) -> None:
    assert UNSHIPPED.findall(_text(name)) == []


@pytest.mark.parametrize("name", TEXTS)
def test_pages_exist(name: str) -> None:
    pages = {page for page in _PAGE.findall(_text(name)) if "://" not in page}
    assert {page for page in pages if Path(page).name not in NAMES | WRITTEN} == set()


@pytest.mark.parametrize("name", TEXTS)
def test_paths_exist(name: str) -> None:
    assert {path for path in _PATH.findall(_text(name)) if not _path_exists(path)} == set()


@pytest.mark.parametrize("name", [name for name in TEXTS if name.endswith(".py")])
def test_modules_that_docstrings_name_exist(name: str) -> None:
    assert {module for module in _MODULE.findall(_text(name)) if not _module_exists(module)} == set()


@pytest.mark.parametrize("room", THEORY)
def test_a_room_s_readme_names_its_files(room: str) -> None:
    files = {path.name for path in (ROOT / room).glob("*.py")} - {"__init__.py"}
    assert {name for name in files if name not in _text(f"{room}/README.md")} == set()


def test_every_room_has_a_readme() -> None:
    rooms = {Path(name).parent for name in SHIPPED if name.startswith("companion/") and name.endswith(".py")}
    doors = {room for room in rooms if len(room.parts) == 2} - {Path("companion/records")}  # its docstring is one
    assert {str(room) for room in doors if f"{room}/README.md" not in SHIPPED} == set()
