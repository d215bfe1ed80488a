"""Base and extras: the live service imports no extra, and a command whose extra is absent names it in a sentence."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from sitl_tests.ports import free_port

ROOT = Path(__file__).resolve().parents[2]
OPTIONAL = (
    "depthai",
    "gpiod",
    "mavsdk",
    "matplotlib",
    "jinja2",
    "rich",
    "foxglove",
    "psutil",
    "distributed",
    "dask",
    "pyarrow",
)
# a finder ahead of all others stands for an installation of the base alone
BASE_ALONE = f"""
import importlib, pkgutil, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {OPTIONAL!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
"""
BASE_ROOMS = ("core", "adapters", "live", "service", "params", "calibration", "diagnosis", "sim")
EVERY_MODULE = f"""
for room in {BASE_ROOMS!r}:
    package = importlib.import_module("companion." + room)
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
"""
COMMAND = "from companion.cli.main import main\nsys.exit(main({arguments!r}))"


def base_alone(program: str, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    surroundings = {"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin"}
    return subprocess.run(
        [sys.executable, "-c", BASE_ALONE + program], cwd=folder, env=surroundings, capture_output=True, text=True,
        timeout=120,
    )  # fmt: skip


def test_no_room_of_the_base_imports_an_extra() -> None:
    done = base_alone(EVERY_MODULE)
    assert done.returncode == 0, done.stderr


def test_every_command_s_options_are_read_without_any_extra() -> None:
    done = base_alone("from companion.cli.main import build_parser\nbuild_parser()")
    assert done.returncode == 0, done.stderr


def test_run_starts_without_any_extra(tmp_path: Path) -> None:
    link = f"udpin:127.0.0.1:{free_port()}"
    arguments = ["run", "--connect", link, "--airframe", "nadir-2m", "--parameters", str(tmp_path / "kept"),
                 "--cameras", "oak:CAM_B,CAM_C"]  # fmt: skip
    assert refusal(arguments, tmp_path) == (
        "spanwise run: OAK cameras need more than the base installation: pip install 'spanwise[oak]'"
    )


def refusal(arguments: list[str], folder: Path) -> str:
    done = base_alone(COMMAND.format(arguments=arguments), folder)
    assert done.returncode == 1, done.stdout + done.stderr
    return done.stderr.strip()


@pytest.mark.parametrize(
    "arguments",
    [
        ["demo"],
        ["paper"],
        ["report", "no.mcap"],
        ["identify", "flight", "no.tlog"],
        ["calibrate", "stereo", "no-folder", "--square-m", "0.1", "--airframe", "nadir-2m"],
        ["diagnose", "no.tlog", "--html", "page.html"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_a_command_with_pages_or_pictures_names_the_report_extra(arguments: list[str], tmp_path: Path) -> None:
    assert refusal(arguments, tmp_path) == (
        f"spanwise {arguments[0]}: pages and pictures need more than the base installation: "
        "pip install 'spanwise[report]'"
    )
    assert not list(tmp_path.iterdir()), "nothing is begun"


def test_a_gpio_trigger_names_its_extra(tmp_path: Path) -> None:
    arguments = ["run", "--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m", "--trigger",
                 "gpio:/dev/gpiochip0,17", "--parameters", str(tmp_path / "kept")]  # fmt: skip
    assert refusal(arguments, tmp_path) == (
        "spanwise run: GPIO triggers need more than the base installation: pip install 'spanwise[gpio]'"
    )


def test_a_live_view_names_its_extra(tmp_path: Path) -> None:
    arguments = ["run", "--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m", "--live",
                 "--parameters", str(tmp_path / "kept")]  # fmt: skip
    assert refusal(arguments, tmp_path) == (
        "spanwise run: live pages need more than the base installation: pip install 'spanwise[live]'"
    )


def test_a_mission_names_its_extra() -> None:
    done = base_alone("import mission_scripts.climb_sweep")
    assert done.returncode == 1
    assert done.stderr.strip() == (
        "mission scripts need more than the base installation: pip install 'spanwise[missions]'"
    )


def test_the_live_view_gives_way_to_lines_where_only_its_extra_is_absent() -> None:
    done = base_alone(
        "from companion.cli.terminal.status_view import live_view_possible\n"
        "sys.stdout.isatty = lambda: True\nprint(live_view_possible(plain=False))"
    )
    assert done.stdout == "False\n"
    assert "pip install 'spanwise[report]'" in done.stderr


def test_extras_and_lock_agree() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    (everything,) = extras["all"]
    joined = re.fullmatch(r"spanwise\[(.*)\]", everything)
    assert joined is not None
    assert set(joined[1].split(",")) == set(extras) - {"all", "dev"}
    locked = {line.partition("==")[0] for line in (ROOT / "requirements.lock").read_text().splitlines() if "==" in line}
    wanted = project["dependencies"] + [line for name in extras if name != "all" for line in extras[name]]
    names = {re.split(r"[<>=;\[ ]", line)[0].lower() for line in wanted}
    assert names <= {name.lower() for name in locked}
    assert not names & set(OPTIONAL) & {re.split(r"[<>=;\[ ]", line)[0] for line in project["dependencies"]}


def test_the_live_service_loads_no_scipy() -> None:
    """It would cost each of its processes 50 MB."""
    done = base_alone("import companion.service.wiring\nassert 'scipy' not in sys.modules")
    assert done.returncode == 0, done.stderr
