"""Sixteen float32 numbers as one value, and the product of a tile of rows with a matrix, for compiled loops on the CPU.

Left to itself the compiler neither keeps a tile's sums in registers nor vectorises loops over 32 numbers whose count it
does not know. Here both are spelled out; LLVM turns 16 numbers into whatever vectors the processor has. Places are
counted in single numbers from the start of a contiguous array, and never checked.
"""

# mypy: disable-error-code="no-untyped-def"
from __future__ import annotations

import operator
from typing import Any

from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import intrinsic, overload, register_model

LANES = 16
"""Numbers of a value; widths are padded to a multiple of it."""

ROWS = 12 if binding.get_host_cpu_features().get("avx512f") else 6
"""Rows of a tile: its sums, one value each, fill the vector registers (32 of 16 numbers, or 16 of 8), but for a few."""

STRIDE = 64
"""Numbers from one row of a tile to the next: known to the compiler, whatever the width is."""

BAND = 4
"""Rows of a matrix to which `add_outer` adds at a time; they stay in registers."""

_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_FAST = ("reassoc", "contract", "nsz")  # NaN and infinity stay what they are


class LanesType(types.Type):  # type: ignore[misc]
    """Numba's type of sixteen numbers."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes{LANES}")


lanes = LanesType()


@register_model(LanesType)
class LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    """A vector of LLVM."""

    def __init__(self, manager: Any, kind: LanesType) -> None:
        super().__init__(manager, kind, _VECTOR)


def _data(context: Any, builder: Any, array_type: Any, array: Any) -> Any:
    return context.make_array(array_type)(context, builder, array).data


def _vector_at(builder: Any, data: Any, place: Any) -> Any:
    return builder.bitcast(builder.gep(data, [place]), _VECTOR.as_pointer())


def _repeated(builder: Any, number: Any) -> Any:
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    one = builder.insert_element(undefined, number, cgutils.int32_t(0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(cgutils.int32_t, LANES), None))


def _multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(_VECTOR, [_VECTOR] * 3), f"llvm.fmuladd.v{LANES}f32"
    )
    return builder.call(function, [a, b, c])


@intrinsic
def load(typing_context, array, place):
    """Return sixteen numbers of an array."""

    def generate(context, builder, signature, arguments):
        data = _data(context, builder, signature.args[0], arguments[0])
        return builder.load(_vector_at(builder, data, arguments[1]), align=4)

    return lanes(array, types.intp), generate


@intrinsic
def store(typing_context, array, place, value):
    """Write sixteen numbers of an array."""

    def generate(context, builder, signature, arguments):
        data = _data(context, builder, signature.args[0], arguments[0])
        builder.store(arguments[2], _vector_at(builder, data, arguments[1]), align=4)
        return context.get_dummy_value()

    return types.none(array, types.intp, value), generate


@intrinsic
def repeat(typing_context, number):
    """Return sixteen times a number."""
    return lanes(types.float32), lambda context, builder, signature, arguments: _repeated(builder, arguments[0])


@intrinsic
def rectify(typing_context, value):
    """Return what is positive, and 0 in the place of the rest; NaN stays NaN."""

    def generate(context, builder, signature, arguments):
        zero = ir.Constant(_VECTOR, None)
        return builder.select(builder.fcmp_ordered("<=", arguments[0], zero), zero, arguments[0])

    return value(value), generate


@intrinsic
def where_positive(typing_context, sign, value):
    """Return the numbers of a value where those of another one are positive, and 0 in the place of the rest."""

    def generate(context, builder, signature, arguments):
        zero = ir.Constant(_VECTOR, None)
        return builder.select(builder.fcmp_ordered(">", arguments[0], zero), arguments[1], zero)

    return value(sign, value), generate


@intrinsic
def total(typing_context, value):
    """Return the sum of sixteen numbers."""

    def generate(context, builder, signature, arguments):
        real = ir.FloatType()
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(real, [real, _VECTOR]), f"llvm.vector.reduce.fadd.v{LANES}f32"
        )
        return builder.call(function, [ir.Constant(real, 0.0), arguments[0]], fastmath=_FAST)

    return types.float32(value), generate


@intrinsic
def _add(typing_context, a, b):
    return a(a, b), lambda context, builder, signature, arguments: builder.fadd(*arguments, flags=_FAST)


@intrinsic
def _multiply(typing_context, a, b):
    return a(a, b), lambda context, builder, signature, arguments: builder.fmul(*arguments, flags=_FAST)


@overload(operator.add)
def _overload_add(a, b):
    return (lambda a, b: _add(a, b)) if a is lanes and b is lanes else None


@overload(operator.mul)
def _overload_multiply(a, b):
    return (lambda a, b: _multiply(a, b)) if a is lanes and b is lanes else None


@intrinsic
def add_product(typing_context, into, tile, column, weight, begin, width, depth):
    """Add to sixteen columns of a tile the product of another one with sixteen columns of a matrix.

    into[r, column + c] += Σ_k tile[r, k] weight[begin + k · width + column + c]; r < `ROWS`, c < `LANES`, k < depth.
    """

    def generate(context, builder, signature, arguments):
        into, tile, weight = (_data(context, builder, signature.args[n], arguments[n]) for n in (0, 1, 3))
        _, _, column, _, begin, width, depth = arguments
        places = [builder.add(column, column.type(r * STRIDE)) for r in range(ROWS)]
        targets = [_vector_at(builder, into, place) for place in places]
        sums = [cgutils.alloca_once_value(builder, builder.load(target, align=4)) for target in targets]
        begin = builder.add(begin, column)
        with cgutils.for_range(builder, depth) as loop:
            place = builder.add(begin, builder.mul(loop.index, width))
            factors = builder.load(_vector_at(builder, weight, place), align=4)
            for r, value in enumerate(sums):
                place = builder.add(loop.index, loop.index.type(r * STRIDE))
                number = _repeated(builder, builder.load(builder.gep(tile, [place])))
                builder.store(_multiply_add(builder, number, factors, builder.load(value)), value)
        for target, value in zip(targets, sums, strict=True):
            builder.store(builder.load(value), target, align=4)
        return context.get_dummy_value()

    place = types.intp
    return types.none(into, tile, place, weight, place, place, place), generate


@intrinsic
def add_outer(typing_context, into, begin, width, tile, row, above, column):
    """Add to `BAND` rows of sixteen columns of a matrix, which begins at `begin`, the products of two tiles' columns.

    into[begin + (row + k) · width + column + c] += Σ_r tile[r, row + k] above[r, column + c]; r < `ROWS`, c < `LANES`.
    """

    def generate(context, builder, signature, arguments):
        into, tile, above = (_data(context, builder, signature.args[n], arguments[n]) for n in (0, 3, 5))
        _, begin, width, _, row, _, column = arguments
        begin = builder.add(builder.add(begin, column), builder.mul(row, width))
        places = [builder.add(begin, builder.mul(width, width.type(k))) for k in range(BAND)]
        targets = [_vector_at(builder, into, place) for place in places]
        sums = [builder.load(target, align=4) for target in targets]
        for r in range(ROWS):
            factors = builder.load(_vector_at(builder, above, builder.add(column, column.type(r * STRIDE))), align=4)
            for k, value in enumerate(sums):
                place = builder.add(row, row.type(r * STRIDE + k))
                number = _repeated(builder, builder.load(builder.gep(tile, [place])))
                sums[k] = _multiply_add(builder, number, factors, value)
        for target, value in zip(targets, sums, strict=True):
            builder.store(value, target, align=4)
        return context.get_dummy_value()

    place = types.intp
    return types.none(into, place, place, tile, place, above, place), generate
