"""The reference of a package: a table of its public names, then each of them, all from docstrings."""

import inspect
import re
import sys
from importlib import import_module
from typing import Any

from docutils import nodes
from numpy.typing import ArrayLike
from sphinx.application import Sphinx
from sphinx.ext import autosummary
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective
from sphinx.util.typing import stringify_annotation

# What these bases bring is Python's or scikit-learn's.
BASES = "BaseEstimator, IntEnum, object, int, tuple, dict, Exception, Protocol"
ROUTING = re.compile(r"get_metadata_routing|set_\w+_request")
# NumPy's alias has no name of its own once it is written out.
WRITTEN_OUT = stringify_annotation(ArrayLike, "smart")


def documented(package: str) -> str:
    """The reST that documents every name of the package's ``__all__``."""
    public = {name: getattr(import_module(package), name) for name in import_module(package).__all__}
    lines = [f".. currentmodule:: {package}", "", ".. autosummary::", ""]
    lines += [f"   {name}" for name, value in public.items() if callable(value)]
    for name, value in public.items():
        lines += ["", *(_class_or_function(name, value) if callable(value) else _constant(package, name, value))]
    return "\n".join(lines)


def _class_or_function(name: str, value: Any) -> list[str]:
    if not inspect.isclass(value):
        return [f".. autofunction:: {name}"]
    routing = [member for member in dir(value) if ROUTING.fullmatch(member)]
    options = ["members:", f"inherited-members: {BASES}"] + [f"exclude-members: {', '.join(routing)}"] * bool(routing)
    return [f".. autoclass:: {name}", *(f"   :{option}" for option in options)]


def _constant(package: str, name: str, value: Any) -> list[str]:
    """A constant has no docstring of its own; the string below it is in the file that defines it."""
    modules = [module for module in sys.modules if module.startswith(f"{package}.")]
    found = [ModuleAnalyzer.for_module(module).find_attr_docs().get(("", name), []) for module in modules]
    if not isinstance(value, str) or "\n" not in value:
        return [f".. data:: {name}", f"   :value: {value!r}", "", *(f"   {line}" for line in max(found, key=len))]
    # Several lines are shown as they would be printed.
    block = ["", ".. code-block:: toml", "", *(f"   {line}" for line in value.splitlines())]
    return [f".. data:: {name}", "", *(f"   {line}" for line in [*max(found, key=len), *block])]


def shortened(
    app: Sphinx, what: str, name: str, value: Any, options: Any, signature: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """Write types by their short names; a protocol, which nobody calls, has no signature."""
    if what == "class" and getattr(value, "_is_protocol", False):
        return "", None
    return _short(signature), _short(result)


def _short(written: str | None) -> str | None:
    return written and written.replace(WRITTEN_OUT, "ArrayLike")


def without_field_numbers(app: Sphinx, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    """Drop what Python writes below the fields of a named tuple."""
    lines[:] = [line for line in lines if not line.startswith("Alias for field number")]


class PublicNames(SphinxDirective):
    """``.. public-names:: halfseen.logs`` documents every public name of the package."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse the reST where the directive stands."""
        return self.parse_text_to_nodes(documented(self.arguments[0]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Tell Sphinx of the directive."""
    app.add_directive("public-names", PublicNames)
    app.connect("autodoc-process-signature", shortened)
    app.connect("autodoc-process-docstring", without_field_numbers)
    # A summary ends at the first full stop; that of "eq. 3" is none.
    autosummary.WELL_KNOWN_ABBREVIATIONS += ("eq.", "eqs.")
    return {"parallel_read_safe": True, "parallel_write_safe": True}
