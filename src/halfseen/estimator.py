"""Estimator parameters as in scikit-learn, without importing it, which takes longer than most verbs."""

from collections.abc import Iterable, Iterator
from inspect import signature
from math import isfinite
from numbers import Real
from typing import Any, TypeVar

import numpy as np

from halfseen.errors import ArgumentError

Its = TypeVar("Its", bound="Estimator")


class Estimator:
    """The parameter interface of scikit-learn's ``BaseEstimator``: `sklearn.base.clone` and searches work.

    Every argument of ``__init__`` is kept unchanged in the attribute of the same name.
    """

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters by name.

        Parameters
        ----------
        deep
            Whether to include parameters of parameters; there are none here.
        """
        return {name: getattr(self, name) for name in self._defaults()}

    def set_params(self: Its, **params: Any) -> Its:
        """Set parameters by name.

        Raises
        ------
        ArgumentError
            There is no parameter of that name.
        """
        known = self._defaults()
        for name, value in params.items():
            if name not in known:
                there = ", ".join(known) or "none"
                raise ArgumentError(f"{type(self).__name__} has no parameter {name}; choose among {there}")
            setattr(self, name, value)
        return self

    def unfitted(self: Its) -> Its:
        """Return an unfitted estimator with the same parameters, as `sklearn.base.clone` does."""
        return type(self)(**self.get_params())

    def __repr__(self) -> str:
        parameters = [
            f"{name}={getattr(self, name)!r}"
            for name, default in self._defaults().items()
            if repr(getattr(self, name)) != repr(default)
        ]
        return f"{type(self).__name__}({', '.join(parameters)})"

    def __sklearn_tags__(self) -> Any:
        """Return the tags that scikit-learn requires, if it is installed."""
        from sklearn.base import BaseEstimator

        return BaseEstimator().__sklearn_tags__()

    @classmethod
    def _defaults(cls) -> dict[str, Any]:
        # A class without an __init__ of its own inherits that of object.
        if cls.__init__ is object.__init__:
            return {}
        parameters = signature(cls.__init__).parameters
        return {name: parameter.default for name, parameter in parameters.items() if name != "self"}


def check_fitted(estimator: object, attribute: str) -> None:
    """Refuse an estimator that has not been fitted.

    Parameters
    ----------
    estimator
        The estimator.
    attribute
        Name of an attribute that exists once it is fitted.

    Raises
    ------
    sklearn.exceptions.NotFittedError
        It is not fitted.
    """
    if not hasattr(estimator, "fit"):
        raise ArgumentError(f"a {type(estimator).__name__} is no learner; give one that was fitted")
    if not hasattr(estimator, attribute):
        from sklearn.exceptions import NotFittedError

        raise NotFittedError(f"this {type(estimator).__name__} is not fitted yet; call fit first")


def is_count(value: object) -> bool:
    """Whether a value is a whole number of at least 1."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= 1


def is_number(value: object) -> bool:
    """Whether a value is a real number that is finite as a float."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return False
    try:
        return isfinite(value)
    except OverflowError:  # a whole number of over 300 digits
        return False


def check_names(name: str, names: object) -> None:
    """Refuse what is no list of names; an iterator would be empty when it is read again."""
    if isinstance(names, str | Iterator) or not isinstance(names, Iterable):
        raise ArgumentError(f"{name} is {names!r}; give a list of names")


def check_generator(random_state: Any) -> None:
    """Refuse what is neither a seed nor a Generator."""
    try:
        np.random.default_rng(random_state)
    except (TypeError, ValueError):
        raise ArgumentError(f"random_state is {random_state!r}; it is a seed, a whole number ≥ 0") from None


def check_seed(random_state: object) -> None:
    """Refuse what is no seed; several generators are made of it."""
    if random_state != 0 and not is_count(random_state):
        raise ArgumentError(f"random_state is {random_state!r}; it is a seed, a whole number ≥ 0")
