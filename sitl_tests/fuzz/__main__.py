"""``python -m sitl_tests.fuzz --seconds N [--target NAME] [--seed S] [--jobs J]``; exit code 1 for findings."""

from __future__ import annotations

import argparse
import functools
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from sitl_tests.fuzz.runner import Result, fuzz, make_case, run_case, table
from sitl_tests.fuzz.targets import NAMES, make_target

_FOLDER = Path("out/fuzz")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m sitl_tests.fuzz", description=__doc__, allow_abbrev=False)
    parser.add_argument("--seconds", type=float, default=120.0, metavar="N", help="of all targets together")
    parser.add_argument("--target", action="append", choices=NAMES, help="may be repeated; all by default")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="processes side by side")
    parser.add_argument("--case", type=int, metavar="NUMBER", help="run this case alone, here; needs one --target")
    options = parser.parse_args()
    names = options.target or list(NAMES)
    if options.case is not None:
        return _again(names[0], options.seed, options.case)
    share_s = options.seconds * options.jobs / len(names)

    def fuzz_target(name: str) -> Result:
        result = fuzz(functools.partial(make_target, name), options.seed, seconds=share_s, folder=_FOLDER)
        print(f"{name}: {result.cases} cases, {len(result.findings)} findings", file=sys.stderr, flush=True)
        return result

    with ThreadPoolExecutor(options.jobs) as pool:
        results = list(pool.map(fuzz_target, names))
    for finding in (finding for result in results for finding in result.findings):
        last = ascii(finding.problem.strip().splitlines()[-1][:160])
        print(f"{finding.target}, seed {finding.seed}, case {finding.number}: {last} (kept in {_FOLDER})")
    print(table(results))
    return 1 if any(result.findings for result in results) else 0


def _again(name: str, seed: int, number: int) -> int:
    target = make_target(name)
    target.warm()
    report = run_case(target, make_case(target, seed, number), number)
    print(report.problem or report.ending)
    return 1 if report.problem else 0


if __name__ == "__main__":
    sys.exit(main())
