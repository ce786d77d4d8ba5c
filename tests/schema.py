"""The JSON schema of scene files of version 2, by which editors check them, and what it says of a scene."""

from functools import cache

from jsonschema import Draft202012Validator

from comove.model.files.version2 import SceneFile2


@cache
def validator():
    """The schema, as one of its standard."""
    schema = SceneFile2.model_json_schema()
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def satisfies(data):
    """Whether the contents of a file satisfy the schema."""
    return validator().is_valid(data)
