"""The demo's summary as tables for a person."""

from __future__ import annotations

from typing import Any

from companion.cli.terminal.status_view import console
from companion.evaluation.metrics import SETTLED_S

_NAMES = {
    "rigid": "rigid stereo (ground calibration)",
    "rigid_in_trim": "rigid stereo, calibrated in trim",
    "tilt_only": "corrected, matches unused",
    "corrected": "corrected by Spanwise",
    "oracle": "true extrinsics (oracle)",
    "vertical_only": "corrected, vertical axes alone",
    "random_instants": "corrected, random instants",
}


def print_summary(summary: dict[str, Any]) -> None:
    """Print the tables and sentences."""
    out = console()
    if not summary["shots"]["judged"]:
        shots = summary["shots"]
        out.print(
            f"no shot to judge: {shots['fired']} fired, {shots['pairs']} pairs, {shots['corrected']} corrected; "
            f"what is judged begins after {SETTLED_S:g} s, when the tracker has learned the wing"
        )
        out.print(f"plans: {_joined(shots['fates']) or 'none'}")
        return
    against = summary["against_corrected"]
    elsewhere = {name for name, pair in against.items() if not pair["same"]}
    out.print(_toe_table(summary["toe_error_mrad"], elsewhere))
    out.print(_range_table(summary["range_error_m"], elsewhere))
    if elsewhere:
        out.print(
            "* judges other shots than the rows above, so many of them: not to be compared with those shot by shot"
        )
    for name, pair in against.items():
        if pair["n"]:
            out.print(_paired(name, pair))
    for line in _sentences(summary):
        out.print(line)


def _paired(name: str, pair: dict[str, Any]) -> str:
    rms = pair["rms_mrad"]
    return (
        f"{_NAMES[name]} against all axes, on the same {pair['n']} shots: {rms['other']:.2f} against "
        f"{rms['corrected']:.2f} mrad rms, nearer the truth in {100 * pair['nearer']:.0f} % of them"
    )


def _row_name(name: str, elsewhere: set[str]) -> str:
    return f"{_NAMES[name]} *" if name in elsewhere else _NAMES[name]


def _toe_table(errors: dict[str, Any], elsewhere: set[str]) -> Any:
    table = _table("relative toe error, mrad (4.5 mrad makes 60 m read 52.8 m)")
    for column in ("", "shots", "rms", "median", "p95", "rms above 0.5 Hz"):
        table.add_column(column, justify="left" if not column else "right")
    for name, entry in errors.items():
        cells = [_number(entry.get(key), 2) for key in ("rms", "median", "p95")]
        table.add_row(_row_name(name, elsewhere), str(entry["n"]), *cells, _number(entry["fast"].get("rms"), 3))
    return table


def _range_table(errors: dict[str, Any], elsewhere: set[str]) -> Any:
    distances = list(errors["oracle"])
    table = _table("range error, m: median / 95th percentile (of so many shots)")
    table.add_column("")
    for distance in distances:
        table.add_column(f"at {distance} m ({errors['corrected'][distance]['n']})", justify="right")
    for name, entry in errors.items():
        cells = (_metres(entry[d], differs=entry[d]["n"] != errors["corrected"][d]["n"]) for d in distances)
        table.add_row(_row_name(name, elsewhere), *cells)
    return table


def _metres(entry: dict[str, Any], *, differs: bool) -> str:
    if not entry["n"]:
        return "no shots"
    count = f" of {entry['n']}" if differs else ""
    return f"{_number(entry['median'], 2)} / {_number(entry['p95'], 2)}{count}"


def _number(value: float | None, digits: int) -> str:
    return "∞" if value is None else f"{value:.{digits}f}"


def _sentences(summary: dict[str, Any]) -> list[str]:
    return [*_accuracy_sentences(summary), *_trigger_sentences(summary["trigger"]), *_shot_sentences(summary)]


def _accuracy_sentences(summary: dict[str, Any]) -> list[str]:
    target = summary["targets"]
    removed, excess, oracle = (
        target[name] for name in ("share_of_error_removed", "fast_excess_mrad2", "oracle_median_at_60_m")
    )
    return [
        f"error removed: {100 * removed['of_rigid']:.1f} % of rigid stereo's, "
        f"{100 * removed['of_rigid_calibrated_in_trim']:.1f} % of rigid stereo calibrated in trim (the paper: 55.6 %)",
        f"above 0.5 Hz: corrected² - oracle² = {excess['value']:.4f} mrad², limit {excess['limit']:.4f}: "
        f"{_met(excess['met'])}; oracle at 60 m {_number(oracle['value'], 3)} m, "
        f"limit {oracle['limit']} m: {_met(oracle['met'])}",
        f"slow part over its own sigma: {summary['sigma']['slow_error_over_sigma_rms']:.2f} rms (one draw a flight); "
        f"published ranges beyond 5 sigma: {summary['sigma']['published_beyond_5_sigma']} from the depth of their "
        f"features, {summary['sigma']['published_off_axis']} (and 5 %) from the first surface on the range axis",
    ]


def _trigger_sentences(trigger: dict[str, Any]) -> list[str]:
    aimed, lines = trigger["aimed"], []
    if aimed["shots"]:
        lines += [_peak_sentence(aimed, kind) for kind in ("deflection", "toe")]
        wing = aimed["blur_px"]
        lines.append(
            f"blur of aimed shots by wing and roll, rms: {wing['at_plan']['rms']:.3f} px; "
            f"limit {wing['limit']['rms']:.3f}, "
            f"random {wing['at_random']['rms']:.3f}: {100 * aimed['share_of_gain']:.0f} % of the possible gain"
        )
    medians = (
        f"{values['median']:.3f} px median {name.replace('_', ' ')}"
        for name, values in trigger["blur_px"].items()
        if values["n"]
    )
    return [*lines, f"blur by the wing: {', '.join(medians)}"]


def _shot_sentences(summary: dict[str, Any]) -> list[str]:
    shots = summary["shots"]
    settled, no_range = shots["settled"], []
    if shots["no_range"]:
        no_range = [f"shots without a range: {_joined(shots['no_range'])} (a slow machine renders and matches late)"]
    return [
        f"shots: {shots['fired']} fired, {shots['pairs']} pairs, {shots['corrected']} corrected, {shots['trusted']} "
        f"trusted and published; planned {_joined(shots['planned'])}",
        f"from {settled['from_s']:.0f} s on {settled['trusted']} of {settled['pairs']} pairs were trusted "
        f"({100 * settled['trusted'] / max(settled['pairs'], 1):.0f} %), {summary['world']} world",
        f"plans: {_joined(shots['fates'])}",
        f"not trusted: {_joined(shots['not_trusted']) or 'none'}",
        *no_range,
        f"received by the autopilot: {_joined(summary['published']['received'] or {})}",
    ]


def _peak_sentence(aimed: dict[str, Any], kind: str) -> str:
    plan, limit, random = (
        aimed[f"{kind}_peak_ms"][way].get("median", float("nan")) for way in ("at_plan", "limit", "at_random")
    )
    figures = f"{plan:.1f} ms, {limit:.1f} with the state known, {random:.1f} at random instants"
    return f"trigger: {aimed['shots']} aimed shots, median from the nearest peak of {kind} {figures}"


def _joined(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.items())


def _met(met: bool) -> str:
    return "met" if met else "MISSED"


def _table(title: str) -> Any:
    from rich.table import Table  # an extra

    return Table(title=title, title_justify="left")
