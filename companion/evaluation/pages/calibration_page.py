"""The report of a stereo calibration: values with sigmas, what was refused, coverage, residuals, the views."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from companion.calibration.boards import Board, Corners, find_corners
from companion.calibration.stereo_rig import CELLS, BoardView, RigFit, cells, toe_sigma_rad
from companion.records import Bytes, Floats, Side
from companion.reporting.plotting import BLUE, GREY, VERMILLION, headline, new_figure

Pairs = list[tuple[str, Bytes, Bytes]]
_NAMES = ("fx, px", "fy, px", "cx, px", "cy, px", "k1", "k2", "p1", "p2", "k3")
_LEFT_TO_RIGHT = ("x", "y", "z")
_SHOWN = 12
_FAR_M = 60.0
_MATCHING_PX = 0.2  # of one feature
_MATCHING_SHARE = 0.4  # adds 8 % to what matching leaves
_ARROW = 100.0  # residuals are drawn so many times their length
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#20262d;max-width:1080px;margin:2rem auto;padding:0 1.2rem}
h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid #d9dee3;padding-bottom:.2rem}
h1{font-size:1.4rem;line-height:1.35;color:#fff;padding:1rem 1.2rem;border-radius:8px}
.good{background:#2e7d4f}.fair{background:#8a6d1d}.poor{background:#b23b2e}
h3{font-size:1rem;margin:1rem 0 .2rem}p{color:#5b6670}img{width:100%}
table{border-collapse:collapse;font-size:.93rem}
th,td{text-align:right;padding:.25rem .8rem;border-bottom:1px solid #e6eaee}
td:first-child,th:first-child{text-align:left}.bad{color:#b23b2e}
"""


def rows(fit: RigFit) -> list[tuple[str, str, str, str]]:
    """Name, value, sigma, and in which camera, of every parameter."""
    table = []
    for side, lens in zip(Side, fit.lenses, strict=True):
        for name, value, sigma in zip(_NAMES, lens.values, lens.sigmas, strict=True):
            table.append((name, f"{value:.6g}", f"{sigma:.2g}", side.name.lower()))
    turned = zip(_LEFT_TO_RIGHT, 1e3 * fit.rotation_rad, 1e3 * fit.rotation_sigma_rad, strict=True)
    moved = zip(_LEFT_TO_RIGHT, 1e3 * fit.translation_m, 1e3 * fit.translation_sigma_m, strict=True)
    table += [(f"rotation {axis}, mrad", f"{v:.4f}", f"{s:.4f}", "left to right") for axis, v, s in turned]
    table += [(f"translation {axis}, mm", f"{v:.3f}", f"{s:.3f}", "left to right") for axis, v, s in moved]
    return table


def report(fit: RigFit, views: list[BoardView], pairs: Pairs, board: Board, advice: list[str]) -> tuple[str, bytes]:
    """A page with nothing external in it, and its main picture alone (PNG).

    Parameters
    ----------
    fit : RigFit
        The result.
    views : list of BoardView
        All that were found, used or not.
    pairs : list
        Name, left and right image of each.
    board : Board
        What they show.
    advice : list of str
        What another session should add.
    """
    picture = _picture(fit, [view for view in views if view.name in fit.views], pairs[0][1].shape)
    grade, told = verdict(fit)
    body = [
        f"<h1 class={grade}>{html.escape(told)}</h1>",
        f"<p>{len(fit.views)} views used, {len(fit.rejected)} refused; reprojection error {fit.error_px:.3f} px "
        "(rms over all corners of both cameras, both lenses and the pose between them fitted together).</p>",
    ]
    if advice:
        body += ["<h2>What to do next</h2>", "<p>" + "; ".join(html.escape(text) for text in advice) + ".</p>"]
    body += [
        "<h2>Coverage and residuals</h2>",
        _image(picture, "png", "coverage of both images, residuals of each view"),
        "<h2>Values</h2>",
        _table(("", "value", "sigma", "camera"), rows(fit)),
    ]
    if fit.rejected:
        body += ["<h2>Refused</h2>", _table(("view", "why"), list(fit.rejected.items()))]
    body += [
        f"<h2>Views</h2><p>Corners in green; residuals in red, {_ARROW:.0f} times their length.</p>",
        *_views(fit, pairs, board),
    ]
    text = "".join(body)
    head = f"<meta charset=utf-8><title>Stereo calibration</title><style>{_STYLE}</style>"
    return f"<!doctype html><html lang=en>{head}{text}</html>\n", picture


def verdict(fit: RigFit) -> tuple[str, str]:
    """``good``, ``fair`` or ``poor``, and in words what the calibration leaves of a far range."""
    toe_rad, baseline_m = toe_sigma_rad(fit), float(np.linalg.norm(fit.translation_m))
    left_m, matching_m = (_FAR_M**2 / baseline_m * angle for angle in (toe_rad, _MATCHING_PX / fit.lenses[0].values[0]))
    what = f"{1e3 * toe_rad:.2f} mrad of toe, {left_m:.2f} m at {_FAR_M:.0f} m (1 sigma)"
    blind = sum(len(parts) for parts in fit.unseen.values())
    gaps = f"; {blind} of {2 * CELLS**2} parts of the images never saw a corner" if blind else ""
    if left_m <= _MATCHING_SHARE * matching_m and not blind:
        return "good", f"Good to fly: the calibration leaves {what}, little beside the matching's {matching_m:.2f} m"
    if left_m <= matching_m:
        return "fair", f"Usable: the calibration leaves {what}, the matching {matching_m:.2f} m{gaps}"
    return "poor", f"Not good yet: the calibration leaves {what}, more than the matching's {matching_m:.2f} m{gaps}"


