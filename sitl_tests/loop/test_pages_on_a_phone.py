"""Pages of the reports in a real browser: a figure keeps lettering that can be read, and scrolls in its own box."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.reporting.blocks import Page, Paragraph, Table
from companion.reporting.embedding import embed
from companion.reporting.page import render
from companion.reporting.plotting import new_figure
from sitl_tests.loop.browser import Browser, browser_path

pytestmark = [pytest.mark.slow, pytest.mark.skipif(browser_path() is None, reason="no Chromium or Chrome is installed")]

_READABLE_PX = 880  # of a figure 11 inches wide: lettering of 8 points is 9 px high
_FIGURE = "document.querySelector('figure img').getBoundingClientRect().width"
_BOX = "document.querySelector('figure .wide')"
_SCROLLS_SIDEWAYS = "document.documentElement.scrollWidth > window.innerWidth"


@pytest.fixture
def page(tmp_path: Path) -> str:
    figure = new_figure(11, 3)
    figure.subplots().plot([0.0, 1.0])
    table = Table(["a long heading of a column"] * 6, [["a long cell of a column"] * 6])
    path = tmp_path / "page.html"
    path.write_text(render(Page("t", "h", [Paragraph("p"), embed(figure, "a line"), table])), encoding="utf-8")
    return path.as_uri()


def test_on_a_phone_a_wide_figure_scrolls_in_its_box_and_the_page_does_not(page: str) -> None:
    with Browser(390, 844) as browser:
        browser.open(page)
        browser.until(f"document.querySelector('figure img')?.complete && {_FIGURE} > 0")
        assert browser.value(_FIGURE) == pytest.approx(_READABLE_PX)
        assert browser.value(f"{_BOX}.scrollWidth") == pytest.approx(_READABLE_PX, abs=1)
        assert browser.value(f"{_BOX}.clientWidth") < 390
        assert not browser.value(_SCROLLS_SIDEWAYS)


def test_on_a_laptop_a_figure_fills_the_page_and_nothing_scrolls_sideways(page: str) -> None:
    with Browser(1440, 900) as browser:
        browser.open(page)
        browser.until(f"document.querySelector('figure img')?.complete && {_FIGURE} > 0")
        assert browser.value(_FIGURE) == pytest.approx(browser.value(f"{_BOX}.clientWidth"), abs=1)
        assert browser.value(_FIGURE) > 1000
        assert not browser.value(_SCROLLS_SIDEWAYS)
