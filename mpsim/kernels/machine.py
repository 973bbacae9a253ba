"""The few machine operations that Numba lacks: vector overlap test, atomics, clock, yield and sleep.

Each is a plain Python function, slow and obvious, that also runs under NUMBA_DISABLE_JIT=1; the `instruction` or
`overload` below it is what compiled callers get. Libc functions are linked by name (`ExternalFunction`), because the
address that ctypes would give cannot be cached.
"""

# pyright: reportCallIssue=false, reportAttributeAccessIssue=false
# Types of Numba have attributes that it declares nowhere.

import functools
import os
import platform
import time

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

LANES = 8
"""Discs tested by one vector instruction. Results do not depend on it: lanes past the range are masked off."""

RUN = 16
"""Elements copied, or added to, by one vector operation. Nothing depends on it."""

_WORD = ir.IntType(64)
_HINT = {"x86_64": ("llvm.x86.sse2.pause", []), "aarch64": ("llvm.aarch64.hint", [1])}.get(platform.machine())
"""LLVM's name of the spin-loop hint on this processor, with its operands; None where there is none."""


def instruction(plain, typed):
    """Give compiled callers of a plain function what the decorated one builds, as for `intrinsic`.

    typed: called with the context and the types of its arguments, gives the signature.
    """

    def give(codegen):
        @intrinsic
        @functools.wraps(typed)
        def code(*arguments):
            return typed(*arguments), codegen

        @overload(plain)
        def compile_for(*arguments):
            def call(*arguments):
                return code(*arguments)

            return call

    return give


# --- the overlap test -------------------------------------------------------------------------------------------


def overlap_lanes(x, y, radius, start, xi, yi, reach):
    """Bit k is set if the centre of disc `start + k` is closer to (xi, yi) than their contact distance.

    radius None: all discs have the same, and reach is their diameter squared. Else reach is the radius of the disc at
    (xi, yi). Reads LANES elements from `start` on: arrays are padded by LANES. NaN compares as no overlap.
    """
    mask = 0
    for lane in range(LANES):
        dx = x[start + lane] - xi
        dy = y[start + lane] - yi
        limit = reach if radius is None else (radius[start + lane] + reach) * (radius[start + lane] + reach)
        if dx * dx + dy * dy < limit:
            mask |= 1 << lane
    return mask


def _vector(context, signature, lanes=LANES):
    return ir.VectorType(context.get_value_type(signature.args[0].dtype), lanes)


def _address(context, builder, array_type, array, index):
    return builder.gep(context.make_array(array_type)(context, builder, array).data, [index])


def _load(context, builder, array_type, array, start, vector):
    pointer = builder.bitcast(_address(context, builder, array_type, array, start), vector.as_pointer())
    return builder.load(pointer, align=array_type.dtype.bitwidth // 8)


def _store(context, builder, array_type, array, start, values):
    pointer = builder.bitcast(_address(context, builder, array_type, array, start), values.type.as_pointer())
    builder.store(values, pointer, align=array_type.dtype.bitwidth // 8)


def _broadcast(builder, scalar, vector):
    lane = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), [0] * vector.count)
    return builder.shuffle_vector(lane, lane, zeros)


@instruction(
    overlap_lanes,
    lambda _, x, y, radius, start, xi, yi, reach: types.int64(x, y, radius, types.int64, x.dtype, x.dtype, x.dtype),
)
def _overlap_lanes(context, builder, signature, args):
    vector = _vector(context, signature)
    load = lambda k: _load(context, builder, signature.args[k], args[k], args[3], vector)  # noqa: E731
    dx = builder.fsub(load(0), _broadcast(builder, args[4], vector))
    dy = builder.fsub(load(1), _broadcast(builder, args[5], vector))
    limit = _broadcast(builder, args[6], vector)
    if not isinstance(signature.args[2], types.NoneType):
        contact = builder.fadd(load(2), limit)
        limit = builder.fmul(contact, contact)
    distance_squared = builder.fadd(builder.fmul(dx, dx), builder.fmul(dy, dy))
    overlap = builder.fcmp_ordered("<", distance_squared, limit)
    return builder.zext(builder.bitcast(overlap, ir.IntType(LANES)), _WORD)


def lowest_bit(mask):
    """Index of the lowest set bit of a non-zero mask."""
    mask = int(mask)
    return (mask & -mask).bit_length() - 1


@instruction(lowest_bit, lambda _, mask: types.int64(types.int64))
def _lowest_bit(context, builder, signature, args):
    return builder.cttz(args[0], ir.Constant(ir.IntType(1), 1))


def nonnegative(index):
    """The index itself, known to be 0 or more, so that the compiler drops Python's wrap-around of negative ones."""
    return index


@instruction(nonnegative, lambda _, index: types.int64(types.int64))
def _nonnegative(context, builder, signature, args):
    assume = builder.module.declare_intrinsic("llvm.assume", (), ir.FunctionType(ir.VoidType(), [ir.IntType(1)]))
    builder.call(assume, [builder.icmp_signed(">=", args[0], ir.Constant(_WORD, 0))])
    return args[0]


def changed_lanes(before, after, start):
    """Bit k is set if element `start + k` differs between two arrays of whole numbers. Reads LANES elements of each."""
    mask = 0
    for lane in range(LANES):
        if before[start + lane] != after[start + lane]:
            mask |= 1 << lane
    return mask


