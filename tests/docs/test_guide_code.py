"""Every page of the guide can be followed from top to bottom.

Python blocks run in one namespace a page, ``halfseen …`` lines of sh and console blocks in between, all in one folder
that holds nothing but the examples. A text block below ``<!-- output -->`` is what the block above it prints; "..."
stands for any text.
"""

import contextlib
import doctest
import io
import re
import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner

from halfseen.cli import halfseen

ROOT = Path(__file__).parents[2]
GUIDE, EXAMPLES = ROOT / "docs" / "guide", ROOT / "examples"
BLOCK = re.compile(r"^(<!-- output -->\n)?```([^\n]*)\n(.*?)^```$", flags=re.DOTALL | re.MULTILINE)
ALIKE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def follow(page, text):
    """Run a page; the names that its Python blocks leave behind."""
    namespace, printed = {"__name__": "__main__"}, ""
    for block in BLOCK.finditer(text):
        is_output, language, code = block.groups()
        line = text.count("\n", 0, block.start(3)) + 1
        if language == "python":
            printed = run_python("\n" * (line - 1) + code, page, namespace)
        elif language in ("sh", "console"):
            printed = run_commands(code, f"{page}, line {line}")
        elif is_output:
            assert doctest.OutputChecker().check_output(code, printed, ALIKE), (
                f"{page}, line {line}: it says\n{printed}"
            )
    return namespace


def run_python(code, page, namespace):
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(code, page, "exec"), namespace)
    return printed.getvalue()


def run_commands(code, where):
    """Run the lines that call halfseen; other commands are the reader's own affair."""
    printed = ""
    for line in code.replace("\\\n", " ").splitlines():
        words = shlex.split(line.removeprefix("$ "), comments=True)
        if words[:1] == ["halfseen"]:
            result = CliRunner().invoke(halfseen, words[1:], catch_exceptions=False)
            assert result.exit_code == 0, f"{where}: {line}\n{result.output}"
            printed += result.stdout
    return printed


SLOW = {"planners", "times-that-were-cut"}
PAGES = [
    pytest.param(page, id=page.stem, marks=[pytest.mark.slow] if page.stem in SLOW else [])
    for page in sorted(GUIDE.glob("*.md"))
]


@pytest.mark.parametrize("page", PAGES)
def test_a_page_of_the_guide_can_be_followed(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(EXAMPLES)
    follow(str(page), page.read_text(encoding="utf-8"))


PAGE = """
```python
x = 1
print("one", x)
```

<!-- output -->
```text
one ...
```

```console
$ halfseen --version
```

<!-- output -->
```text
halfseen, version ...
```

```python
x += 1
```
"""


def test_blocks_run_in_order_in_one_namespace():
    assert follow("page.md", PAGE)["x"] == 2


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("one ...", "two ...", "line 9: it says"),
        ("version ...", "version x", "line 18: it says"),
        ("$ halfseen --version", "$ halfseen --verison", "No such option"),
        ("x += 1", "assert x == 2, f'x is {x}'", "x is 1"),
    ],
)
def test_a_page_that_is_wrong_is_told(right, wrong, told):
    with pytest.raises(AssertionError, match=re.escape(told)):
        follow("page.md", PAGE.replace(right, wrong))
