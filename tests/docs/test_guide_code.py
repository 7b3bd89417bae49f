"""Every page of the guide can be followed from top to bottom.

Python blocks run in one namespace a page, ``halfseen …`` lines of sh and console blocks in between, all in one folder
that holds nothing but the examples. A text block below ``<!-- output -->`` is what the block above it prints; "..."
stands for any text. A page beside which a patch of its name lies is followed on a copy of the source to which it was
applied.
"""

import contextlib
import doctest
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from few_cups import draw_small_tables
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


def apply_to_copy(patch, folder):
    """Copy the source into a folder, patched."""
    shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    # Inside a repository git would pass over what it does not track.
    outside = os.environ | {"GIT_CEILING_DIRECTORIES": str(folder.parent)}
    done = subprocess.run(["git", "apply", patch], text=True, capture_output=True, cwd=folder, env=outside)
    assert done.returncode == 0, (
        f"{patch} no longer applies to src/:\n{done.stderr}make the change by hand, and put what `git diff -U2` prints "
        "in its place"
    )


def follow_patched(page, text, folder):
    """Follow a page in a process of its own, in which halfseen is the patched copy."""
    apply_to_copy(page.with_suffix(".patch"), folder)
    code = "import sys; from test_guide_code import follow; follow('page.md', open('page.md', encoding='utf-8').read())"
    (folder / "page.md").write_text(text, encoding="utf-8")
    env = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (folder / "src", *Path(__file__).parents[:2])))}
    done = subprocess.run([sys.executable, "-c", code], cwd=folder, env=env, text=True, capture_output=True)
    assert done.returncode == 0, f"{page}\n{done.stderr}"


SLOW = {
    *("another-camera", "another-figure", "another-planner", "another-verb", "any-multistage-problem"),
    *("from-logs-to-a-policy", "physical-cell", "planners", "several-robots", "times-that-were-cut", "watch"),
    *("what-looks-dirty", "can-i-believe-it", "in-service", "stepping-back", "opcua"),
}
PAGES = [
    pytest.param(page, id=page.stem, marks=[pytest.mark.slow] if page.stem in SLOW else [])
    for page in sorted(GUIDE.glob("*.md"))
]


SMALL = {"physical-cell", "watch"}
"""Pages that are followed on small tables: an arm takes a minute for one of full size."""


@pytest.mark.parametrize("page", PAGES)
def test_a_page_of_the_guide_can_be_followed(page, tmp_path, monkeypatch):
    if page.stem in SMALL:
        draw_small_tables(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(EXAMPLES)
    text = page.read_text(encoding="utf-8")
    if page.with_suffix(".patch").exists():
        follow_patched(page, text, tmp_path)
    else:
        follow(str(page), text)


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


@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("one ...", "two ...", "line 9: it says"),
        ("version ...", "version x", "line 18: it says"),
        ("$ halfseen --version", "$ halfseen --verison", "No such option"),
        ("x += 1", "assert x == 2, f'x is {x}'", "x is 1"),
    ],
)
def test_blocks_run_in_order_in_one_namespace_and_what_is_wrong_is_reported(right, wrong, message):
    assert follow("page.md", PAGE)["x"] == 2
    with pytest.raises(AssertionError, match=re.escape(message)):
        follow("page.md", PAGE.replace(right, wrong))
