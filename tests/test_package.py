import subprocess
import sys

import pytest


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def loaded_after(statement):
    return set(run(f"import sys\n{statement}\nprint(' '.join(sys.modules))").split())


@pytest.mark.parametrize(
    "package",
    [
        "halfseen",
        *(f"halfseen.{name}" for name in ("cli", "evaluation", "learning", "planners", "policies", "tables", "world")),
    ],
)
def test_a_package_loads_nothing_heavy(package):
    heavy = {"gymnasium", "jax", "mujoco", "pandas", "pyarrow", "sklearn", "scipy"}
    assert not loaded_after(f"import {package}") & heavy


def test_lazy_names_are_listed_and_unknown_ones_are_told():
    code = "import halfseen.world as world\n[getattr(world, name) for name in world.__all__]\nworld.Wrold"
    failed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "has no attribute 'Wrold'; it has ActionSpace, " in failed.stderr
    assert "Decision, Explanation, ExploringPolicy, " in failed.stderr


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
    assert run(code) == "True True float32"


@pytest.mark.parametrize(
    ("first", "env_id"),
    [
        ("import gymnasium; import halfseen", "halfseen/Cups-v0"),
        ("import halfseen; import gymnasium", "halfseen/Cups-v0"),
        ("import gymnasium", "halfseen.gym_registration:halfseen/Cups-v0"),
        ("import gymnasium; import halfseen", "halfseen/TeamCups-v0"),
    ],
)
def test_gymnasium_knows_the_tables_and_loads_jax_only_to_make_one(first, env_id):
    code = f"import sys\n{first}\nprint('jax' in sys.modules, gymnasium.make('{env_id}').spec.id)"
    assert run(code) == f"False {env_id.split(':')[-1]}"
