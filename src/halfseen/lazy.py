"""Names that load their module on first use, so that importing a package is fast."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    import pandas as pd

    Frame: TypeAlias = pd.DataFrame
else:
    Frame = Any
    """A data frame of pandas, which takes longer to load than most verbs to answer: readers of types know it."""


def lazy_names(package: str, module_of: Mapping[str, str]) -> Callable[[str], Any]:
    """Make a package's ``__getattr__`` (PEP 562).

    Parameters
    ----------
    package
        The package's ``__name__``.
    module_of
        For each public name, the module of the package that defines it.
    """

    def get(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}; it has {', '.join(sorted(module_of))}")
        return getattr(import_module(f"{package}.{module_of[name]}"), name)

    return get
