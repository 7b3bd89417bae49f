"""What scikit-learn asks of an estimator, so that `sklearn.base.clone` works on ours, without loading scikit-learn."""

import inspect
from typing import Any, TypeVar

from halfseen.errors import ArgumentError

Estimator = TypeVar("Estimator", bound="Parameters")


class Parameters:
    """Reads and sets the parameters of the constructor, which stores each under its own name."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Parameters of the constructor and their values; `deep` is scikit-learn's, and changes nothing here."""
        return {name: getattr(self, name) for name in _signature(type(self))}

    def set_params(self: Estimator, **params: Any) -> Estimator:
        """Set parameters of the constructor.

        Raises
        ------
        ArgumentError
            There is no such parameter.
        """
        known = _signature(type(self))
        for name, value in params.items():
            if name not in known:
                has = f"it has {', '.join(sorted(known))}" if known else "it has none at all"
                raise ArgumentError(f"{type(self).__name__} has no parameter {name!r}; {has}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        default = _signature(type(self))
        changed = [f"{name}={value!r}" for name, value in self.get_params().items() if value is not default[name]]
        return f"{type(self).__name__}({', '.join(changed)})"


def _signature(kind: type) -> dict[str, Any]:
    """Defaults of the constructor's own parameters."""
    if kind.__init__ is object.__init__:
        return {}
    arguments = list(inspect.signature(kind.__init__).parameters.values())[1:]
    return {argument.name: argument.default for argument in arguments}
