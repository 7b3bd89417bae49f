import doctest
import subprocess
import sys

import pytest

from halfseen import censoring


@pytest.mark.parametrize("name", ["KaplanMeier", "Cox", "KernelKaplanMeier"])
def test_every_model_has_an_example(name):
    assert doctest.DocTestFinder().find(getattr(censoring, name))[0].examples


def test_import_loads_neither_jax_nor_matplotlib():
    code = (
        "import sys; import halfseen.censoring as c; [getattr(c, n) for n in c.__all__]; print(' '.join(sys.modules))"
    )
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"jax", "matplotlib"} & set(loaded)
