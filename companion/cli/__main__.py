"""``python -m companion.cli``: the same as ``spanwise``."""

from __future__ import annotations

from companion.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
