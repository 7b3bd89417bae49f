"""ONNX graphs of NumPy formulas: a formula that is asked with the arrays of a graph adds its operators to the graph.

`GraphArray` answers NumPy's ufuncs, functions and indices (NEP 13 and NEP 18). It holds an example of its values, from
which NumPy itself finds the shape and the type of each result.
"""

from collections.abc import Callable, Mapping
from functools import partial, partialmethod
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from onnx import helper, numpy_helper

OPSET, IR_VERSION = 18, 9
ARITHMETIC: dict[Any, str] = {
    np.add: "Add",
    np.subtract: "Sub",
    np.multiply: "Mul",
    np.true_divide: "Div",
    np.power: "Pow",
    np.negative: "Neg",
    np.matmul: "MatMul",
    np.maximum: "Max",
    np.fmax: "Max",
    np.minimum: "Min",
    np.exp: "Exp",
    np.log: "Log",
    np.sqrt: "Sqrt",
    np.tanh: "Tanh",
    np.floor: "Floor",
    np.bitwise_and: "And",
    np.bitwise_or: "Or",
    np.invert: "Not",
}
"""Operators whose inputs have the type of their result."""
COMPARISONS: dict[Any, str] = {
    np.equal: "Equal",
    np.less: "Less",
    np.greater: "Greater",
    np.greater_equal: "GreaterOrEqual",
    np.isnan: "IsNaN",
}
REDUCTIONS: Mapping[Any, str] = {np.sum: "ReduceSum", np.prod: "ReduceProd", np.max: "ReduceMax", np.any: "ReduceMax"}


