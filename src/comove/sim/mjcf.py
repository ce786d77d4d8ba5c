"""Conversion of MuJoCo models (MJCF) to URDFs of robots.

The model is compiled by MuJoCo, so that defaults, included files and scaled meshes are as in MuJoCo, and then
written body by body. A URDF's link has its joint's frame: for a body whose joints are elsewhere, or several, there
are links without bodies between. Floor and furniture become obstacles of a scene, and freely moving bodies payloads
(`comove.sim.mjcf_surroundings`). A robot with a free base is fixed at its initial pose.

Every joint has an effort and a velocity, without which other readers refuse a URDF. Where the model limits neither,
they are guesses, which the attribute ``comove:guessed`` of the limit names. ``comove:springs`` of a joint is the
share of its weight that the model takes off its motor (``gravcomp``). Other readers ignore these attributes.
"""

from __future__ import annotations

import subprocess
import sys
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import ComoveWarning, MeshError, RobotError
from comove.geometry.rotations import matrices
from comove.geometry.triangles import as_stl, elements_of
from comove.robots.formats import MAX_BYTES, MJCF, bytes_in, require_format
from comove.robots.proposal.tree import GUESSED, GUESSES, SPRINGS
from comove.sim.engine import engine
from comove.sim.mjcf_actuators import drives_of
from comove.sim.mjcf_left_out import LeftOut
from comove.sim.mjcf_surroundings import MeshFile, ModelSurroundings, Roles, fragment
from comove.sim.urdf import text_of, write_origin

ROOT = "world"
MESHES = "meshes"  # folder beside the URDF
DRAWN = (0, 1, 2)  # groups of shapes that MuJoCo's viewers draw unless asked otherwise
NAMESPACE = "urn:comove"  # of attributes that other readers pass over
SECONDS, GIGABYTES, REFUSED = 30, 4, 3
BUILD = f"""
import resource, sys
import mujoco
seconds, gigabytes = int(sys.argv[2]), int(sys.argv[3])
limits = {{resource.RLIMIT_CPU: seconds, resource.RLIMIT_AS: gigabytes << 30, resource.RLIMIT_CORE: 0}}
for kind, most in limits.items():
    ceiling = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (most if ceiling < 0 else min(most, ceiling), ceiling))
try:
    mujoco.MjModel.from_xml_path(sys.argv[1])
except ValueError as error:
    print(str(error).splitlines()[0] if str(error) else "")
    sys.exit({REFUSED})
"""
"""Program that builds a model and says why it cannot; it ends itself where that takes too much."""
KNOWN = ("BOX", "SPHERE", "CYLINDER", "CAPSULE", "MESH")


@dataclass(frozen=True)
class Converted:
    """Converted model as files.

    Attributes
    ----------
    name : name of the model
    urdf, srdf : texts; the SRDF names the pairs of links that the model excludes, None where it excludes none
    obstacles : text of the static obstacles around the robot, for scenes; None without any
    meshes : binary STL by file name, expected in the folder `MESHES` beside the URDF
    notes : notes on guesses, omissions, and bodies that are no part of the robot
    """

    name: str
    urdf: str
    srdf: str | None
    obstacles: str | None
    meshes: dict[str, bytes]
    notes: tuple[str, ...]


def urdf_of(file: Path) -> Converted:
    """Convert a MuJoCo model to a URDF.

    Raises
    ------
    RobotError
        If MuJoCo cannot read it, it has no robot, or a joint has no counterpart in a URDF.
    ExtraError
        If MuJoCo is not installed.
    """
    return _Writer(engine(), model_in(file), file).converted()


def robot_of(model: Any, name: str) -> Converted:
    """Convert the robot of a compiled model alone. Its `obstacles` are None.

    Raises
    ------
    RobotError
        If the model has no robot, or a joint has no counterpart in a URDF.
    """
    return _Writer(engine(), model, Path(name)).written()


