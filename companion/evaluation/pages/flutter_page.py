"""Page of a structure that vibrates by itself in the wind."""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.diagnosis.limit_cycles.recordings import FlutterDiagnosis
from companion.evaluation.pages.findings_page import causes_table
from companion.evaluation.pages.measured_pages import check_table, rendered
from companion.reporting.blocks import Advice, Block, Heading, Paragraph, Table
from companion.reporting.embedding import embed
from companion.reporting.plotting import AFTER, BEFORE, DATA, panels


def flutter_page(diagnosis: FlutterDiagnosis, plain: dict[str, Any], what: str) -> str:
    """The page of recordings of one rig; ``plain`` as its JSON has them."""
    body: list[Block] = [
        *[Advice(f"{entry['says']}.") for entry in plain["labels"]],
        *[Advice(f"Record: {line}.") for line in plain["advice"]],
        Heading("What a linear wing gets wrong"),
        *[Paragraph(f"It has {sentence}.") for sentence in plain["linear_wing"]["wrong"]],
        *causes_table(plain),
    ]
    if plain["held_out_speeds"]:
        figure = _against_speed(plain, diagnosis.names)
        body += [
            Heading("Limit cycles against airspeed, each airspeed foretold by the others"),
            embed(figure, "frequency and amplitude of the limit cycle against airspeed"),
            _held_out(plain),
        ]
    if plain["onset"]:
        body += [Heading("Onset"), Paragraph(f"Small vibrations stop decaying: {plain['onset']['says']}.")]
    body += [
        Heading("Stiffness and damping against amplitude"),
        embed(_against_amplitude(diagnosis), "frequency and damping of every window against amplitude"),
    ]
    if any(entry["stiffness"] for entry in plain["decays"]):
        body += [embed(_springs(plain), "force of the spring over deflection")]
    body += [
        Heading("What is left"),
        check_table(plain, "test", "linear wing"),
        *[Paragraph(note) for note in plain["notes"]],
    ]
    return rendered(plain, f"{what}: recordings: {len(plain['recordings'])}, fitted jointly", body)


def _held_out(plain: dict[str, Any]) -> Table:
    names = list(plain["held_out_speeds"][0]["amplitude"])
    rows = []
    for entry in plain["held_out_speeds"]:
        pairs = [entry["frequency_hz"], *(entry["amplitude"][name] for name in names)]
        cells = [
            f"{pair['measured']:.4g} → {pair['predicted']:.4g} ({100 * pair['relative_error']:+.1f} %)"
            for pair in pairs
        ]
        rows.append([f"{entry['airspeed_mps']:g} m/s", *cells])
    return Table(["held out", "frequency, Hz", *(f"amplitude of {name}" for name in names)], rows)


def _against_speed(plain: dict[str, Any], names: tuple[str, ...]) -> Any:
    figure, axes = panels(3.4, 1 + len(names))
    cycles = [entry for entry in plain["limit_cycles"] if entry["frequency_hz"] is not None]
    speeds = [entry["airspeed_mps"] for entry in cycles]
    at = [entry["airspeed_mps"] for entry in plain["held_out_speeds"]]
    for axis, name in zip(axes, ("", *names), strict=True):
        measured, held_out = (
            [entry["amplitude"][name] if name else entry["frequency_hz"] for entry in entries]
            for entries in (cycles, plain["held_out_speeds"])
        )
        predicted = [pair["predicted"] for pair in held_out]
        axis.plot(speeds, measured, "o", ms=5, color=DATA, label="measured")
        axis.plot(at, predicted, "x-", ms=6, lw=0.8, color=AFTER, label="held out, predicted")
        axis.set(xlabel="airspeed, m/s", title=f"amplitude of {name}" if name else "frequency, Hz")
    axes[0].axhline(plain["linear_wing"]["frequency_hz"], color=BEFORE, lw=1.0, label="linear wing")
    axes[0].legend(fontsize=8)
    return figure


def _against_amplitude(diagnosis: FlutterDiagnosis) -> Any:
    figure, axes = panels(3.6, 1 + len(diagnosis.names))
    rows = diagnosis.rows
    speeds = np.array([row.airspeed_mps for row in rows])
    level = np.array([row.amplitude for row in rows])
    f_hz, zeta = np.array([row.frequency_hz for row in rows]), np.array([row.damping for row in rows])
    fitted = np.sqrt(np.maximum(diagnosis.outcome.final.state.predicted(diagnosis.outcome.final.values, 0), 0.0))
    shown = None
    for i, (axis, name) in enumerate(zip(axes, diagnosis.names, strict=False)):
        shown = axis.scatter(level[:, i], f_hz, c=speeds, s=14, cmap="viridis", label="measured")
        order = np.argsort(level[:, i])
        axis.plot(level[order, i], fitted[order], "+", ms=5, color=AFTER, label="fitted")
        axis.set(xlabel=f"amplitude of {name}", ylabel="frequency, Hz" if i == 0 else "")
    axes[0].legend(fontsize=8)
    loud = level[:, 0] > 0.03 * level[:, 0].max()  # below, a window's damping is noise
    axes[-1].scatter(level[loud, 0], zeta[loud], c=speeds[loud], s=14, cmap="viridis")
    axes[-1].axhline(0.0, color="black", lw=0.8)
    axes[-1].set(xlabel=f"amplitude of {diagnosis.names[0]}", title="damping ratio: below 0 it grows")
    figure.colorbar(shown, ax=axes, label="airspeed, m/s")
    return figure


def _springs(plain: dict[str, Any]) -> Any:
    curves = [
        (entry["recording"], name, spring) for entry in plain["decays"] for name, spring in entry["stiffness"].items()
    ]
    names = list(dict.fromkeys(name for _, name, _ in curves))
    figure, axes = panels(3.2, len(names))
    for axis, name in zip(axes, names, strict=True):
        for recording, response, spring in curves:
            if response == name:
                axis.plot(spring["deflection"], spring["force"], lw=1.2, label=recording)
        axis.set(xlabel=name, title=f"force per mass of the spring, {name}/s²")
    axes[0].legend(fontsize=7)
    return figure
