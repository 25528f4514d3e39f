"""A subspace for runtimes of ONNX: its decoder, and of a network its step, each as one graph for many instances.

    step.onnx     q1, q2 (…, r), w (…, m) → q (…, r): the coordinates of the last frame and of the one before, and what
                  acts on the step, as docs/subspace.md has it, to those of the next
    decode.onnx   q (…, r) [, pins (…, P, 3)] → positions (…, n, 3), m [, normals (…, n, 3)]: `pins` are their ways
                  since the start, m; normals are there where the model has the regression

Coordinates have double precision, and so has the linear part of a step: rounding would add up from step to step. The
rest is single. Steps of physics are no graph: they solve a system of equations that the state gives.
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clothfit.base.errors import InvalidInput
from clothfit.subspace.model import InitialState, Model, Part, initial_state
from clothfit.subspace.network.weights import Network

IR, OPERATORS = 7, 13
"""Versions of the format and of the operators: those of 2020, which every runtime knows."""

FLOAT, DOUBLE = 1, 11
"""Types of numbers, as `onnx.TensorProto` has them."""

BATCH = "instances"
"""The name of the first dimension of what goes in and out: any number of instances."""

TINY = 1e-12
"""Below the length of any normal; a vertex without faces has one of 0."""


class Graph:
    """A graph that grows node by node; each node gives the name of its output."""

    def __init__(self, name: str) -> None:
        """Raises InvalidInput where the package onnx is not installed."""
        try:
            from onnx import helper, numpy_helper
        except ImportError:
            raise InvalidInput("ONNX needs the package onnx; install it with: pip install 'clothfit[onnx]'") from None
        self.helper, self.from_array, self.name = helper, numpy_helper.from_array, name
        self.nodes, self.arrays, self.inputs, self.outputs = (list[Any]() for _ in range(4))

    def array(self, values: NDArray[Any]) -> str:
        """An array that belongs to the graph."""
        name = f"a{len(self.arrays)}"
        self.arrays.append(self.from_array(values, name))
        return name

    def node(self, kind: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """A node of an operator; its output."""
        output = output or f"n{len(self.nodes)}"
        self.nodes.append(self.helper.make_node(kind, inputs, [output], **attributes))
        return output

    def input(self, name: str, *shape: int, kind: int = FLOAT) -> str:
        """Numbers that go in: of any number of instances, (…, *shape) each."""
        self.inputs.append(self.helper.make_tensor_value_info(name, kind, [BATCH, *shape]))
        return name

    def output(self, name: str, *shape: int, kind: int = FLOAT) -> None:
        """Numbers that come out."""
        self.outputs.append(self.helper.make_tensor_value_info(name, kind, [BATCH, *shape]))

    def encoded(self, about: dict[str, str]) -> bytes:
        """The file, with what there is to know about it."""
        graph = self.helper.make_graph(self.nodes, self.name, self.inputs, self.outputs, self.arrays)
        operators = [self.helper.make_opsetid("", OPERATORS)]
        made = self.helper.make_model(graph, ir_version=IR, opset_imports=operators, producer_name="clothfit")
        self.helper.set_model_props(made, about)
        return bytes(made.SerializeToString(deterministic=True))


def files(model: Model) -> dict[str, bytes]:
    """Names and contents; with a number before the suffix where there are several objects. Raises InvalidInput where
    the package onnx is not installed.
    """
    found, scene = {}, model.scene()
    for c, part in enumerate(model.parts):
        number = "" if len(model.parts) == 1 else str(c)
        found[f"decode{number}.onnx"] = decoder(part, initial_state(scene, c, part.basis))
        if part.network is not None:
            found[f"step{number}.onnx"] = step(part.network, initial_state(scene, c, part.basis))
    return found


def decoder(part: Part, own: InitialState) -> bytes:
    """The graph of positions, and of normals by regression."""
    n, r = len(part.basis), part.basis.shape[2]
    graph = Graph("decode")
    shape = graph.array(np.array([-1, n, 3]))
    q = graph.node("Cast", graph.input("q", r, kind=DOUBLE), to=FLOAT)
    flat = product(graph, q, part.basis.astype(part.precision).reshape(-1, r), own.start.reshape(-1))
    if own.pins:
        ways = graph.input("pins", own.pins, 3)
        mean = graph.node("ReduceMean", ways, axes=[1], keepdims=1)
        stays = graph.node("Sub", mean, mean)
        table = graph.node("Concat", stays, mean, ways, axis=1)
        carried = graph.node("Gather", table, graph.array(own.way.astype(np.int64) + 1), axis=1)
        graph.node("Add", graph.node("Reshape", flat, shape), carried, output="positions")
    else:
        graph.node("Reshape", flat, shape, output="positions")
    graph.output("positions", n, 3)
    if part.normals is not None:
        by = part.normals.reshape(-1, 1 + r)
        made = graph.node("Reshape", product(graph, q, by[:, 1:].astype(part.precision), by[:, 0]), shape)
        size = graph.node("ReduceL2", made, axes=[2], keepdims=1)
        graph.node("Div", made, graph.node("Max", size, graph.array(np.array([TINY], np.float32))), output="normals")
        graph.output("normals", n, 3)
    return graph.encoded({"vectors": str(r), "vertices": str(n)})


def product(graph: Graph, q: str, rows: NDArray[Any], constant: NDArray[Any]) -> str:
    """q Uᵀ + c, as one node."""
    U = graph.array(np.ascontiguousarray(rows))
    if rows.dtype == np.float16:
        U = graph.node("Cast", U, to=FLOAT)
    return graph.node("Gemm", q, U, graph.array(np.ascontiguousarray(constant, np.float32)), transB=1)


def double(graph: Graph, single: str) -> str:
    """The same numbers in double precision."""
    return graph.node("Cast", single, to=DOUBLE)


def step(own: Network, at_rest: InitialState) -> bytes:
    """The graph of a network's step."""
    graph = Graph("step")
    q1, q2 = (graph.input(name, own.r, kind=DOUBLE) for name in ("q1", "q2"))
    w = graph.input("w", own.m)
    low, high = (graph.array(row) for row in own.input_range)
    acts = double(graph, graph.node("Min", graph.node("Max", w, low), high))
    u = graph.node("Concat", q1, graph.node("Sub", q1, q2), acts, axis=1)
    product = graph.node("MatMul", u, double(graph, graph.array(own.linear)))
    linear = graph.node("Add", product, double(graph, graph.array(own.offset)))
    layer = graph.node("Cast", u, to=FLOAT)
    for k, (weight, bias) in enumerate(zip(own.weights, own.biases, strict=True)):
        layer = graph.node("Gemm", layer, graph.array(weight), graph.array(bias))
        if k < len(own.weights) - 1:
            layer = graph.node("Relu", layer) if own.activation == "relu" else graph.node("Elu", layer, alpha=1.0)
    low, high = (double(graph, graph.array(row)) for row in own.range)
    graph.node("Min", graph.node("Max", graph.node("Add", linear, double(graph, layer)), low), high, output="q")
    graph.output("q", own.r, kind=DOUBLE)
    about = {"signals": json.dumps(own.signals.parts), "q2_at_start": json.dumps(at_rest.before.tolist())}
    return graph.encoded(about | {"mean": json.dumps(own.signals.mean.tolist())})