def _table(heads: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    top = "".join(f"<th>{html.escape(head)}</th>" for head in heads)
    text = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in line) + "</tr>" for line in lines)
    return f"<table><tr>{top}</tr>{text}</table>"


def _image(data: bytes, kind: str, text: str) -> str:
    return f"<img alt='{html.escape(text)}' src='data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}'>"


def _picture(fit: RigFit, used: list[BoardView], shape: tuple[int, ...]) -> bytes:
    figure = new_figure(12, 8)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.3, 1.0))
    for column, side in enumerate(Side):
        axis = figure.add_subplot(grid[0, column])
        seen = [view.left if side is Side.LEFT else view.right for view in used]
        off = [np.linalg.norm(pair[side], axis=1) for pair in fit.bundle.residuals_px]
        _coverage(axis, seen, np.concatenate(off), shape)
        axis.set_title(f"{side.name.lower()} image: corners of all views; hatched: no corner ever", fontsize=10)
    axis = figure.add_subplot(grid[1, :])
    errors, place = fit.bundle.view_errors_px(), np.arange(len(used))
    for side, colour in zip(Side, (BLUE, VERMILLION), strict=True):
        axis.bar(place + 0.4 * side, errors[:, side], 0.38, color=colour, label=side.name.lower())
    axis.axhline(fit.error_px, color=GREY, lw=0.8, ls="--", label="all together")
    axis.set_xticks(place + 0.2, [str(k + 1) for k in range(len(used))], fontsize=8)
    axis.set(ylabel="reprojection error, px rms", xlabel="view, in the order of their stamps")
    axis.set_title("Each view used", fontsize=10)
    axis.legend(fontsize=8, ncols=3, loc="upper right")
    axis.set_ylim(top=1.25 * float(errors.max()))
    headline(figure, verdict(fit)[1].replace(": ", ":\n", 1))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def _coverage(axis: Any, seen: list[Corners], off: Floats, shape: tuple[int, ...]) -> None:
    from matplotlib.patches import Rectangle

    rows_px, columns_px = shape[:2]
    width, height = columns_px / CELLS, rows_px / CELLS
    filled = {cell for corners in seen for cell in cells(corners, (columns_px, rows_px))}
    for column, row in ((c, r) for c in range(CELLS) for r in range(CELLS) if (c, r) not in filled):
        where = (column * width, row * height)
        axis.add_patch(Rectangle(where, width, height, fc="#fbe9e1", ec=VERMILLION, hatch="//", lw=0.0))
    pixels = np.concatenate([corners.pixels for corners in seen])
    shown = axis.scatter(pixels[:, 0], pixels[:, 1], c=off, s=6, cmap="viridis", vmax=float(np.percentile(off, 98)))
    axis.figure.colorbar(shown, ax=axis, shrink=0.8, label="residual, px")
    for k in range(1, CELLS):
        axis.axvline(k * width, color=GREY, lw=0.5)
        axis.axhline(k * height, color=GREY, lw=0.5)
    axis.set(xlim=(0, columns_px), ylim=(rows_px, 0), aspect="equal", xlabel="column, px", ylabel="row, px")


def _views(fit: RigFit, pairs: Pairs, board: Board) -> list[str]:
    """Refused ones first; then as many of the others as a page bears."""
    ordered = sorted(pairs, key=lambda pair: pair[0] not in fit.rejected)
    pieces = []
    for name, *images in ordered[:_SHOWN]:
        why = fit.rejected.get(name)
        off = None if why else fit.bundle.residuals_px[fit.views.index(name)]
        drawn = [_drawn(image, board, None if off is None else off[k]) for k, image in enumerate(images)]
        data = cv2.imencode(".jpg", cv2.hconcat(drawn))[1].tobytes()
        text = f"<span class=bad>{html.escape(name)}: {html.escape(why)}</span>" if why else html.escape(name)
        pieces += [f"<h3>{text}</h3>", _image(data, "jpeg", f"view {name}")]
    if len(ordered) > _SHOWN:
        pieces.append(f"<p>and {len(ordered) - _SHOWN} more views.</p>")
    return pieces


def _drawn(image: Bytes, board: Board, residuals: Floats | None) -> Bytes:
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    seen = find_corners(image, board)
    pixels = np.empty((0, 2)) if seen is None else seen.pixels
    for k, (x, y) in enumerate(pixels):
        cv2.circle(picture, (round(x), round(y)), 3, (0, 200, 0), 1, cv2.LINE_AA)
        if residuals is not None and len(residuals) == len(pixels):
            end = (round(x + _ARROW * residuals[k, 0]), round(y + _ARROW * residuals[k, 1]))
            cv2.line(picture, (round(x), round(y)), end, (0, 0, 255), 1, cv2.LINE_AA)
    answer: Bytes = np.asarray(picture, dtype=np.uint8)
    return answer
