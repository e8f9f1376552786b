"""A page from its template, every text in it escaped."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def render(template: str, filled: Mapping[str, Any]) -> bytes:
    """The page, UTF-8."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("calibration.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(filled).encode()
