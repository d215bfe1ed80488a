"""Page of any kind of recording, from what its JSON has."""

from __future__ import annotations

from typing import Any

from companion.evaluation.pages.measured_pages import check_table, rendered
from companion.reporting.blocks import Block, Heading, Paragraph, Table


def findings_page(plain: dict[str, Any], what: str) -> str:
    """The page of any kind of recording from what its JSON has: causes, gain, an oscillator's linear part, tests."""
    body: list[Block] = [*causes_table(plain)]
    if plain["gain"]:
        error = plain["gain"]["error"]
        before, after = (100.0 * value for value in error["share_of_signal"])
        body.append(Paragraph(f"Held-out error of the {error['what']}: {before:.1f} → {after:.1f} % of its rms."))
    body += [
        *_linear_part(plain.get("linear")),
        Heading("What is left"),
        check_table(plain, "test", "linear wing"),
        *[Paragraph(note) for note in plain["notes"]],
    ]
    return rendered(plain, f"{what}: recordings: {len(plain['recordings'])}, fitted jointly", body)


def causes_table(plain: dict[str, Any]) -> list[Block]:
    """The named causes with their values; nothing where there are none."""
    rows = []
    for cause in plain["causes"]:
        values = "; ".join(
            f"{key} {entry['value']:.3g} ± {entry['sigma']:.2g} {entry['unit']}".rstrip()
            for key, entry in cause["parameters"].items()
        )
        rows.append(
            [cause["name"], cause["channel"] or "–", values, f"{cause['log_bayes_factor']:.0f}", f"{cause['z']:.1f}"]
        )
    heads = ["cause", "follows", "parameters", "log Bayes factor", "sigmas"]
    return [Heading("Causes, strongest first"), Table(heads, rows)] if rows else []


def _linear_part(linear: dict[str, Any] | None) -> list[Block]:
    if linear is None:
        return []
    heads = ["model", "frequency", "damping ratio", "stiffness", "mass"]
    rows = [
        [
            name,
            f"{entry['frequency_hz']:.4g} Hz",
            f"{entry['damping_ratio']:.3g}",
            f"{entry['stiffness']:.5g} ± {entry['stiffness_sigma']:.2g}",
            f"{entry['mass']:.5g} ± {entry['mass_sigma']:.2g}",
        ]
        for name, entry in (("linear", linear["before"]), ("extended", linear["after"]))
    ]
    return [Heading("Its linear part"), Table(heads, rows)]
