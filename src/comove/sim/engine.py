"""Lazy import of MuJoCo, its drawing backend, and model helpers.

MuJoCo chooses its drawing backend at import, by the environment variable MUJOCO_GL. Without a screen, this is EGL
where it can open a display, else OSMesa, else none: a simulation needs no pictures.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from types import ModuleType
from typing import Any

from comove.errors import ExtraError, OptionError

STIFF = (0.004, 1.0)  # s, time constant and damping ratio of contacts and grasps: two time steps
THE_LOAD = "the load"  # with a blank, as no link of a URDF is called
NO_PICTURES = "disabled"
INSTALL = "apt-get install libegl1 libosmesa6 libgl1-mesa-dri"

_EGL_NO_DISPLAY = 0
_EGL_PLATFORM_DEVICE = 0x313F  # EGL_EXT_platform_device
_MOST_DEVICES = 16


@cache
def engine() -> ModuleType:
    """Import and return the module mujoco.

    Raises
    ------
    ExtraError
        If MuJoCo is not installed.
    OptionError
        If the environment variable MUJOCO_GL has a value that is unknown to MuJoCo.
    """
    if "mujoco" not in sys.modules and sys.platform.startswith("linux"):
        os.environ.setdefault("MUJOCO_GL", drawing_backend())
    try:
        import mujoco
    except ImportError as error:
        raise ExtraError("simulation", "sim") from error
    except RuntimeError as error:  # of the environment that it is given
        way_out = "leave it unset, or set it to egl, osmesa or disabled"
        raise OptionError(f"MuJoCo says: {error}", key="MUJOCO_GL", way_out=way_out) from error
    return mujoco


@contextmanager
def without_log() -> Iterator[None]:
    """Keep MuJoCo from writing warnings to a file. Instability is reported otherwise."""
    mujoco = engine()
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def require_pictures() -> None:
    """Check that pictures can be drawn."""
    engine()
    if os.environ.get("MUJOCO_GL", "").lower() in (NO_PICTURES, "disable", "off", "false", "0"):
        raise no_pictures("neither EGL nor OSMesa works here")


def no_pictures(reason: str) -> OptionError:
    """Return the error with reason and advice where nothing can be drawn."""
    way_out = f"{INSTALL}, and leave MUJOCO_GL unset; the simulation itself needs none of it"
    if "MUJOCO_GL" not in os.environ and (works := drawing_backend()) != NO_PICTURES:
        reason += "; mujoco was imported before comove, and took another backend than works here"
        way_out = f"set MUJOCO_GL={works} before Python starts"
    return OptionError(f"pictures cannot be drawn: {reason}", key="MUJOCO_GL", way_out=way_out)


@cache
def drawing_backend() -> str:
    """Return the default of MUJOCO_GL: egl, osmesa or disabled."""
    if _egl_works():
        return "egl"
    return "osmesa" if _loads("OSMesa") else NO_PICTURES


def _loads(library: str) -> ctypes.CDLL | None:
    name = ctypes.util.find_library(library)
    try:
        return None if name is None else ctypes.CDLL(name)
    except OSError:
        return None


def _egl_works() -> bool:
    """Return whether EGL opens a display on any device. A library without a driver does not."""
    egl = _loads("EGL")
    if egl is None:
        return False
    egl.eglGetProcAddress.restype = ctypes.c_void_p
    egl.eglInitialize.argtypes = [ctypes.c_void_p] * 3
    addresses = [egl.eglGetProcAddress(n) for n in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")]
    if not all(addresses):
        return False
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(addresses[0])
    display_of = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(
        addresses[1]
    )
    devices, count = (ctypes.c_void_p * _MOST_DEVICES)(), ctypes.c_int()
    if not query(_MOST_DEVICES, devices, ctypes.byref(count)):
        return False
    displays = [display_of(_EGL_PLATFORM_DEVICE, device, None) for device in devices[: count.value]]
    return any(d not in (None, _EGL_NO_DISPLAY) and egl.eglInitialize(d, None, None) for d in displays)


def hangs_on(model: Any, body: int, other: int) -> bool:
    """Return whether a body is `other` or its descendant."""
    while body not in (0, other):
        body = int(model.body_parentid[body])
    return body == other


def below(body: Any) -> list[Any]:
    """Return a body of a specification and all its descendants."""
    return [body, *body.find_all(engine().mjtObj.mjOBJ_BODY)]


def add_servo(spec: Any, joint: str, stiffness: float, damping: float, force: float) -> None:
    """Add a servo of one joint, under the joint's name. Its control is the reference position."""
    mj = engine()
    servo = spec.add_actuator(name=joint, target=joint, trntype=mj.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mj.mjtGain.mjGAIN_FIXED, mj.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0] = stiffness
    servo.biasprm[:3] = 0.0, -stiffness, -damping
    servo.forcelimited, servo.forcerange = True, (-force, force)