class OnnxGraph:
    """Inputs, nodes and constants, added as they are used."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.inputs: list[Any] = []

    def input(self, name: str, example: np.ndarray, shape: tuple[int | str, ...] | None = None) -> Any:
        """Add an input, by default of the shape of its example."""
        self.inputs.append(_described(name, example, example.shape if shape is None else shape))
        return GraphArray(self, name, example)

    def constant(self, value: Any) -> Any:
        """Add an array of numbers."""
        name, array = f"c{len(self.constants)}", np.asarray(value)
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(array).reshape(array.shape), name))
        return GraphArray(self, name, array)

    def array(self, value: Any, dtype: Any) -> Any:
        """Return a number or an array as one of the graph, of a type."""
        return value.astype(dtype) if isinstance(value, GraphArray) else self.constant(np.asarray(value, dtype=dtype))

    def node(self, operator: str, example: Any, *inputs: Any, name: str = "", **attributes: Any) -> Any:
        """Add an operator, and return its result."""
        name = name or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, [each.name for each in inputs], [name], **attributes))
        return GraphArray(self, name, np.asarray(example))

    def model(self, outputs: Mapping[str, tuple[Any, tuple[int | str, ...]]]) -> Any:
        """Return the graph as a model with these outputs of these shapes."""
        for name, (each, _) in outputs.items():
            self.node("Identity", each.example, each, name=name)
        described = [_described(name, each.example, shape) for name, (each, shape) in outputs.items()]
        made = helper.make_graph(self.nodes, "policy", self.inputs, described, self.constants)
        return helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)


def _described(name: str, example: np.ndarray, shape: tuple[int | str, ...]) -> Any:
    return helper.make_tensor_value_info(name, helper.np_dtype_to_tensor_dtype(example.dtype), shape)


class GraphArray(NDArrayOperatorsMixin):
    """An array of a graph, by name, with an example of its values."""

    def __init__(self, graph: OnnxGraph, name: str, example: np.ndarray) -> None:
        self.graph, self.name, self.example = graph, name, example
        self.shape, self.dtype, self.ndim, self.size = example.shape, example.dtype, example.ndim, example.size

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = None) -> Any:
        """Add an operator; `out` is left as it is, as formulas go on with the result."""
        if ufunc is np.expm1:
            return np.exp(inputs[0]) - np.ones_like(inputs[0])
        examples = [_example_of(each) for each in inputs]
        with np.errstate(all="ignore"):
            found = np.asarray(ufunc(*examples))
        dtype = found.dtype if ufunc in ARITHMETIC else np.result_type(*examples)
        operator = (ARITHMETIC | COMPARISONS)[ufunc]
        return self.graph.node(operator, found, *(self.graph.array(each, dtype) for each in inputs))

    def __array_function__(self, function: Any, types: Any, args: Any, kwargs: Any) -> Any:
        """Add the operators of a function."""
        return FUNCTIONS[function](self.graph, *args, **kwargs)

    def __getitem__(self, key: Any) -> Any:
        """Select by numbers, slices, new axes and one array of indices."""
        keys = key if isinstance(key, tuple) else (key,)
        rest = [slice(None)] * (self.ndim - sum(each is not None and each is not ... for each in keys))
        at = next((k for k, each in enumerate(keys) if each is ...), len(keys))
        found: Any = self
        axis = 0
        for each in (*keys[:at], *rest, *keys[at + 1 :]):
            if each is None:
                found = np.expand_dims(found, axis)
            elif not isinstance(each, slice):
                found = np.take(found, each, axis=axis)
            elif each != slice(None):
                found = found.between(*each.indices(found.shape[axis])[:2], axis)
            axis += 1 if each is None or isinstance(each, slice) else np.ndim(_example_of(each))
        return found

    def __len__(self) -> int:
        """Length of the first axis."""
        return self.shape[0]

    @property
    def T(self) -> Any:
        """Transpose of a matrix."""
        return self.graph.node("Transpose", self.example.T, self, perm=[1, 0])

    def astype(self, dtype: Any) -> Any:
        """Convert to another type."""
        if self.dtype == dtype:
            return self
        kind = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        return self.graph.node("Cast", self.example.astype(dtype), self, to=kind)

    def reshape(self, *shape: int) -> Any:
        """Arrange in another shape."""
        return self.graph.node("Reshape", self.example.reshape(shape), self, self.graph.constant(shape))

    def between(self, begin: int, end: int, axis: int) -> Any:
        """Slice one axis."""
        some = np.take(self.example, range(begin, end), axis=axis)
        return self.graph.node("Slice", some, self, *(self.graph.constant([each]) for each in (begin, end, axis)))

    sum, max, any = partialmethod(np.sum), partialmethod(np.max), partialmethod(np.any)


def _example_of(value: Any) -> Any:
    return value.example if isinstance(value, GraphArray) else value


def _reduced(function: Any, graph: OnnxGraph, array: Any, axis: int, keepdims: bool = False) -> Any:
    found = function(array.example, axis=axis, keepdims=keepdims)
    # ONNX has no maximum of truth values.
    dtype = np.dtype(np.int32 if found.dtype == bool else found.dtype)
    inputs = array.astype(dtype), graph.constant([axis])
    return graph.node(REDUCTIONS[function], found.astype(dtype), *inputs, keepdims=int(keepdims)).astype(found.dtype)


def _where(graph: OnnxGraph, condition: Any, one: Any, other: Any) -> Any:
    found = np.where(*map(_example_of, (condition, one, other)))
    return graph.node("Where", found, *map(graph.array, (condition, one, other), (bool, found.dtype, found.dtype)))


def _concatenated(graph: OnnxGraph, arrays: Any, axis: int) -> Any:
    found = np.concatenate([*map(_example_of, arrays)], axis=axis)
    return graph.node("Concat", found, *(graph.array(each, found.dtype) for each in arrays), axis=axis)


def _stacked(graph: OnnxGraph, arrays: Any, axis: int) -> Any:
    return np.concatenate([np.expand_dims(each, axis) for each in arrays], axis=axis)


def _expanded(graph: OnnxGraph, array: Any, axis: int) -> Any:
    return graph.node("Unsqueeze", np.expand_dims(array.example, axis), array, graph.constant([axis]))


def _broadcast(graph: OnnxGraph, array: Any, shape: tuple[int, ...]) -> Any:
    return graph.node("Expand", np.broadcast_to(array.example, shape), array, graph.constant(shape))


def _taken(graph: OnnxGraph, array: Any, index: Any, axis: int = 0) -> Any:
    found, where = np.take(array.example, _example_of(index), axis=axis), graph.array(index, np.int64)
    return graph.node("Gather", found, array, where, axis=axis)


def _best(graph: OnnxGraph, array: Any, axis: int) -> Any:
    return graph.node("ArgMax", np.argmax(array.example, axis=axis), array, axis=axis, keepdims=0)


FUNCTIONS: Mapping[Any, Callable[..., Any]] = {
    **{each: partial(_reduced, each) for each in REDUCTIONS},
    np.where: _where,
    np.concatenate: _concatenated,
    np.stack: _stacked,
    np.expand_dims: _expanded,
    np.broadcast_to: _broadcast,
    np.take: _taken,
    np.argmax: _best,
    np.clip: lambda graph, array, low, high: np.minimum(np.maximum(array, low), high),
    np.ones_like: lambda graph, array: graph.constant(np.ones_like(array.example)),
    np.unique: lambda graph, array: array[None],
}
"""Those of a formula for one state: it has one number of steps to go, and so on."""
