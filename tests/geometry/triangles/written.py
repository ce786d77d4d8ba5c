"""A tetrahedron in every format that is read, and what one may get wrong in them."""

import struct

import numpy as np

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

WEDGE = """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>
  <library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="a" count="12">0 0 0 100 0 0 0 50 0 0 0 25</float_array>
      <technique_common><accessor source="#a" count="4" stride="3">
        <param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
      </accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/>
      <p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles>
  </mesh></geometry></library_geometries>
  <library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene>
  </library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
"""
POSITIONS = "\n".join("{:g} {:g} {:g}".format(*vertex) for vertex in VERTICES)
CORNERS = "\n".join("3 {} {} {}".format(*face) for face in FACES)
OBJ = "".join("v {:g} {:g} {:g}\n".format(*v) for v in VERTICES) + "".join(
    "f {} {} {}\n".format(*face) for face in FACES + 1
)


def stl(claimed=None, vertices=VERTICES):
    """Binary; `claimed`: how many triangles the header says it has."""
    faces = b"".join(struct.pack("<12fH", 0, 0, 0, *vertices[face].ravel(), 0) for face in FACES)
    return bytes(80) + struct.pack("<I", len(FACES) if claimed is None else claimed) + faces


def stl_text(vertices=VERTICES):
    """As text."""
    facet = "facet normal 0 0 nan\nouter loop\n{}endloop\nendfacet\n"
    corners = ("".join("vertex {:g} {:g} {:g}\n".format(*v) for v in vertices[face]) for face in FACES)
    return f"solid facet of my own\n{''.join(map(facet.format, corners))}endsolid facet of my own\n"


def off(head="OFF\n4 4 6\n", colour=""):
    """Text; a colour may follow every face."""
    head = head.replace("6 8 12", "4 4 0 # of a tetrahedron")
    return head + POSITIONS + "\n\n" + "".join(f"{line} {colour}\n" for line in CORNERS.split("\n"))


def ply(
    kind="ascii", body=None, n_vertices=4, n_faces=4, number="float", length="uchar", index="int", more=""
):
    """Text or binary; what is not given is right."""
    header = (
        f"ply\nformat {kind} 1.0\ncomment of mine\nelement vertex {n_vertices}\nproperty {number} x\n"
        f"property {number} y\nproperty {number} z\n{more}element face {n_faces}\n"
        f"property list {length} {index} vertex_indices\nend_header\n"
    )
    if body is None and kind == "ascii":
        body = f"{POSITIONS}\n{CORNERS}\n".encode()
    if body is None:
        order = "<" if "little" in kind else ">"
        body = VERTICES.astype(f"{order}f4").tobytes()
        body += b"".join(struct.pack(f"{order}B3i", 3, *face) for face in FACES)
    return header.encode() + (body if isinstance(body, bytes) else body.encode())
