"""The report of a stereo calibration: values with sigmas, what was refused, coverage, residuals, the views."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from companion.calibration.boards import Board, Corners, find_corners
from companion.calibration.stereo_rig import CELLS, BoardView, RigFit, cells, toe_sigma_rad
from companion.records import Bytes, Floats, Side
from companion.reporting.blocks import Advice, Block, Heading, Page, Paragraph, Table
from companion.reporting.embedding import embed_image, png
from companion.reporting.page import capitalised, render
from companion.reporting.plotting import BLUE, GREY, VERMILLION, headline, new_figure

Pairs = list[tuple[str, Bytes, Bytes]]
_NAMES = ("fx, px", "fy, px", "cx, px", "cy, px", "k1", "k2", "p1", "p2", "k3")
_LEFT_TO_RIGHT = ("x", "y", "z")
_WIDTH_IN = 12.0  # chosen: of the picture: the page's width
_SHOWN = 12  # images a page shows before it grows long (choice)
_FAR_M = 60.0  # convention: the paper's far target
_MATCHING_PX = 0.2  # chosen: of one feature in good texture
_MATCHING_SHARE = 0.4  # adds 8 % to what matching leaves (choice)
_ARROW = 100.0  # residuals are drawn so many times their length (choice)


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

    ``views`` are all that were found, used or not; ``advice`` is what another session should add.
    """
    picture = png(_figure(fit, [view for view in views if view.name in fit.views], pairs[0][1].shape))
    grade, headline_text = verdict(fit)
    body: list[Block] = [Advice(f"{capitalised('; '.join(advice))}.")] if advice else []
    body += [
        Heading("Coverage and residuals"),
        embed_image(picture, "png", "coverage of both images, residuals of each view", width_in=_WIDTH_IN),
        Heading("Values"),
        Table(("", "value", "sigma", "camera"), rows(fit)),
    ]
    if fit.rejected:
        body += [Heading("Refused"), Table(("view", "why"), list(fit.rejected.items()))]
    body += [
        Heading("Views"),
        Paragraph(f"Corners in green; residuals in red, {_ARROW:.0f} times their length."),
        *_views(fit, pairs, board),
    ]
    subject = (
        f"{len(fit.views)} views used, {len(fit.rejected)} refused; reprojection error {fit.error_px:.3f} px "
        "(rms over all corners of both cameras, both lenses and the pose between them fitted together)."
    )
    page = Page(title="Stereo calibration", headline=headline_text, body=body, subject=subject, grade=grade)
    return render(page), picture


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


def _figure(fit: RigFit, used: list[BoardView], shape: tuple[int, ...]) -> Any:
    figure = new_figure(_WIDTH_IN, 8.0)
    grid = figure.add_gridspec(2, 2, height_ratios=(1.3, 1.0))
    for column, side in enumerate(Side):
        axis = figure.add_subplot(grid[0, column])
        corners_of_views = [view.left if side is Side.LEFT else view.right for view in used]
        off = [np.linalg.norm(pair[side], axis=1) for pair in fit.bundle.residuals_px]
        _coverage(axis, corners_of_views, np.concatenate(off), shape)
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
    headline(figure, verdict(fit)[1])
    return figure


def _coverage(axis: Any, corners_of_views: list[Corners], off: Floats, shape: tuple[int, ...]) -> None:
    from matplotlib.patches import Rectangle

    rows_px, columns_px = shape[:2]
    width, height = columns_px / CELLS, rows_px / CELLS
    filled = {cell for corners in corners_of_views for cell in cells(corners, (columns_px, rows_px))}
    for column, row in ((c, r) for c in range(CELLS) for r in range(CELLS) if (c, r) not in filled):
        where = (column * width, row * height)
        axis.add_patch(Rectangle(where, width, height, fc="#fbe9e1", ec=VERMILLION, hatch="//", lw=0.0))
    pixels = np.concatenate([corners.pixels for corners in corners_of_views])
    shown = axis.scatter(pixels[:, 0], pixels[:, 1], c=off, s=6, cmap="viridis", vmax=float(np.percentile(off, 98)))
    axis.figure.colorbar(shown, ax=axis, shrink=0.8, label="residual, px")
    for k in range(1, CELLS):
        axis.axvline(k * width, color=GREY, lw=0.5)
        axis.axhline(k * height, color=GREY, lw=0.5)
    axis.set(xlim=(0, columns_px), ylim=(rows_px, 0), aspect="equal", xlabel="column, px", ylabel="row, px")


def _views(fit: RigFit, pairs: Pairs, board: Board) -> list[Block]:
    """Refused ones first; then as many of the others as a page bears."""
    ordered = sorted(pairs, key=lambda pair: pair[0] not in fit.rejected)
    blocks: list[Block] = []
    for name, *images in ordered[:_SHOWN]:
        why = fit.rejected.get(name)
        off = None if why else fit.bundle.residuals_px[fit.views.index(name)]
        marked = [_marked(image, board, None if off is None else off[k]) for k, image in enumerate(images)]
        data = cv2.imencode(".jpg", cv2.hconcat(marked))[1].tobytes()
        title = Heading(f"{name}: {why}" if why else name, level=3, warning=bool(why))
        blocks += [title, embed_image(data, "jpeg", f"view {name}")]
    if len(ordered) > _SHOWN:
        blocks.append(Paragraph(f"and {len(ordered) - _SHOWN} more views."))
    return blocks


def _marked(image: Bytes, board: Board, residuals: Floats | None) -> Bytes:
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    corners = find_corners(image, board)
    pixels = np.empty((0, 2)) if corners is None else corners.pixels
    for k, (x, y) in enumerate(pixels):
        cv2.circle(picture, (round(x), round(y)), 3, (0, 200, 0), 1, cv2.LINE_AA)
        if residuals is not None and len(residuals) == len(pixels):
            end = (round(x + _ARROW * residuals[k, 0]), round(y + _ARROW * residuals[k, 1]))
            cv2.line(picture, (round(x), round(y)), end, (0, 0, 255), 1, cv2.LINE_AA)
    answer: Bytes = np.asarray(picture, dtype=np.uint8)
    return answer
