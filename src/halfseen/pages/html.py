"""A page from a template of a package: one file that stands alone, without scripts or anything to load."""

from importlib.resources import files
from typing import Any

import jinja2


def rendered(package: str, template: str, content: dict[str, Any], **functions: Any) -> str:
    """Fill a template of a package, which may call `functions`; the style sheet of all pages is its `css`."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(functions, css=files("halfseen.pages").joinpath("page.css").read_text(encoding="utf-8"))
    return environment.from_string(files(package).joinpath(template).read_text(encoding="utf-8")).render(content)
