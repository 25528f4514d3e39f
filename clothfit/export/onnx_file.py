"""ONNX files, written without a library: a graph of nodes, with its arrays, as a protocol buffer.

A message is a sequence of fields: a key, 8 number + kind, then a varint (kind 0), four bytes (5), or a length and so
many bytes (2): text, raw numbers or another message. The numbers of the fields are those of onnx.proto, version 1.8.

https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

IR, OPERATORS = 7, 13
"""Versions of the format and of the operators: those of 2020, which every runtime knows."""

FLOAT, INTEGER, HALF, DOUBLE = 1, 7, 10, 11
TYPES = {"float32": FLOAT, "int64": INTEGER, "float16": HALF}
"""Of tensors."""

A_FLOAT, AN_INTEGER, INTEGERS = 1, 2, 7
"""Of attributes."""

BATCH = "instances"
"""The name of the first dimension of what goes in and out: any number of instances."""


def varint(value: int) -> bytes:
    """An integer, seven bits a byte, the lowest first; negative ones as their 64-bit complement."""
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)


def field(number: int, value: int | float | str | bytes) -> bytes:
    """A field of a message."""
    if isinstance(value, int):
        return varint(8 * number) + varint(value)
    if isinstance(value, float):
        return varint(8 * number + 5) + struct.pack("<f", value)
    content = value.encode() if isinstance(value, str) else value
    return varint(8 * number + 2) + varint(len(content)) + content


class Graph:
    """A graph that grows node by node; each node gives the name of its output."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.nodes: list[bytes] = []
        self.arrays: list[bytes] = []
        self.ends: list[bytes] = []
        self.count = 0

    def array(self, values: NDArray[Any], name: str = "") -> str:
        """An array that belongs to the graph."""
        name = name or self.new("a")
        tensor = b"".join(field(1, size) for size in values.shape) + field(2, TYPES[values.dtype.name])
        little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
        self.arrays.append(field(5, tensor + field(8, name) + field(9, little.tobytes())))
        return name

    def new(self, letter: str) -> str:
        """A name that nothing has."""
        self.count += 1
        return f"{letter}{self.count}"

    def node(self, kind: str, *inputs: str, output: str = "", **attributes: int | float | Sequence[int]) -> str:
        """A node of an operator; its output."""
        output = output or self.new("n")
        content = b"".join(field(1, each) for each in inputs) + field(2, output) + field(4, kind)
        for name, value in attributes.items():
            content += field(5, field(1, name) + attribute(value))
        self.nodes.append(field(1, content))
        return output

    def input(self, name: str, *shape: int, kind: int = FLOAT) -> str:
        """Numbers that go in: of any number of instances, (…, *shape) each."""
        self.ends.append(field(11, described(name, shape, kind)))
        return name

    def output(self, name: str, *shape: int, kind: int = FLOAT) -> None:
        """Numbers that come out."""
        self.ends.append(field(12, described(name, shape, kind)))

    def encoded(self, about: dict[str, str]) -> bytes:
        """The file, with what there is to know about it."""
        graph = b"".join(self.nodes) + field(2, self.name) + b"".join(self.arrays) + b"".join(self.ends)
        known = b"".join(field(14, field(1, key) + field(2, value)) for key, value in about.items())
        return field(1, IR) + field(2, "clothfit") + field(7, graph) + field(8, field(2, OPERATORS)) + known


def attribute(value: int | float | Sequence[int]) -> bytes:
    """The value of an attribute, and its kind."""
    if isinstance(value, float):
        return field(2, value) + field(20, A_FLOAT)
    if isinstance(value, int):
        return field(3, value) + field(20, AN_INTEGER)
    return b"".join(field(8, each) for each in value) + field(20, INTEGERS)


def described(name: str, shape: Sequence[int], kind: int) -> bytes:
    """The name, type and shape of what goes in or out."""
    sizes = field(1, field(2, BATCH)) + b"".join(field(1, field(1, size)) for size in shape)
    return field(1, name) + field(2, field(1, field(1, kind) + field(2, sizes)))