def obstacles_in(file: Path) -> list[dict[str, Any]]:
    """Return the static bodies of a MuJoCo model as obstacles. A robot in it is left out.

    Raises
    ------
    RobotError
        If MuJoCo cannot read it, or a static mesh has a file that no obstacle can have.
    ExtraError
        If MuJoCo is not installed.
    """
    mj, model = engine(), model_in(file)
    drives = drives_of(mj, model)
    roles = Roles.of(mj, model, drives)
    spec = mj.MjSpec.from_file(str(file))
    spec.compile()  # which numbers its meshes
    meshes = {mesh.id: mesh for mesh in spec.meshes}
    around = ModelSurroundings(
        mj, model, roles, lambda number: _original(model, number, meshes[number], file)
    )
    found = around.obstacles()
    moved = [
        f"'{model.body(root).name or root}' has joints: it is no obstacle" for root in sorted(roles.robot)
    ]
    for note in (*around.notes, *moved, *around.payloads()):
        warnings.warn(f"{file}: {note}", ComoveWarning, stacklevel=2)
    return found


def _original(model: Any, number: int, mesh: Any, file: Path) -> MeshFile:
    """Return a mesh's file, and its frame in the compiled mesh. MuJoCo subtracts `refpos` of the specified mesh from
    vertices, rotates them by the conjugate of `refquat`, scales them, and then centres and rotates them once more."""
    name, start = model.mesh(number).name or number, int(model.mesh_pathadr[number])
    if start < 0:
        told = f"the triangles of '{name}' are written in the model"
        raise RobotError(
            told, file=file, way_out="write them to an STL or OBJ file, and name that in the model"
        )
    scale = model.mesh_scale[number]
    if np.ptp(scale) > 1e-9 * abs(scale[0]) or scale[0] <= 0.0:
        told = f"'{name}' is scaled by {scale.tolist()}"
        raise RobotError(told, file=file, way_out="scale its file, so that one positive number will do")
    path = Path(model.paths[start:].split(b"\0", 1)[0].decode())
    turn = matrices(model.mesh_quat[number]).T
    reference = matrices(mesh.refquat / np.linalg.norm(mesh.refquat)).T
    position = -turn @ (scale[0] * reference @ mesh.refpos + model.mesh_pos[number])
    return MeshFile(path.resolve(), float(scale[0]), position, turn @ reference)


def model_in(file: Path) -> Any:
    """Return a compiled MuJoCo model.

    Raises
    ------
    RobotError
        If MuJoCo cannot read it.
    """
    with suppress(MeshError):  # what is no XML is told by MuJoCo
        require_format(elements_of(bytes_in(file, MAX_BYTES)), file, MJCF)
    _require_bounded(file)
    return engine().MjModel.from_xml_path(str(file))


def _require_bounded(file: Path) -> None:
    """Refuse a model that exceeds `SECONDS` of processor time or `GIGABYTES`. A line of a model may ask for any
    number of bodies, and MuJoCo builds it in native code that cannot be stopped. It is therefore built in a process
    of its own first."""
    command = [sys.executable, "-c", BUILD, str(file), str(SECONDS), str(GIGABYTES)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    if done.returncode == 0:
        return
    if done.returncode == REFUSED:
        told, way_out = f"MuJoCo cannot read it: {done.stdout.strip() or 'it is no model'}", "correct it"
    else:
        told = f"MuJoCo needs more than {SECONDS} s of processor time or {GIGABYTES} GB for it"
        way_out = "make it smaller"
    raise RobotError(told, file=file, way_out=way_out)


class MeshFiles:
    """Meshes of a compiled model as binary STL, named when used.

    `files` has their contents by name.
    """

    def __init__(self, model: Any):
        self.model, self.files = model, dict[str, bytes]()
        self._named: dict[int, str] = {}

    def name_of(self, number: int) -> str:
        """Return the file name of a mesh, and keep its triangles."""
        model = self.model
        if number in self._named:
            return self._named[number]
        stem = str(model.mesh(number).name or number).replace("/", "-")
        name = f"{stem}.stl" if f"{stem}.stl" not in self.files else f"{stem}-{number}.stl"
        self._named[number] = name
        first, faces = int(model.mesh_vertadr[number]), int(model.mesh_faceadr[number])
        vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[number])]
        corners = model.mesh_face[faces : faces + int(model.mesh_facenum[number])]
        self.files[name] = as_stl(np.asarray(vertices, dtype=np.float64), np.asarray(corners, dtype=np.int64))
        return name


