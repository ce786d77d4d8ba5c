"""numba's lowering of named tuples passed by address (see `shared`). It is imported when something is compiled."""

from __future__ import annotations

from functools import cache
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models, register_default
from numba.core.imputils import lower_builtin, lower_getattr_generic
from numba.core.pythonapi import NativeValue, unbox

from comove.compiled.shared import Shared

BYTE, WORD = ir.IntType(8), ir.IntType(64)
HEAD, WIDTH = 5, 8  # words of an array before its shape and strides; bytes of a word

register_default(Shared)(models.OpaqueModel)


@cache
def _words(one: Any) -> int:
    """Return the size of a tuple's part in memory, in words."""
    if isinstance(one, types.BaseTuple):
        return sum(map(_words, _parts(one)))
    if isinstance(one, types.Array):
        return HEAD + 2 * one.ndim
    if isinstance(one, types.NoneType):
        return 0
    return 2 if isinstance(one, types.Complex) or getattr(one, "bitwidth", 0) > WORD.width else 1


def _parts(one: Any) -> tuple:
    return tuple(one)


def _moved(builder: Any, address: Any, words: int) -> Any:
    return builder.gep(address, [WORD(WIDTH * words)], inbounds=True)


@unbox(Shared)
def _written(typ: Shared, tuple_: Any, c: Any) -> NativeValue:
    """Lay a tuple out on the stack. Its address is hidden, so that no load from it moves before the writes."""
    memory = cgutils.alloca_once(c.builder, ir.ArrayType(WORD, _words(typ)))
    start = c.builder.bitcast(memory, BYTE.as_pointer())
    failed = _write(typ, tuple_, start, c)
    hidden = ir.FunctionType(start.type, [start.type])
    address = c.builder.asm(hidden, "", "=r,0,~{memory}", [start], side_effect=True)
    return NativeValue(address, is_error=failed)


def _write(typ: Any, tuple_: Any, address: Any, c: Any) -> Any:
    """Write the parts of a tuple in order; return whether a type differs."""
    builder, at, failed = c.builder, 0, cgutils.false_bit
    for i, part in enumerate(_parts(typ)):
        there, value = _moved(builder, address, at), c.pyapi.tuple_getitem(tuple_, i)
        if isinstance(part, types.BaseTuple):
            error = _write(part, value, there, c)
        elif isinstance(part, types.Array):  # without a count: the caller keeps the array
            signature = ir.FunctionType(ir.IntType(32), [c.pyapi.pyobj, c.pyapi.voidptr])
            adapt = c.pyapi._get_function(signature, name="numba_adapt_ndarray")
            error = cgutils.is_not_null(builder, builder.call(adapt, (value, there)))
        elif isinstance(part, types.NoneType):
            continue
        else:
            native, model = c.unbox(part, value), c.context.data_model_manager[part]
            data = model.as_data(builder, native.value)
            builder.store(data, builder.bitcast(there, data.type.as_pointer()))
            error = native.is_error
        failed, at = builder.or_(failed, error), at + _words(part)
    return failed


def _part(context: Any, builder: Any, typ: Any, address: Any, index: int) -> Any:
    return _read(context, builder, typ[index], _moved(builder, address, sum(map(_words, typ.types[:index]))))


def _read(context: Any, builder: Any, one: Any, address: Any) -> Any:
    """Return the value in memory at an address."""
    if isinstance(one, Shared):
        return address
    if isinstance(one, types.NoneType):
        return context.get_dummy_value()
    if isinstance(one, types.BaseTuple):
        parts, at = [], 0
        for part in _parts(one):
            parts.append(_read(context, builder, part, _moved(builder, address, at)))
            at += _words(part)
        return context.make_tuple(builder, one, parts)
    if isinstance(one, types.Array):
        return _array(context, builder, one, address)
    model = context.data_model_manager[one]
    return model.from_data(builder, _loaded(builder, model.get_data_type(), address))


def _array(context: Any, builder: Any, one: types.Array, address: Any) -> Any:
    """Return an array whose references are not counted."""
    made = context.make_array(one)(context, builder)
    for word, name in enumerate(("parent", "nitems", "itemsize", "data"), start=1):
        kind = getattr(made, name).type
        setattr(made, name, _loaded(builder, kind, _moved(builder, address, word)))
    for name, first in (("shape", HEAD), ("strides", HEAD + one.ndim)):
        lengths = [_loaded(builder, WORD, _moved(builder, address, first + axis)) for axis in range(one.ndim)]
        setattr(made, name, cgutils.pack_array(builder, lengths, WORD))
    made.meminfo = cgutils.get_null_value(made.meminfo.type)
    return made._getvalue()


def _loaded(builder: Any, kind: Any, address: Any) -> Any:
    value = builder.load(builder.bitcast(address, kind.as_pointer()))
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value


@lower_getattr_generic(Shared)
def _field(context: Any, builder: Any, typ: Shared, address: Any, name: str) -> Any:
    return _part(context, builder, typ, address, typ.fields.index(name))


@lower_builtin("static_getitem", Shared, types.IntegerLiteral)
def _item(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    typ, index = signature.args[0], arguments[1]
    return _part(context, builder, typ, arguments[0], index if index >= 0 else index + len(typ))
