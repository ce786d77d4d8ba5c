"""The page of a scene file's keys, written from the models that read it."""

from __future__ import annotations

import ast
import inspect
import itertools
import textwrap
import types
from typing import Any, get_args, get_origin

from pydantic import BaseModel

from comove.model.constraints import KINDS, ConstraintKeys
from comove.model.files.keys import SceneFile
from comove.model.files.version2 import SceneFile2

INTRODUCTION = """# Scene files: keys

Every key of a scene file, from the models that read it: `SceneFile2` is version 2, `SceneFile` version 1. Keys
without a default are required; unknown keys are errors.
[Scenes](../scenes.md) says what they mean, with examples.
"""


def page() -> str:
    """Return the Markdown of the page on the keys of scene files."""
    parts = [INTRODUCTION]
    for model in dict.fromkeys([*_models(SceneFile2), *_models(SceneFile)]):
        parts += [
            f"## {model.__name__}",
            "",
            _about(model),
            "",
            "| key | type | default | |",
            "|---|---|---|---|",
        ]
        remarks = _remarks(model)
        for name, field in model.model_fields.items():
            default = "required" if field.is_required() else f"`{_default(field)}`"
            about = remarks.get(name, "")
            parts.append(f"| `{name}` | {_type(field.annotation)} | {default} | {about} |")
        parts.append("")
    return "\n".join(parts)


def _about(model: type[BaseModel]) -> str:
    return inspect.cleandoc(model.__doc__ or "")


def _remarks(model: type[BaseModel]) -> dict[str, str]:
    """Return what stands below the fields of a model, in its source, by name."""
    remarks: dict[str, str] = {}
    for owner in reversed(model.__mro__):
        if not issubclass(owner, BaseModel) or owner is BaseModel:
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(owner))).body[0].body
        for field, below in itertools.pairwise(body):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                remarks[field.target.id] = " ".join(ast.literal_eval(below.value).split())
    return remarks


def _default(field: Any) -> object:
    value = field.get_default(call_default_factory=True)
    return (
        "none"
        if value is None
        else value.model_dump(exclude_none=True)
        if isinstance(value, BaseModel)
        else value
    )


def _models(model: type[BaseModel]) -> list[type[BaseModel]]:
    """Return a model and all models below it, in the order in which keys lead to them."""
    found = [model]
    for field in model.model_fields.values():
        for part in _parts(field.annotation):
            found += [inner for inner in _models(part) if inner not in found]
    return found


def _parts(annotation: Any) -> list[type[BaseModel]]:
    """Return the models that an annotation mentions."""
    if annotation is ConstraintKeys:  # which of them it is, only the file says
        return list(KINDS.values())
    if isinstance(annotation, type) and not get_args(annotation) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _parts(inner)]


def _type(annotation: Any) -> str:
    """Return an annotation in words that readers of scene files know."""
    models = _parts(annotation)
    if models:
        return "one of " * (len(models) > 1) + ", ".join(
            f"[{m.__name__}](#{m.__name__.lower()})" for m in models
        )
    if isinstance(annotation, types.UnionType) or get_origin(annotation) is not None:
        inner = [_type(part) for part in get_args(annotation) if part is not type(None) and part is not ...]
        kinds = " or ".join(dict.fromkeys(part for part in inner if part))
        return f"list of {kinds}" if get_origin(annotation) in (tuple, list) else kinds
    names = {"str": "text", "float": "number", "int": "whole number", "bool": "true or false"}
    if isinstance(annotation, type):
        return names.get(annotation.__name__, annotation.__name__)
    return f"`{annotation}`" if isinstance(annotation, str) else ""
