"""The table of landings: what each range finder made of them, in calm and in gusts."""

from __future__ import annotations

from collections.abc import Sequence

from companion.evaluation.landing.landing_rows import FLARE_RATIO, RangeKind, Row, figures, spread

NAMES = {
    RangeKind.RIGID: "rigid stereo",
    RangeKind.IN_TRIM: "rigid stereo, calibrated in trim",
    RangeKind.SPANWISE: "Spanwise",
    RangeKind.TRUTH: "true range",
    RangeKind.FALSE_LONG: "true range, one reading false: too long",
    RangeKind.FALSE_SHORT: "true range, one reading false: too short",
}
HEADS = (
    "air",
    "range finder",
    "landings",
    "flare above the intended height, m",
    f"flares above {FLARE_RATIO:g} times it",
    "never flared",
    "sink at touch-down, m/s",
    "touch-down beyond the point, m",
    "went around",
)


def variants(rows: Sequence[Row]) -> list[tuple[RangeKind, str]]:
    """Range finders that the rows hold, with the settings that differ, in the order of the table."""
    present = {(RangeKind(row["range"]), str(row.get("settings", ""))) for row in rows}
    order = list(RangeKind)
    return sorted(present, key=lambda variant: (order.index(variant[0]), variant[1]))


def of_variant(rows: Sequence[Row], variant: tuple[RangeKind, str], *, gusts: bool) -> list[Row]:
    """Rows of one range finder in one air."""
    return [
        row for row in rows if (row["range"], str(row.get("settings", ""))) == variant and bool(row["gusts"]) is gusts
    ]


def name_of(variant: tuple[RangeKind, str]) -> str:
    """Name of a range finder with its settings."""
    kind, settings = variant
    return f"{NAMES[kind]}, {settings}" if settings else NAMES[kind]


def cells(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Rows of the table as text; medians with the extremes."""
    table: list[tuple[str, ...]] = []
    for gusts in (False, True):
        for variant in variants(rows):
            chosen = of_variant(rows, variant, gusts=gusts)
            if not chosen:
                continue
            summed = figures(chosen)
            table.append(
                (
                    "gusts" if gusts else "calm",
                    name_of(variant),
                    str(summed.flights),
                    spread(summed.flare_error_m),
                    str(summed.high_flares),
                    str(summed.no_flare),
                    spread(summed.sink_mps, 2),
                    spread(summed.north_m, 0),
                    str(summed.went_around),
                )
            )
    return table


def markdown(rows: Sequence[Row]) -> str:
    """The table as a page has it."""
    lines = ["| " + " | ".join(HEADS) + " |", "|" + "---|" * len(HEADS)]
    lines += ["| " + " | ".join(row) + " |" for row in cells(rows)]
    return "\n".join(lines)