class _Writer:
    """Writer of one compiled model."""

    def __init__(self, mj: Any, model: Any, file: Path):
        self.mj, self.model, self.file = mj, model, file
        self.robot = ET.Element("robot", {"name": file.stem, "xmlns:comove": NAMESPACE})
        self.meshes = MeshFiles(model)
        self.drives = drives_of(mj, model)
        self.roles = Roles.of(mj, model, self.drives)
        self.told: dict[str, list[str]] = {}

    def converted(self) -> Converted:
        """Return the whole model."""
        robot = self.written()
        around = ModelSurroundings(
            self.mj,
            self.model,
            self.roles,
            lambda number: MeshFile(f"{MESHES}/{self.meshes.name_of(number)}"),
        )
        obstacles = around.obstacles()
        return replace(
            robot,
            obstacles=fragment(obstacles, self.file) if obstacles else None,
            notes=(*robot.notes, *around.notes, *around.payloads()),
        )

    def written(self) -> Converted:
        """Return the robot alone."""
        model, name = self.model, self.file.stem
        if not self.roles.robot:
            raise RobotError(
                "nothing in it has a joint that turns or slides",
                file=self.file,
                way_out="name a robot's model",
            )
        ET.SubElement(self.robot, "link", name=ROOT)
        for body in range(1, model.nbody):
            if int(model.body_rootid[body]) in self.roles.robot:
                self._body(body)
        pairs = [self._excluded(number) for number in range(model.nexclude)]
        links = {link.get("name") for link in self.robot.findall("link")}
        srdf = ET.Element("robot", name=name)
        for first, second in pairs:
            if {first, second} <= links:
                ET.SubElement(srdf, "disable_collisions", link1=first, link2=second, reason="User")
            else:
                self._tell(
                    "the model lets {} touch each other, one of which is no part of the robot",
                    f"'{first}' and '{second}'",
                )
        for tree in (self.robot, srdf):
            ET.indent(tree)
        told = [text.format(", ".join(names)) for text, names in self.told.items()]
        return Converted(
            name,
            ET.tostring(self.robot, encoding="unicode"),
            ET.tostring(srdf, encoding="unicode") if len(srdf) else None,
            None,
            self.meshes.files,
            (*told, *LeftOut(self.mj, model, self.roles.robot).notes()),
        )

    def _tell(self, text: str, name: str) -> None:
        self.told.setdefault(text, []).append(name)

    def _link(self, body: int) -> str:
        return ROOT if body == 0 else str(self.model.body(body).name or f"body{body}")

    def _excluded(self, number: int) -> tuple[str, str]:
        signature = int(self.model.exclude_signature[number])
        return self._link(signature >> 16), self._link(signature & 0xFFFF)

    def _body(self, body: int) -> None:
        """Write a body's link, and the joints from its parent to it."""
        model, name = self.model, self._link(body)
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        turning = [k for k in range(first, first + count) if model.jnt_type[k] != self.mj.mjtJoint.mjJNT_FREE]
        above = self._link(int(model.body_parentid[body]))
        place, rotation = model.body_pos[body], matrices(model.body_quat[body])
        for joint in turning:  # its frame is turned as the body is, and stands where the joint does
            anchor, below = model.jnt_pos[joint], f"{name}-{joint}"
            if joint == turning[-1] and not anchor.any():
                below = name
            else:
                ET.SubElement(self.robot, "link", name=below)
            self._joint(joint, above, below, place + rotation @ anchor, rotation)
            above, place, rotation = below, -anchor, np.eye(3)
        if above != name:
            self._connect(f"{name}-fixed", "fixed", above, name, place, rotation)
        self.robot.append(self._bodies(body, name))

    def _joint(self, joint: int, above: str, below: str, place: Array, rotation: Array) -> None:
        model, name = self.model, str(self.model.joint(joint).name or f"joint{joint}")
        slides = model.jnt_type[joint] == self.mj.mjtJoint.mjJNT_SLIDE
        if not slides and model.jnt_type[joint] != self.mj.mjtJoint.mjJNT_HINGE:
            raise RobotError(
                f"'{name}' is a ball joint, which no URDF has", file=self.file, way_out="write three hinges"
            )
        begins = float(model.qpos0[model.jnt_qposadr[joint]])
        if begins != 0.0:
            raise RobotError(
                f"the joint '{name}' is at {begins:g} where the model stands",
                file=self.file,
                way_out="leave out its 'ref', and turn the body instead",
            )
        drive = self.drives[joint]
        lower, upper = self._range(joint, name)
        limited = lower < upper and np.isfinite([lower, upper]).all()
        kind = "prismatic" if slides else "revolute" if limited else "continuous"
        element = self._connect(name, kind, above, below, place, rotation)
        ET.SubElement(element, "axis", xyz=text_of(model.jnt_axis[joint]))
        limit = ET.SubElement(element, "limit")
        if limited:
            limit.set("lower", repr(lower))
            limit.set("upper", repr(upper))
        elif slides:
            self._tell("nothing limits how far {} slide: give limits in the description", f"'{name}'")
        known = {"effort": drive.effort, "velocity": drive.velocity if isfinite(drive.velocity) else None}
        for key, value in known.items():
            limit.set(key, repr(GUESSED[kind][key] if value is None else value))
        if guessed := [key for key, value in known.items() if value is None]:
            limit.set(GUESSES, " ".join(guessed))
        self._tell_motor(joint, name, kind, known)
        self._add_dynamics(element, joint, name)
        leads = self._leads(joint)
        if leads is not None:
            other, offset, multiplier = leads
            ET.SubElement(element, "mimic", joint=other, multiplier=repr(multiplier), offset=repr(offset))

    def _range(self, joint: int, name: str) -> tuple[float, float]:
        """Return a joint's range within its servo commands, infinite if unlimited."""
        model, drive = self.model, self.drives[joint]
        lower, upper = model.jnt_range[joint].tolist() if model.jnt_limited[joint] else (-np.inf, np.inf)
        told = max(lower, drive.lower), min(upper, drive.upper)
        if told[0] < told[1]:
            return told
        self._tell("the commands of the servo of {} lie outside its range, which is taken", f"'{name}'")
        return lower, upper

    def _tell_motor(self, joint: int, name: str, kind: str, known: dict[str, float | None]) -> None:
        """Note guesses and changes of a joint's motor."""
        drive, model = self.drives[joint], self.model
        unit = {
            "effort": "N" if kind == "prismatic" else "N m",
            "velocity": "m/s" if kind == "prismatic" else "rad/s",
        }
        for key, value in known.items():
            if value is None:
                guess = f"{GUESSED[kind][key]:g} {unit[key]}"
                self._tell(f"the model limits no {key} of {{}}: {guess} is a guess", f"'{name}'")
        if not drive.is_driven:
            self._tell("no actuator drives {}", f"'{name}'")
        elif drive.is_one_sided:
            self._tell(
                "actuators drive {} one way only: their largest effort is taken for both ways", f"'{name}'"
            )
        elif drive.effort is not None and drive.least != -drive.largest:
            self._tell("actuators of {} are stronger one way: the lesser effort is taken", f"'{name}'")
        if model.jnt_stiffness[joint].any():
            self._tell("{} have springs in the model, which no URDF has: they are left out", f"'{name}'")

    def _add_dynamics(self, element: ET.Element, joint: int, name: str) -> None:
        """Add a joint's damping, dry friction and gravity compensation."""
        model = self.model
        dof = int(model.jnt_dofadr[joint])
        damping, friction = float(np.ravel(model.dof_damping[dof])[0]), float(model.dof_frictionloss[dof])
        if damping or friction:
            ET.SubElement(element, "dynamics", damping=repr(damping), friction=repr(friction))
        share = self._compensated(joint)
        if share > 0.0:
            element.set(SPRINGS, repr(share))
            self._tell(f"the model takes {share:.0%} of the weight off {{}}", f"'{name}'")

    def _compensated(self, joint: int) -> float:
        """Return the share of the moved weight without load on the motor."""
        model, root = self.model, int(self.model.jnt_bodyid[joint])
        if model.jnt_actgravcomp[joint]:
            return 0.0
        moved = {root}
        for body in range(root + 1, model.nbody):
            if int(model.body_parentid[body]) in moved:
                moved.add(body)
        shares = [float(model.body_gravcomp[body]) for body in moved if model.body_mass[body] > 0.0]
        return min(max(min(shares, default=0.0), 0.0), 1.0)

    def _leads(self, joint: int) -> tuple[str, float, float] | None:
        """Return a joint's leading joint, offset and multiplier; None if free."""
        model = self.model
        for k in range(model.neq):
            couples = model.eq_type[k] == self.mj.mjtEq.mjEQ_JOINT and model.eq_obj2id[k] >= 0
            couples = couples and bool(model.eq_active0[k])
            if couples and model.eq_obj1id[k] == joint and not model.eq_data[k, 2:5].any():
                other = int(model.eq_obj2id[k])
                return str(model.joint(other).name or f"joint{other}"), *model.eq_data[k, :2].tolist()
        return None

    def _connect(
        self, name: str, kind: str, above: str, below: str, place: Array, rotation: Array
    ) -> ET.Element:
        joint = ET.SubElement(self.robot, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=above)
        ET.SubElement(joint, "child", link=below)
        write_origin(joint, place, rotation)
        return joint

    def _bodies(self, body: int, name: str) -> ET.Element:
        """Return a body's link, with mass, collision and visual shapes."""
        model, link = self.model, ET.Element("link", name=name)
        if model.body_mass[body] > 0.0:
            inertial = ET.SubElement(link, "inertial")
            write_origin(inertial, model.body_ipos[body], matrices(model.body_iquat[body]))
            ET.SubElement(inertial, "mass", value=repr(float(model.body_mass[body])))
            moments = zip(("ixx", "iyy", "izz"), map(repr, model.body_inertia[body].tolist()), strict=True)
            ET.SubElement(inertial, "inertia", {**dict(moments), "ixy": "0", "ixz": "0", "iyz": "0"})
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            if model.geom_contype[geom] or model.geom_conaffinity[geom]:
                self._add_shapes(link, "collision", geom)
            drawn = model.geom_group[geom] in DRAWN and self._colour(geom)[3] > 0.0
            if drawn and model.geom_type[geom] in self._known:
                for visual in self._add_shapes(link, "visual", geom):
                    material = ET.SubElement(visual, "material", name=f"colour {geom}")
                    ET.SubElement(material, "color", rgba=text_of(self._colour(geom)))
        return link

    @property
    def _known(self) -> tuple[int, ...]:
        """Return the kinds of shapes that URDFs support."""
        kinds = self.mj.mjtGeom
        return tuple(int(getattr(kinds, f"mjGEOM_{name}")) for name in KNOWN)

    def _colour(self, geom: int) -> Array:
        """Return the colour of a geom or its material; shape (4,)."""
        material = int(self.model.geom_matid[geom])
        rgba = self.model.geom_rgba[geom] if material < 0 else self.model.mat_rgba[material]
        return np.asarray(rgba, dtype=np.float64)

    def _add_shapes(self, link: ET.Element, role: str, geom: int) -> list[ET.Element]:
        """Add the shapes of a geom to a link; return the elements. `role` is `collision` or `visual`."""
        added, turned = list[ET.Element](), matrices(self.model.geom_quat[geom])
        for shape, shift in self._shapes(geom):
            added.append(ET.SubElement(link, role))
            write_origin(added[-1], self.model.geom_pos[geom] + turned @ shift, turned)
            ET.SubElement(added[-1], "geometry").append(shape)
        return added

    def _shapes(self, geom: int) -> Iterator[tuple[ET.Element, Array]]:
        """Yield a geom's URDF shapes and their positions in it [m]. A capsule gives three shapes."""
        model, kinds, middle = self.model, self.mj.mjtGeom, np.zeros(3)
        kind, (a, b, _) = kinds(int(model.geom_type[geom])), model.geom_size[geom].tolist()
        if kind == kinds.mjGEOM_BOX:
            yield ET.Element("box", size=text_of(2.0 * model.geom_size[geom])), middle
        elif kind == kinds.mjGEOM_SPHERE:
            yield ET.Element("sphere", radius=repr(a)), middle
        elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
            yield ET.Element("cylinder", radius=repr(a), length=repr(2.0 * b)), middle
            for end in (b, -b) if kind == kinds.mjGEOM_CAPSULE else ():
                yield ET.Element("sphere", radius=repr(a)), np.array([0.0, 0.0, end])
        elif kind == kinds.mjGEOM_MESH:
            yield (
                ET.Element("mesh", filename=f"{MESHES}/{self.meshes.name_of(int(model.geom_dataid[geom]))}"),
                middle,
            )
        else:
            name = str(model.geom(geom).name or f"geom {geom}")
            raise RobotError(
                f"the body '{name}' is none of box, sphere, cylinder, capsule and mesh",
                file=self.file,
                way_out="take one of these, or let it collide with nothing (contype and conaffinity 0)",
            )
