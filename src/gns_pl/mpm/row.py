"""The eight numbers of one grid node as one value, for processors that take several numbers at a time.

A compiler does not find this by itself in the loops over 27 nodes of a point (numba 0.68 leaves them scalar), and they
are where the time goes: with rows a step takes half as long. `load_row` and `store_row` reach a node's row of the grid,
`make_row` and `lane` lead from numbers to a row and back, `first_half` to its first four numbers; rows add up, and a
number times a row is a row. LLVM turns them into whatever vectors the processor has.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import intrinsic, overload, register_model

LANES = 8
"""Numbers in a row."""


class RowType(types.Type):  # type: ignore[misc]
    """Numba's type of a row, or half of one, of float32 or float64."""

    def __init__(self, real: Any, lanes: int = LANES) -> None:
        self.real, self.lanes = real, lanes
        super().__init__(name=f"Row({real}, {lanes})")


@register_model(RowType)
class RowModel(models.PrimitiveModel):  # type: ignore[misc]
    """A row is a vector of LLVM."""

    def __init__(self, manager: Any, row: RowType) -> None:
        super().__init__(manager, row, ir.VectorType(manager.lookup(row.real).get_value_type(), row.lanes))


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, node: Any) -> tuple[Any, int]:
    """Address of a row; nodes are never negative and the grid is contiguous, so no index is checked or wrapped."""
    data = context.make_array(array_type)(context, builder, array).data
    place = builder.gep(data, [builder.mul(node, node.type(LANES))])
    vector = ir.VectorType(data.type.pointee, LANES)
    return builder.bitcast(place, vector.as_pointer()), array_type.dtype.bitwidth // 8


@intrinsic
def load_row(typing_context, grid, node):
    """Return the row of a node; `grid` is [M, 8], `node` its index."""

    def generate(context, builder, signature, arguments):
        place, align = _pointer(context, builder, signature.args[0], *arguments)
        return builder.load(place, align=align)

    return RowType(grid.dtype)(grid, types.intp), generate


@intrinsic
def store_row(typing_context, grid, node, row):
    """Write the row of a node."""

    def generate(context, builder, signature, arguments):
        place, align = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store(arguments[2], place, align=align)
        return context.get_dummy_value()

    return types.none(grid, types.intp, row), generate


@intrinsic
def make_row(typing_context, a, b, c, d, e, f, g, h):
    """Return the row of eight numbers, which all become of the first one's type."""

    def generate(context, builder, signature, arguments):
        row = ir.Constant(ir.VectorType(arguments[0].type, LANES), ir.Undefined)
        for index, value in enumerate(arguments):
            row = builder.insert_element(row, value, cgutils.int32_t(index))
        return row

    return RowType(a)(*(a,) * LANES), generate


@intrinsic
def first_half(typing_context, row):
    """Return the first four numbers of a row."""

    def generate(context, builder, signature, arguments):
        kept = ir.Constant(ir.VectorType(cgutils.int32_t, LANES // 2), list(range(LANES // 2)))
        return builder.shuffle_vector(arguments[0], ir.Constant(arguments[0].type, ir.Undefined), kept)

    return RowType(row.real, LANES // 2)(row), generate


@intrinsic(prefer_literal=True)
def lane(typing_context, row, index):
    """Return one number of a row; the index is a literal."""

    def generate(context, builder, signature, arguments):
        return builder.extract_element(arguments[0], cgutils.int32_t(index.literal_value))

    return row.real(row, index), generate


@intrinsic
def add_rows(typing_context, a, b):
    """Return the sum of two rows."""
    return a(a, b), lambda context, builder, signature, arguments: builder.fadd(*arguments)


@intrinsic
def scale_row(typing_context, factor, row):
    """Return a number times a row."""

    def generate(context, builder, signature, arguments):
        factor, row = arguments
        one = builder.insert_element(ir.Constant(row.type, ir.Undefined), factor, cgutils.int32_t(0))
        zeros = ir.Constant(ir.VectorType(cgutils.int32_t, row.type.count), None)
        return builder.fmul(builder.shuffle_vector(one, ir.Constant(row.type, ir.Undefined), zeros), row)

    return row(row.real, row), generate


@overload(operator.add)
def _add(a, b):
    if isinstance(a, RowType) and a == b:
        return lambda a, b: add_rows(a, b)
    return None


@overload(operator.mul)
def _multiply(factor, row):
    if isinstance(factor, types.Float) and isinstance(row, RowType):
        return lambda factor, row: scale_row(factor, row)
    return None
