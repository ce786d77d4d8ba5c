"""Build the Python types that wheels of ROS 2 lack, by their generators and a C++ compiler.

Usage: PYTHON ros2_types.py, by the Python of the environment that has the wheels; the types are installed into it. On
a robot they come with ROS. Definitions are those of the packages beside this file, field by field as published: of
control_msgs, and of moveit_msgs with what it holds, only those that are used.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy

HERE = Path(__file__).parent
PACKAGES = ("control_msgs", "object_recognition_msgs", "octomap_msgs", "moveit_msgs")
"""Packages that are built, each after those whose types it holds."""
KINDS = ("msg", "srv", "action")
DEPENDS = (
    *("builtin_interfaces", "std_msgs", "trajectory_msgs", "geometry_msgs", "sensor_msgs", "shape_msgs"),
    *("action_msgs", "service_msgs", "unique_identifier_msgs"),
)
"""Packages of wheels."""
SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
PREFIX = Path(sys.prefix)


def generate(work, name):
    """Write the sources of a package's types below a folder, by one generator after the other."""
    from rosidl_adapter import convert_to_idl
    from rosidl_generator_c import generate_c as structs
    from rosidl_generator_py import generate_py
    from rosidl_generator_type_description import generate_type_hash
    from rosidl_typesupport_c import generate_c as dispatch
    from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c as serialise
    from rosidl_typesupport_introspection_c import generate_c as introspect

    source, share = HERE / name, PREFIX / "share"
    files = sorted(path.relative_to(source) for kind in KINDS for path in source.glob(f"{kind}/*"))
    for file in files:
        (work / "idl" / name / file.parent).mkdir(parents=True, exist_ok=True)
        convert_to_idl(source, name, file, work / "idl" / name)
    own = [other for other in PACKAGES[: PACKAGES.index(name)] if other != "control_msgs"]
    known = {other: share / other for other in DEPENDS} | {other: work / "idl" / other for other in own}
    described = {**known, **{other: work / "rosidl_generator_type_description" / other for other in own}}
    common = {
        "package_name": name,
        "idl_tuples": [f"{work}/idl/{name}:{file.with_suffix('.idl')}" for file in files],
        "ros_interface_files": [str(source / file) for file in files],
        "ros_interface_dependencies": [
            f"{other}:{path}" for other, folder in known.items() for path in folder.glob("*/*.idl")
        ],
        "target_dependencies": [],
        "include_paths": [f"{other}:{folder}" for other, folder in described.items()],
        "type_description_tuples": [
            f"{file.with_suffix('.idl')}:{work}/rosidl_generator_type_description/{name}/{file.with_suffix('.json')}"
            for file in files
        ],
    }
    generators = {
        "rosidl_generator_type_description": generate_type_hash,
        "rosidl_generator_c": structs,
        "rosidl_typesupport_fastrtps_c": serialise,
        "rosidl_typesupport_introspection_c": introspect,
        "rosidl_typesupport_c": lambda arguments: dispatch(arguments, list(SUPPORTS)),
        "rosidl_generator_py": lambda arguments: generate_py(arguments, ["rosidl_typesupport_c"]),
    }
    for folder, generator in generators.items():
        out = work / folder / name
        for kind in {file.parent for file in files} | {Path("msg")}:
            (out / kind / "detail").mkdir(parents=True, exist_ok=True)
        told = {**common, "output_dir": str(out), "template_dir": str(share / folder / "resource")}
        (work / f"{folder}.json").write_text(json.dumps(told))
        generator(str(work / f"{folder}.json"))
    for folder in ("rosidl_generator_c", *SUPPORTS):
        header = f"{folder}__visibility_control.h"
        text = (share / folder / "resource" / f"{header}.in").read_text()
        text = text.replace("@PROJECT_NAME@", name).replace("@PROJECT_NAME_UPPER@", name.upper())
        (work / folder / name / "msg" / header).write_text(text)


def as_few(work):
    """Return all sources below a folder, those in C++ as one a package: their headers take most of the time."""
    found = sorted(work.rglob("*.c"))
    for folder in ("rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c"):
        for name in PACKAGES:
            parts = sorted((work / folder / name).rglob("*.cpp"))
            found.append(work / f"{folder}-{name}.cpp")
            found[-1].write_text("".join(f'#include "{part}"\n' for part in parts))
    return found


def compile_all(work, extension):
    """Compile all sources below a folder into one extension."""
    include = PREFIX / "include"
    headers = [work / folder for folder in ("rosidl_generator_c", "rosidl_typesupport_c", *SUPPORTS)]
    headers += [include, *include.iterdir(), sysconfig.get_path("include"), numpy.get_include()]
    flags = ["-O0", "-fPIC", "-w", *(f"-I{header}" for header in headers)]

    def compiled(number, source):
        target = work / f"{number}.o"
        compiler = ["gcc"] if source.suffix == ".c" else ["g++", "-std=c++17"]
        subprocess.run([*compiler, *flags, "-c", str(source), "-o", str(target)], check=True)
        return str(target)

    sources = as_few(work)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        objects = list(pool.map(compiled, range(len(sources)), sources))
    parts = ("rosidl_generator_c", "rosidl_typesupport_c", *SUPPORTS, "rosidl_generator_py")
    runtime = ("rosidl_runtime_c", "rosidl_typesupport_c", "rcutils", "rmw", *SUPPORTS)
    runtime += ("rosidl_typesupport_fastrtps_cpp", "fastcdr")
    libraries = [PREFIX / "lib" / f"lib{other}__{part}.so" for other in DEPENDS for part in parts]
    libraries += [PREFIX / "lib" / f"lib{other}.so" for other in runtime]
    linked = ["g++", "-shared", "-o", str(extension), *objects, *map(str, libraries)]
    subprocess.run([*linked, f"-Wl,-rpath,{PREFIX / 'lib'}"], check=True)


def main():
    """Build, and install where Python and the dispatcher of type supports look."""
    site = Path(sysconfig.get_path("purelib"))
    extension = site / "types_of_tests.so"
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for name in PACKAGES:
            generate(work, name)
        compile_all(work, extension)
        for name in PACKAGES:
            python = work / "rosidl_generator_py" / name
            (python / "__init__.py").touch()
            ignored = shutil.ignore_patterns("*.c", "detail")
            shutil.copytree(python, site / name, dirs_exist_ok=True, ignore=ignored)
    for name in PACKAGES:
        links = [site / name / f"{name}_s__rosidl_typesupport_c.so"]
        links += [PREFIX / "lib" / f"lib{name}__{support}.so" for support in SUPPORTS]
        for link in links:
            link.unlink(missing_ok=True)
            link.symlink_to(extension)


if __name__ == "__main__":
    main()
