"""Shipped files refer to shipped files: every page, path and module that a file names is in the repository."""

from __future__ import annotations

import functools
import re
import subprocess
from pathlib import Path

import pytest

from sitl_tests.architecture.sources import ROOT, offences, text_of

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
THEORY += ["companion/calibration", "companion/diagnosis"]
KINDS = ("data", "model", "flights", "free_decay", "limit_cycles", "forced", "modal_tests", "selection")
THEORY += [f"companion/diagnosis/{kind}" for kind in KINDS]

# what our programs and the build write, and what a test invents
WRITTEN = {
    "report.md",
    "notes.md",
    "companion/native/kernels.so",
    "companion/core/wing/effects/damping/cubic_damping.py",
    "companion/diagnosis/weights.py",
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


def _module_exists(dotted: str) -> bool:
    """Whether a dotted name begins with a module of ours, and goes on with a name that stands in it."""
    words = dotted.split(".")
    for length in range(len(words), 0, -1):
        stem = "/".join(words[:length])
        for file in (f"{stem}.py", f"{stem}/__init__.py"):
            if file in SHIPPED:
                return length == len(words) or re.search(rf"\b{words[length]}\b", text_of(file)) is not None
    return False


@functools.cache
def _path_exists(path: str) -> bool:
    return path in FOLDERS or path in WRITTEN or f"{path}.py" in SHIPPED or any(ROOT.glob(path))


def _missing_pages(name: str) -> set[str]:
    pages = {page for page in _PAGE.findall(text_of(name)) if "://" not in page}
    return {page for page in pages if Path(page).name not in NAMES | WRITTEN}


def test_no_document_is_named_that_is_not_shipped() -> None:
    unshipped = offences(TEXTS, lambda name: UNSHIPPED.findall(text_of(name)))
    assert unshipped == {}, "say what the reader needs to know in place of a paper that is not shipped"


def test_pages_exist() -> None:
    assert offences(TEXTS, _missing_pages) == {}, "these pages are named and are not in the repository (git ls-files)"


def test_paths_exist() -> None:
    missing = offences(TEXTS, lambda name: {p for p in _PATH.findall(text_of(name)) if not _path_exists(p)})
    assert missing == {}, "these paths are named and are not in the repository (git ls-files)"


def test_modules_that_docstrings_name_exist() -> None:
    files = [name for name in TEXTS if name.endswith(".py")]
    missing = offences(files, lambda name: {m for m in _MODULE.findall(text_of(name)) if not _module_exists(m)})
    assert missing == {}, "these modules or members are named and do not exist"


@pytest.mark.parametrize("room", THEORY)
def test_a_room_s_readme_names_its_files(room: str) -> None:
    files = {path.name for path in (ROOT / room).glob("*.py")} - {"__init__.py"}
    page = f"{room}/README.md" if (ROOT / room / "README.md").exists() else f"{Path(room).parent}/README.md"
    assert {name for name in files if name not in text_of(page)} == set(), f"{page} has a row for each file of its room"


def test_every_room_has_a_readme() -> None:
    rooms = {Path(name).parent for name in SHIPPED if name.startswith("companion/") and name.endswith(".py")}
    doors = {room for room in rooms if len(room.parts) == 2} - {Path("companion/records")}  # its docstring is one
    assert {str(room) for room in doors if f"{room}/README.md" not in SHIPPED} == set(), "rooms without a README.md"