@instruction(changed_lanes, lambda _, before, after, start: types.int64(before, after, types.int64))
def _changed_lanes(context, builder, signature, args):
    vector = _vector(context, signature)
    one, other = (_load(context, builder, signature.args[k], args[k], args[2], vector) for k in (0, 1))
    differ = builder.icmp_signed("!=", one, other)
    return builder.zext(builder.bitcast(differ, ir.IntType(LANES)), _WORD)


def copy_lanes(source, first, target, slot):
    """Copy RUN elements of `source` from `first` on to `target` from `slot` on."""
    target[slot : slot + RUN] = source[first : first + RUN]


@instruction(copy_lanes, lambda _, source, first, target, slot: types.void(source, types.int64, target, types.int64))
def _copy_lanes(context, builder, signature, args):
    vector = _vector(context, signature, RUN)
    values = _load(context, builder, signature.args[0], args[0], args[1], vector)
    _store(context, builder, signature.args[2], args[2], args[3], values)
    return context.get_dummy_value()


def add_to_lanes(array, start, number, value):
    """Add `value` to a number of elements from `start` on, at most RUN. Reads and writes back all RUN of them."""
    array[start : start + min(number, RUN)] += value


@instruction(
    add_to_lanes, lambda _, array, start, number, value: types.void(array, types.int64, types.int64, types.int64)
)
def _add_to_lanes(context, builder, signature, args):
    vector = _vector(context, signature, RUN)
    element = vector.element
    lanes = ir.Constant(vector, [ir.Constant(element, k) for k in range(RUN)])
    number = _broadcast(builder, builder.trunc(args[2], element), vector)
    value = _broadcast(builder, builder.trunc(args[3], element), vector)
    added = builder.select(builder.icmp_signed("<", lanes, number), value, ir.Constant(vector, None))
    values = _load(context, builder, signature.args[0], args[0], args[1], vector)
    _store(context, builder, signature.args[0], args[0], args[1], builder.add(values, added))
    return context.get_dummy_value()


# --- atomics on one int64 word ------------------------------------------------------------------------------------


def atomic_load(words, index):
    """Value of words[index]; nothing after it in the program is read before it (acquire)."""
    return words[index]


@instruction(atomic_load, lambda _, words, index: types.int64(words, types.int64))
def _atomic_load(context, builder, signature, args):
    pointer = _address(context, builder, signature.args[0], args[0], args[1])
    return builder.load_atomic(pointer, "seq_cst", 8)


def atomic_store(words, index, value):
    """words[index] = value, visible to others after everything written before it (release, and a full fence)."""
    words[index] = value


@instruction(atomic_store, lambda _, words, index, value: types.void(words, types.int64, types.int64))
def _atomic_store(context, builder, signature, args):
    pointer = _address(context, builder, signature.args[0], args[0], args[1])
    builder.store_atomic(args[2], pointer, "seq_cst", 8)
    return context.get_dummy_value()


def atomic_add(words, index, value):
    """Add to words[index] as one indivisible step; returns the value before."""
    before = words[index]
    words[index] = before + value
    return before


@instruction(atomic_add, lambda _, words, index, value: types.int64(words, types.int64, types.int64))
def _atomic_add(context, builder, signature, args):
    pointer = _address(context, builder, signature.args[0], args[0], args[1])
    return builder.atomic_rmw("add", pointer, args[2], "seq_cst")


# --- time: clock, pause, yield, sleep -----------------------------------------------------------------------------

_CLOCK_MONOTONIC = time.CLOCK_MONOTONIC
_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.CPointer(types.int64)))
_nanosleep = types.ExternalFunction("nanosleep", types.int32(types.CPointer(types.int64), types.CPointer(types.int64)))
_sched_yield = types.ExternalFunction("sched_yield", types.int32())


def now(timespec):
    """Monotonic clock, in nanoseconds. `timespec` is scratch space: two int64 words that belong to the caller."""
    return time.monotonic_ns()


@overload(now)
def _compile_now(timespec):
    def implementation(timespec):
        _clock_gettime(np.int32(_CLOCK_MONOTONIC), timespec.ctypes)
        return timespec[0] * 1_000_000_000 + timespec[1]

    return implementation


def sleep_briefly(timespec, nanoseconds):
    """Release the core for about `nanoseconds` (less than one second). `timespec` is scratch space."""
    time.sleep(nanoseconds * 1e-9)


@overload(sleep_briefly)
def _compile_sleep_briefly(timespec, nanoseconds):
    def implementation(timespec, nanoseconds):
        timespec[0] = 0
        timespec[1] = nanoseconds
        _nanosleep(timespec.ctypes, timespec.ctypes)

    return implementation


def yield_core():
    """Let another runnable process use this core now."""
    os.sched_yield()


@overload(yield_core)
def _compile_yield_core():
    def implementation():
        _sched_yield()

    return implementation


def pause():
    """Tell the core that this is a spin loop (x86 `pause`, Arm `yield`)."""


@instruction(pause, lambda _: types.void())
def _pause(context, builder, signature, args):
    if _HINT is not None:
        name, operands = _HINT
        signature = ir.FunctionType(ir.VoidType(), [ir.IntType(32) for _ in operands])
        hint = cgutils.get_or_insert_function(builder.module, signature, name)
        builder.call(hint, [ir.Constant(ir.IntType(32), operand) for operand in operands])
    return context.get_dummy_value()
