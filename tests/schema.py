"""Whether scenes satisfy the JSON schema by which editors check them: what it uses of the standard, and no more."""

from functools import cache

from comove.model.files.version2 import SceneFile2

TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "integer": int,
    "null": type(None),
}


@cache
def schema():
    """The schema of version 2."""
    return SceneFile2.model_json_schema()


def satisfies(data, part=None):
    """Whether the contents of a file satisfy a part of the schema, or all of it."""
    part = schema() if part is None else part
    while "$ref" in part:
        part = schema()["$defs"][part["$ref"].rsplit("/", 1)[1]]
    if "anyOf" in part:
        return any(satisfies(data, option) for option in part["anyOf"])
    if "oneOf" in part:
        return sum(satisfies(data, option) for option in part["oneOf"]) == 1
    kind = part.get("type")
    if kind is not None and (
        not isinstance(data, TYPES[kind]) or (kind != "boolean" and isinstance(data, bool))
    ):
        return False
    if data != part.get("const", data) or data not in part.get("enum", [data]):
        return False
    if kind == "object":
        inner, others = part.get("properties", {}), part.get("additionalProperties", {})
        if not set(part.get("required", ())) <= set(data) or (others is False and set(data) - set(inner)):
            return False
        others = {} if isinstance(others, bool) else others
        return all(satisfies(value, inner.get(key, others)) for key, value in data.items())
    if kind == "array":
        return all(satisfies(one, part.get("items", {})) for one in data)
    if kind in ("number", "integer"):
        low, high = part.get("minimum", data), part.get("maximum", data)
        return low <= data <= high and data > part.get("exclusiveMinimum", -float("inf"))
    return True
