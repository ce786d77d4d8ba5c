"""Points of messages of type sensor_msgs/msg/PointCloud2. It is used under ROS's own Python as well."""

from __future__ import annotations

from math import ceil, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:  # ROS's Python has no comove
    from numpy.typing import NDArray

AXES = ("x", "y", "z")
FLOATS = {7: "f4", 8: "f8"}
"""Types of fields by their numbers in sensor_msgs/msg/PointField."""


class CloudError(ValueError):
    """Error of a message whose points cannot be read, in words."""


def points_of(message: Any, most: int) -> NDArray[Any]:
    """Return points as they come; array, shape (3, n_points) [m]. Where nothing was seen they are not finite.

    Parameters
    ----------
    message : a PointCloud2, organised as an image or not
    most : number of points above which only every second, third, ... is read: of an image, column and row

    Raises
    ------
    CloudError
        If x, y or z is missing or no floating-point number, or the message is shorter than it says.
    """
    fields = {field.name: field for field in message.fields}
    if missing := [name for name in AXES if name not in fields]:
        raise CloudError(f"its points have no {missing[0]}, but {', '.join(fields) or 'nothing'}")
    order, (rows, columns) = "<>"[bool(message.is_bigendian)], (message.height, message.width)
    step, stride = message.point_step, message.row_step if rows > 1 else message.point_step * columns
    views = []
    for name in AXES:
        field = fields[name]
        if field.datatype not in FLOATS:
            raise CloudError(
                f"{name} is of type {field.datatype}, not FLOAT32 or FLOAT64 ({', '.join(map(str, FLOATS))})"
            )
        kind = np.dtype(order + FLOATS[field.datatype])
        ends_at = field.offset + kind.itemsize
        if rows * columns and (
            ends_at > step
            or step * columns > stride
            or stride * (rows - 1) + step * (columns - 1) + ends_at > len(message.data)
        ):
            raise CloudError(
                f"{len(message.data)} bytes are not {rows} rows of {columns} points of {step} bytes"
            )
        views.append((kind, field.offset))
    if not rows * columns:
        return np.zeros((3, 0))
    thin = max(1, ceil(sqrt(rows * columns / most) if rows > 1 else columns / most))
    down = thin if rows > 1 else 1
    return np.stack(
        [
            np.ndarray((rows, columns), kind, message.data, offset, (stride, step))[::down, ::thin].ravel()
            for kind, offset in views
        ]
    )
