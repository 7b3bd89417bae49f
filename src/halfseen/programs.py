"""Compiled programs that are kept between processes, together with what JAX derives before it compiles.

What JAX itself keeps it finds by what was compiled: to that end it traces and lowers a function anew in every process,
which takes longer than all that is computed from a log of usual size. A program here is found by what it was traced
from: the function, the source of this package, the shapes that go in, and all else that decides what comes of it.

Nothing is kept unless the environment says where. What is there is run: nobody but the user may be able to write it.
"""

import hashlib
import inspect
import os
import pickle
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache, update_wrapper
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jaxlib.version
import numpy as np
from jax.core import Tracer
from jax.dtypes import canonicalize_dtype
from jax.experimental.compilation_cache.compilation_cache import reset_cache
from jax.experimental.serialize_executable import deserialize_and_load, serialize

from halfseen.writing import write_file

KEPT_IN = "HALFSEEN_PROGRAMS"
"""Environment variable that names the folder."""
SETTINGS = ("JAX_", "XLA_", "NPROC")
"""Beginnings of the names of those that change what is compiled."""
KNOWN = ("builtins", "jax", "halfseen")
"""Packages whose types are known by their names: a user's may be other code under the same name."""


def kept_jit(function: Callable[..., Any], *, static_argnames: str | tuple[str, ...] = ()) -> "Program":
    """`jax.jit`, of which programs are kept where the environment says so.

    Parameters
    ----------
    function
        What to compile; all that it depends on beside its arguments is in the source of this package.
    static_argnames
        Names of the arguments that it is compiled for: numbers, words, and tuples of them.
    """
    return Program(function, static_argnames)


class Program:
    """A function that is compiled for each shape of its arguments, or read where that was kept."""

    def __init__(self, function: Callable[..., Any], static_argnames: str | tuple[str, ...]) -> None:
        self._jitted = jax.jit(function, static_argnames=static_argnames)
        self._static = {static_argnames} if isinstance(static_argnames, str) else set(static_argnames)
        self._signature = inspect.signature(function)
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._ready: dict[_Asked, Callable[..., Any]] = {}
        update_wrapper(self, function)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call it."""
        folder = os.environ.get(KEPT_IN)
        if not folder or not jax.config.values["jax_enable_compilation_cache"] or jax.default_backend() != "cpu":
            return self._jitted(*args, **kwargs)
        static, varied = self._parted(args, kwargs)
        leaves, tree = jax.tree.flatten(varied)
        if not _is_known(tree) or any(isinstance(leaf, Tracer) for leaf in leaves):
            return self._jitted(*args, **kwargs)
        types = tuple(map(jax.typeof, leaves))
        asked = _Asked(self._name, tuple(sorted(static.items())), tree, types, str(canonicalize_dtype(float)))
        if asked not in self._ready:
            file = Path(folder) / asked.file_name
            self._ready[asked] = _read(file) or self._kept_in(file, static, varied)
        return self._ready[asked](**varied)

    def _parted(self, args: Any, kwargs: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Arguments by name: those that it is compiled for, and the others."""
        named = dict(self._signature.bind(*args, **kwargs).arguments)
        for parameter in self._signature.parameters.values():
            if parameter.kind is parameter.VAR_KEYWORD:
                named |= named.pop(parameter.name, {})
        static = {name: value for name, value in named.items() if name in self._static}
        return static, {name: value for name, value in named.items() if name not in static}

    def _kept_in(self, file: Path, static: Mapping[str, Any], varied: Mapping[str, Any]) -> Callable[..., Any]:
        """Compile it, and keep it if what is read back runs."""
        lowered = self._jitted.lower(**static, **varied)
        with _compiled_here():
            compiled = lowered.compile()
        # Some programs cannot be written, or not be read; they are compiled again. A folder that was thrown away
        # meanwhile is not for this to make: it would not be private.
        with suppress(Exception):
            kept = zlib.compress(pickle.dumps(_Kept("lapack" in lowered.as_text(), *serialize(compiled))), level=1)
            jax.block_until_ready(_loaded(kept)(**varied))
            if file.parent.is_dir():
                write_file(file, kept)
        return compiled


class _Asked(NamedTuple):
    """What a program was traced from."""

    function: str
    static: tuple[tuple[str, Any], ...]
    tree: jax.tree_util.PyTreeDef
    types: tuple[Any, ...]
    floats: str

    @property
    def file_name(self) -> str:
        return hashlib.sha256(f"{_origin()} {self!r}".encode()).hexdigest()


class _Kept(NamedTuple):
    """What a file holds."""

    needs_lapack: bool
    program: bytes
    of_arguments: jax.tree_util.PyTreeDef
    of_results: jax.tree_util.PyTreeDef


def _is_known(tree: jax.tree_util.PyTreeDef) -> bool:
    node = tree.node_data()
    return (node is None or node[0].__module__.split(".")[0] in KNOWN) and all(map(_is_known, tree.children()))


@cache
def _origin() -> str:
    """Tell the source of this package, what compiles it, and how that is set."""
    digest = hashlib.sha256()
    package = Path(__file__).parent
    for file in sorted(package.rglob("*.py")):
        digest.update(str(file.relative_to(package)).encode() + file.read_bytes())
    settings = sorted(pair for pair in os.environ.items() if pair[0].startswith(SETTINGS))
    return repr((digest.hexdigest(), jax.__version__, jaxlib.version.__version__, np.__version__, settings))


@contextmanager
def _compiled_here() -> Iterator[None]:
    """Compile anew: what JAX has read from its own cache cannot be written again."""
    jax.config.update("jax_enable_compilation_cache", False)
    reset_cache()
    try:
        yield
    finally:
        jax.config.update("jax_enable_compilation_cache", True)
        reset_cache()


def _read(file: Path) -> Callable[..., Any] | None:
    """Read a program; None where there is none, or not a whole one."""
    with suppress(Exception):
        return _loaded(file.read_bytes())
    return None


def _loaded(kept: bytes) -> Callable[..., Any]:
    needs_lapack, *program = pickle.loads(zlib.decompress(kept))
    if needs_lapack:
        _find_lapack()
    return deserialize_and_load(*program)


@cache
def _find_lapack() -> None:
    """Let JAX find the functions of LAPACK, as it does when it lowers what calls them."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), np.float32))
