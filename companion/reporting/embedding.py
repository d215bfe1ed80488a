"""Pictures inside a page: matplotlib figures and encoded images as data URIs."""

from __future__ import annotations

import base64
import io
from typing import Any

from companion.reporting.blocks import Picture

_DPI = 130  # 1430 px for a figure 11 inches wide: sharp on a page of 1070 px; a convention
_READABLE_DPI = 80  # of the screen: lettering of 8 points is 9 px high (choice)


def embed(figure: Any, text: str, caption: str = "") -> Picture:
    """Matplotlib figure as a PNG inside the page; ``text`` is its alternative text."""
    return embed_image(png(figure), "png", text, caption, figure.get_figwidth())


def png(figure: Any) -> bytes:
    """Matplotlib figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    return buffer.getvalue()


def embed_image(data: bytes, subtype: str, text: str, caption: str = "", width_in: float = 0.0) -> Picture:
    """Encoded image (``subtype`` png, jpeg or svg+xml) inside the page.

    ``width_in`` is the width for which its lettering is drawn, 0 for an image without any.
    """
    source = f"data:image/{subtype};base64,{base64.b64encode(data).decode('ascii')}"
    return Picture(source, text, caption, round(_READABLE_DPI * width_in))
