"""Tables of a benchmark of published numbers, from the results that are kept in benchmarks/published/results."""

import importlib
import sys
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
sys.path.append(str(BENCHMARKS))

from peers.side_by_side import RESULTS, stored  # noqa: E402


class PublishedTables(SphinxDirective):
    """Write what `tables` of the benchmark of this name makes of its results."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Read the results, and tell that the page depends on them."""
        name = self.arguments[0]
        self.env.note_dependency(str(RESULTS / f"{name}.json"))
        return self.parse_text_to_nodes(importlib.import_module(f"published.{name}").tables(stored(name)))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("published", PublishedTables)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
