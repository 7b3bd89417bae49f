"""What an import loads: nothing that a verb which does not need it would wait for. Examples of docstrings run."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = {"gymnasium", "jax", "mujoco", "pandas", "pyarrow", "sklearn", "scipy"}
LIGHT = ("cli", "evaluation", "learning", "planners", "policies", "tables", "world")
EVERY_NAME = "[getattr(package, name) for name in package.__all__]"
LOADS = [
    *((f"import halfseen{name}", HEAVY) for name in ("", *(f".{each}" for each in LIGHT))),
    ("import halfseen.scene as s; s.table_paths(); s.read_truth(0); s.read_table(0); s.Cup", {"mujoco"}),
    (f"import halfseen.censoring as package; {EVERY_NAME}", {"jax", "matplotlib"}),
    ("import halfseen.perception", {"jax", "mujoco", "matplotlib"}),
]
"""One after the other in one process: what loads nothing after others loads nothing alone."""


def run(code, **options):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, **options)


def test_a_package_loads_nothing_heavy_that_it_does_not_need():
    code = ["import sys"]
    for statement, heavy in LOADS:
        code += [statement, f"print({statement!r}, *sorted({heavy!r} & set(sys.modules)), sep=': loads ')"]
    assert run("\n".join(code), check=True).stdout.splitlines() == [statement for statement, _ in LOADS]


def test_lazy_names_are_listed_and_unknown_ones_are_reported():
    failed = run(f"import halfseen.world as package\n{EVERY_NAME}\npackage.Wrold", check=False)
    assert "has no attribute 'Wrold'; it has ActionSpace, " in failed.stderr
    assert "Attempt, Explanation, ExploringPolicy, " in failed.stderr


@pytest.mark.slow
def test_no_import_touches_jax_or_numpy_settings():
    code = """
import importlib, pkgutil
import jax, numpy as np
import halfseen
settings, state = dict(jax.config.values), np.random.get_state()[1].copy()
for module in pkgutil.walk_packages(halfseen.__path__, "halfseen."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)
print(dict(jax.config.values) == settings, (np.random.get_state()[1] == state).all(), jax.numpy.ones(1).dtype)
"""
    assert run(code, check=True).stdout.strip() == "True True float32"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "env_ids"),
    [
        ("import gymnasium; import halfseen", ["halfseen/Cups-v0", "halfseen/TeamCups-v0"]),
        ("import halfseen; import gymnasium", ["halfseen/Cups-v0"]),
        ("import gymnasium", ["halfseen.gym_registration:halfseen/Cups-v0"]),
    ],
)
def test_gymnasium_knows_the_tables_and_loads_no_jax_to_make_one(first, env_ids):
    made = f"[gymnasium.make(name).spec.id for name in {env_ids}]"
    output = run(f"import sys\n{first}\nprint(*{made}, 'jax' in sys.modules)", check=True).stdout.split()
    assert output == [*(name.split(":")[-1] for name in env_ids), "False"]


SOURCE = Path(__file__).parent.parent / "src"
FILES = sorted(path for path in SOURCE.rglob("*.py") if ">>> " in path.read_text(encoding="utf-8"))
MODULES = [".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__") for path in FILES]


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_run(name):
    found = doctest.testmod(importlib.import_module(name))
    assert found.attempted > 0
    assert found.failed == 0
