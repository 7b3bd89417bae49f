"""Parameters of an estimator as scikit-learn reads them, without its import, which takes longer than most verbs."""

from inspect import signature
from typing import Any, TypeVar

from halfseen.errors import ArgumentError

Its = TypeVar("Its", bound="Estimator")


class Estimator:
    """What scikit-learn's ``BaseEstimator`` gives its parameters: `sklearn.base.clone` and searches work.

    Every argument of ``__init__`` is kept, as it was given, in the attribute of its name.
    """

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Give the parameters by name.

        Parameters
        ----------
        deep
            Whether parameters of parameters count, too; here none has any.
        """
        return {name: getattr(self, name) for name in self._defaults()}

    def set_params(self: Its, **params: Any) -> Its:
        """Set parameters by name.

        Raises
        ------
        ArgumentError
            There is no parameter of such a name.
        """
        known = self._defaults()
        for name, value in params.items():
            if name not in known:
                there = ", ".join(known) or "none"
                raise ArgumentError(f"{type(self).__name__} has no parameter {name}; there are: {there}")
            setattr(self, name, value)
        return self

    def unfitted(self: Its) -> Its:
        """Make another with the same parameters, as `sklearn.base.clone` does."""
        return type(self)(**self.get_params())

    def __repr__(self) -> str:
        parameters = [
            f"{name}={getattr(self, name)!r}"
            for name, default in self._defaults().items()
            if repr(getattr(self, name)) != repr(default)
        ]
        return f"{type(self).__name__}({', '.join(parameters)})"

    def __sklearn_tags__(self) -> Any:
        """What scikit-learn asks of an estimator, if it is there to ask."""
        from sklearn.base import BaseEstimator

        return BaseEstimator().__sklearn_tags__()

    @classmethod
    def _defaults(cls) -> dict[str, Any]:
        # A class without parameters of its own has those of object.
        if cls.__init__ is object.__init__:
            return {}
        parameters = signature(cls.__init__).parameters
        return {name: parameter.default for name, parameter in parameters.items() if name != "self"}


def check_fitted(estimator: object, attribute: str) -> None:
    """Refuse an estimator that has not been fitted.

    Parameters
    ----------
    estimator
        Which.
    attribute
        What it has once it is fitted.

    Raises
    ------
    sklearn.exceptions.NotFittedError
        It has not.
    """
    if not hasattr(estimator, attribute):
        from sklearn.exceptions import NotFittedError

        raise NotFittedError(f"this {type(estimator).__name__} is not fitted yet; call fit first")
