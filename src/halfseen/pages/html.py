"""A page from a template of a package: one file that stands alone, without scripts or anything to load."""

from importlib.resources import files
from typing import Any

import jinja2


def rendered(package: str, template: str, content: dict[str, Any], **functions: Any) -> str:
    """Fill a template; the style sheet that all pages share is its `css`.

    Parameters
    ----------
    package, template
        Where it is.
    content
        All that it names.
    functions
        What it may call.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(functions, css=files("halfseen.pages").joinpath("page.css").read_text(encoding="utf-8"))
    return environment.from_string(files(package).joinpath(template).read_text(encoding="utf-8")).render(content)
