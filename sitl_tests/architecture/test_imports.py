"""The import table of the house: each room may import these rooms of ours and these third parties, nothing else."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

from sitl_tests.architecture.sources import ROOT, offences, python_files, tree_of

ANY = frozenset({"*"})  # every room of the package and the mission scripts, or every third party
EVERYWHERE = frozenset({"units", "rate_limiter", "numbered_files"})  # importable by every room

# what judges a flight or a paper: everything below it, and the reporting room
_JUDGES = frozenset(
    {"core", "sim", "diagnosis", "calibration", "adapters", "reporting", "ports", "records", "errors", "params"}
)

# room (longest prefix wins) -> (rooms of ours, third parties)
TABLE: dict[str, tuple[frozenset[str], frozenset[str]]] = {
    "companion.records": (frozenset({"records"}), frozenset({"numpy"})),
    "companion.errors": (frozenset(), frozenset({"numpy"})),
    "companion.units": (frozenset(), frozenset()),
    "companion.rate_limiter": (frozenset(), frozenset()),
    "companion.numbered_files": (frozenset(), frozenset()),
    "companion.params": (frozenset({"params", "errors", "records"}), frozenset()),
    "companion.lifetime": (frozenset(), frozenset()),
    "companion.native": (frozenset({"native", "errors"}), frozenset({"numpy"})),
    "companion.ports": (frozenset({"records", "errors"}), frozenset()),
    # without scipy: every process of the service would carry its 50 MB
    "companion.core": (frozenset({"core", "native", "records", "errors", "params"}), frozenset({"numpy"})),
    "companion.core.stereo": (frozenset({"core", "records", "errors", "params"}), frozenset({"numpy", "cv2"})),
    "companion.adapters": (frozenset({"adapters", "native", "lifetime", "ports", "records", "errors", "params"}), ANY),
    "companion.sim": (
        frozenset(
            {
                "sim",
                "lifetime",
                "ports",
                "records",
                "errors",
                "params",
                "core.wing",
                "core.stereo.rotation",
                "core.stereo.geometry",
            }
        ),
        frozenset({"numpy", "scipy", "cv2", "pymavlink"}),
    ),
    "companion.calibration": (
        frozenset({"calibration", "core", "records", "errors", "params"}),
        frozenset({"numpy", "scipy", "cv2"}),
    ),
    "companion.diagnosis": (
        frozenset({"diagnosis", "core", "native", "sim", "records", "errors", "params"}),
        frozenset({"numpy", "scipy"}),
    ),
    "companion.setup": (frozenset({"setup", "params", "errors", "records"}), frozenset()),
    "companion.reporting": (
        frozenset({"reporting", "records", "errors"}),
        frozenset({"numpy", "matplotlib", "jinja2", "markupsafe"}),
    ),
    "companion.evaluation": (_JUDGES | {"evaluation"}, frozenset({"numpy", "scipy", "matplotlib", "cv2"})),
    "companion.evaluation.fleet.cluster": (frozenset({"evaluation.fleet", "errors"}), frozenset({"distributed"})),
    "companion.evaluation.fleet.parquet": (frozenset({"errors"}), frozenset({"pyarrow"})),
    "companion.doctor": (_JUDGES | {"doctor", "evaluation.plan_outcomes"}, frozenset({"numpy", "pymavlink"})),
    "companion.paper": (_JUDGES | {"paper", "evaluation"}, frozenset({"numpy", "scipy", "matplotlib", "cv2"})),
    # the live view: the recordings' topics and schemas over a websocket; the SDK comes with an extra
    "companion.live": (
        frozenset({"live", "adapters.recordings", "params", "records", "errors"}),
        frozenset({"foxglove", "psutil"}),
    ),
    "companion.service": (
        frozenset(
            {
                "service",
                "core.pipeline",
                "core.containment",
                "live.config",
                "lifetime",
                "ports",
                "params",
                "records",
                "errors",
            }
        ),
        frozenset({"numpy"}),
    ),
    "companion.service.wiring": (
        frozenset({"service", "core.pipeline", "lifetime", "live", "ports", "params", "records", "errors", "adapters"}),
        frozenset({"numpy"}),
    ),
    "companion.cli": (ANY, ANY),
    "companion": (frozenset(), frozenset()),
    "mission_scripts": (frozenset({"cli", "errors", "params", "mission_scripts"}), frozenset({"mavsdk"})),
    # tests may import tools, never the other way
    "tools": (ANY | {"tools"}, ANY),
    # the oracle speaks the records' language; the truths of the blind trials not even that
    "tools.reference": (frozenset({"tools.reference", "records"}), frozenset({"numpy", "scipy"})),
    "tools.trial_truths": (frozenset({"tools.trial_truths"}), frozenset({"numpy", "scipy", "numba"})),
}

# the rooms that may read a clock
CLOCK_ROOMS = (
    "companion.adapters",
    "companion.lifetime",
    "companion.service",
    "companion.sim",
    "companion.evaluation",
    "companion.doctor",
    "companion.cli",
    "mission_scripts",
)
PURE_FORBIDDEN = {
    "time",
    "datetime",
    "threading",
    "multiprocessing",
    "logging",
    "random",
    "socket",
    "subprocess",
    "asyncio",
    "os",
    "io",
    "pathlib",
}
WALL_CLOCK = {"time.time", "time.time_ns", "datetime.now", "datetime.utcnow", "datetime.today", "datetime.datetime.now"}


def _module(name: str) -> str:
    """Dotted name of a file."""
    parts = Path(name).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = python_files("companion", "mission_scripts")
PROGRAMS = python_files("tools")


def _room(module: str) -> str:
    fitting = [room for room in TABLE if module == room or module.startswith(room + ".")]
    return max(fitting, key=len)


def _imports(tree: ast.AST) -> list[tuple[int, str]]:
    names: list[tuple[int, str]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative imports hide the room"
            names += [(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
    return names


def _allowed(name: str, ours: frozenset[str], third: frozenset[str]) -> bool:
    top = name.split(".")[0]
    if top in ("companion", "mission_scripts", "tools", "sitl_tests"):
        inner = name.removeprefix("companion.")
        by_name = any(inner == room or inner.startswith(room + ".") for room in ours | EVERYWHERE)
        return by_name or (ours >= ANY and top in ("companion", "mission_scripts"))
    if top in sys.stdlib_module_names or top == "__future__":
        return True
    return third == ANY or top in third


def _forbidden_imports(name: str) -> list[str]:
    ours, third = TABLE[_room(_module(name))]
    return [f"line {line}: {other}" for line, other in _imports(tree_of(name)) if not _allowed(other, ours, third)]


def _calls(name: str) -> set[str]:
    return {ast.unparse(node.func) for node in ast.walk(tree_of(name)) if isinstance(node, ast.Call)}


def _impure(name: str) -> set[str]:
    imports = {other for _, other in _imports(tree_of(name)) if other.split(".")[0] in PURE_FORBIDDEN}
    return imports | {call for call in _calls(name) if call in ("print", "open", "input") or ".random." in call}


def _clock_reads(name: str) -> set[str]:
    calls = _calls(name)
    monotonic = () if _module(name).startswith(CLOCK_ROOMS) else (call for call in calls if call.startswith("time."))
    return calls & WALL_CLOCK | {*monotonic}


def test_a_room_imports_only_what_the_table_allows() -> None:
    assert offences(MODULES + PROGRAMS, _forbidden_imports) == {}, "TABLE of this file says who may import whom"


def test_the_core_is_pure() -> None:
    impure = offences((name for name in MODULES if name.startswith("companion/core/")), _impure)
    assert impure == {}, "core takes times and random generators as arguments, and does no input or output"


def test_clocks_are_read_in_their_rooms_and_never_the_wall_clock() -> None:
    assert offences(MODULES, _clock_reads) == {}, f"time is an argument outside {CLOCK_ROOMS}; no wall clock anywhere"


def test_the_top_level_is_fixed() -> None:
    listed = {path.name for path in ROOT.iterdir() if path.is_dir() and not path.name.startswith(".")}
    assert listed - {"out", "build", "dist", "__pycache__", "spanwise.egg-info"} == {
        "companion",
        "mission_scripts",
        "config",
        "sitl_tests",
        "tools",
    }


def test_every_room_of_the_table_exists() -> None:
    names = {_module(name) for name in MODULES + PROGRAMS}
    missing = [
        room for room in TABLE if room not in names and room not in ("companion.service.wiring", "mission_scripts")
    ]
    assert not missing
