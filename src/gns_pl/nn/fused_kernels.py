"""The kernels of `nn.fused`, in Triton: messages of blocks of edges, and updates of blocks of nodes.

They make float32 products on tensor cores as sums of products of halves: a = hi + lo in float16 each, with hi hi
+ hi lo + lo hi accurate to 2⁻²² (Ootomo and Yokota 2022); "tf32" takes hi hi alone, which has TF32's eleven bits.
"""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def _matrix(weights, WIDTH: tl.constexpr):  # type: ignore[no-untyped-def]
    return tl.load(weights + tl.arange(0, WIDTH)[:, None] * WIDTH + tl.arange(0, WIDTH)[None, :])


@triton.jit
def _product(a, high, weights, WIDTH: tl.constexpr, PRECISION: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return a [M, L] times weights [L, L] in float32; `high` is what was loaded of them, the rest lies behind it."""
    if PRECISION == "float32":
        low = _matrix(weights + WIDTH * WIDTH, WIDTH)
        a_high = a.to(tl.float16)
        a_low = (a - a_high.to(tl.float32)).to(tl.float16)
        total = tl.dot(a_low, high)
        total = tl.dot(a_high, low, total)
        total = tl.dot(a_high, high, total)
    else:
        total = tl.dot(a.to(high.dtype), high)
    return total


@triton.jit
def _rectified(a):  # type: ignore[no-untyped-def]
    return tl.maximum(a, 0.0, propagate_nan=tl.PropagateNan.ALL)


@triton.jit
def _normalised(a, WIDTH: tl.constexpr, EPSILON: tl.constexpr):  # type: ignore[no-untyped-def]
    """Return rows over their deviation; their means are zero by the weights that made them (`FusedNetwork._mlp`)."""
    return a * tl.rsqrt(tl.sum(a * a, axis=1) / WIDTH + EPSILON)[:, None]


@triton.jit
def _deeper(  # type: ignore[no-untyped-def]
    hidden, weights, biases, WIDTH: tl.constexpr, DEEPER: tl.constexpr, PARTS: tl.constexpr, EPSILON: tl.constexpr,
    PRECISION: tl.constexpr,
):  # fmt: skip
    """Return what the layers behind a first one make of its output, over its deviation."""
    for layer in tl.static_range(DEEPER):
        here = weights + layer * PARTS * WIDTH * WIDTH
        hidden = _product(_rectified(hidden), _matrix(here, WIDTH), here, WIDTH, PRECISION)
        hidden += tl.load(biases + (layer + 1) * WIDTH + tl.arange(0, WIDTH))[None, :]
    return _normalised(hidden, WIDTH, EPSILON)


@triton.jit
def pass_messages(  # type: ignore[no-untyped-def]
    feature, state, sender, receiver, sending, receiving, summed, first_group, number, programs,
    encoder_first, encoder_weights, encoder_biases, encoder_norm, first, weights, biases, norm,
    WIDTH: tl.constexpr, BLOCK: tl.constexpr, GROUP: tl.constexpr, DEEPER: tl.constexpr, FEATURES: tl.constexpr,
    ENCODES: tl.constexpr, KEEPS: tl.constexpr, UPDATES: tl.constexpr, PARTS: tl.constexpr, EPSILON: tl.constexpr,
    PRECISION: tl.constexpr, HOISTS: tl.constexpr, STAGES: tl.constexpr,
):  # fmt: skip
    """Pass the messages of blocks of places; `summed` gets them by groups.

    Where `HOISTS`, weights are loaded once and stay in a multiprocessor's own memory for all its blocks.
    """
    GROUPS: tl.constexpr = BLOCK // GROUP
    column = tl.arange(0, WIDTH)
    if HOISTS:
        hoisted = _matrix(first, WIDTH)
        deeper = ()
        for layer in tl.static_range(DEEPER):
            deeper = deeper + (_matrix(weights + layer * PARTS * WIDTH * WIDTH, WIDTH),)  # type: ignore[assignment]  # noqa: RUF005
    blocks = tl.cdiv(tl.load(first_group + number), GROUPS)
    for block in tl.range(tl.program_id(0), blocks, programs, num_stages=STAGES):
        # E × L is more than 2³¹ from 17 million edges on.
        group = (block * GROUPS + tl.arange(0, GROUPS)).to(tl.int64)
        place = (block * BLOCK + tl.arange(0, BLOCK)).to(tl.int64)
        at = place[:, None] * WIDTH + column[None, :]
        source, target = tl.load(sender + place), tl.load(receiver + group)
        full = source >= 0
        if ENCODES:
            own = tl.zeros((BLOCK, WIDTH), tl.float32) + tl.load(encoder_first + FEATURES * WIDTH + column)[None, :]
            for each in tl.static_range(FEATURES):
                value = tl.load(feature + place * FEATURES + each)
                own += value[:, None] * tl.load(encoder_first + each * WIDTH + column)[None, :]
            own = _deeper(own, encoder_weights, encoder_biases, WIDTH, DEEPER, PARTS, EPSILON, PRECISION)
            own = own * tl.load(encoder_norm + column)[None, :] + tl.load(encoder_norm + WIDTH + column)[None, :]
        else:
            own = tl.load(state + at)
        if HOISTS:
            value = _product(own, hoisted, first, WIDTH, PRECISION)
        else:
            value = _product(own, _matrix(first, WIDTH), first, WIDTH, PRECISION)
        sent = tl.load(sending + source[:, None] * WIDTH + column[None, :], mask=full[:, None], other=0.0)
        got = tl.load(receiving + target[:, None] * WIDTH + column[None, :], mask=(target >= 0)[:, None], other=0.0)
        value += sent.to(tl.float32)
        got = tl.broadcast_to(got.to(tl.float32)[:, None, :], (GROUPS, GROUP, WIDTH))
        value += tl.reshape(got, (BLOCK, WIDTH))
        if HOISTS:
            for layer in tl.static_range(DEEPER):
                value = _product(_rectified(value), deeper[layer], weights, WIDTH, PRECISION)
                value += tl.load(biases + (layer + 1) * WIDTH + column)[None, :]
            value = _normalised(value, WIDTH, EPSILON)
        else:
            value = _deeper(value, weights, biases, WIDTH, DEEPER, PARTS, EPSILON, PRECISION)
        gain, shift = tl.load(norm + column)[None, :], tl.load(norm + WIDTH + column)[None, :]
        if KEEPS:
            kept = own.to(tl.float32)
            if UPDATES:
                kept = kept + shift + value * gain
            tl.store(state + at, kept.to(state.dtype.element_ty))
        value = tl.where(full[:, None], value, 0.0)
        total = tl.sum(tl.reshape(value, (GROUPS, GROUP, WIDTH)), axis=1)
        edges = tl.sum(tl.reshape(full.to(tl.float32), (GROUPS, GROUP)), axis=1)
        tl.store(summed + group[:, None] * WIDTH + column[None, :], total * gain + edges[:, None] * shift)


@triton.jit
def update_nodes(  # type: ignore[no-untyped-def]
    node, summed, first_group, first, weights, biases, norm, next_sender, next_receiver, next_bias,
    sending, receiving, number,
    WIDTH: tl.constexpr, BLOCK: tl.constexpr, DEEPER: tl.constexpr, HANDS_ON: tl.constexpr,
    PARTS: tl.constexpr, EPSILON: tl.constexpr, PRECISION: tl.constexpr,
):  # fmt: skip
    """Update a block of nodes by the sums of its groups, and make of them what the next layer needs."""
    row, column = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK), tl.arange(0, WIDTH)
    there = row < number
    begin = tl.load(first_group + row, mask=there, other=0)
    end = tl.load(first_group + row + 1, mask=there, other=0)
    received = tl.zeros((BLOCK, WIDTH), tl.float32)
    group, most = begin.to(tl.int64), tl.max(end - begin, axis=0)
    while most > 0:
        received += tl.load(summed + group[:, None] * WIDTH + column[None, :], mask=(group < end)[:, None], other=0.0)
        group += 1
        most -= 1
    at, inside = row[:, None] * WIDTH + column[None, :], there[:, None]
    state = tl.load(node + at, mask=inside, other=0.0)
    second = first + PARTS * WIDTH * WIDTH
    hidden = _product(received, _matrix(first, WIDTH), first, WIDTH, PRECISION)
    hidden += _product(state, _matrix(second, WIDTH), second, WIDTH, PRECISION)
    hidden += tl.load(biases + column)[None, :]
    hidden = _deeper(hidden, weights, biases, WIDTH, DEEPER, PARTS, EPSILON, PRECISION)
    state += hidden * tl.load(norm + column)[None, :] + tl.load(norm + WIDTH + column)[None, :]
    tl.store(node + at, state, mask=inside)
    if HANDS_ON:
        sent = _product(state, _matrix(next_sender, WIDTH), next_sender, WIDTH, PRECISION)
        tl.store(sending + at, sent.to(sending.dtype.element_ty), mask=inside)
        got = _product(state, _matrix(next_receiver, WIDTH), next_receiver, WIDTH, PRECISION)
        got += tl.load(next_bias + column)[None, :]
        tl.store(receiving + at, got.to(receiving.dtype.element_ty), mask=inside)
