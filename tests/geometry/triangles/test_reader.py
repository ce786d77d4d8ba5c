"""Every format gives the same triangles; what is damaged, hostile or senseless is told, soon and in one sentence."""

import random
import resource
import struct
import time

import numpy as np
import pytest

from comove.errors import InputError, MeshError
from comove.geometry.triangles import FORMATS, as_stl, read_bytes, triangles_of
from tests.geometry.triangles.written import (
    CORNERS,
    FACES,
    OBJ,
    POSITIONS,
    VERTICES,
    WEDGE,
    off,
    ply,
    stl,
    stl_text,
)

LITTLE, BIG = "binary_little_endian", "binary_big_endian"
RIGHT = {
    "binary.stl": stl(),
    "text.stl": stl_text(),
    "shouting.stl": stl_text().upper().replace("\n", "\r\n"),
    "solid.stl": b"solid" + stl()[5:],
    "plain.obj": OBJ,
    "old.obj": OBJ.replace("\n", "\r"),
    "marked.obj": b"\xef\xbb\xbf" + OBJ.encode(),
    "back.obj": "".join("v {:g} {:g} {:g}\n".format(*v) for v in VERTICES)
    + "".join("f {}//1 {}/2 {}/3/4\n".format(*face) for face in FACES - 4),
    "rich.obj": "mtllib ../../x.mtl\nusemtl /dev/zero\no a\ns off\nvt nan\nvn inf 0 0\n"
    + OBJ.replace(" 3\n", " \\\n3\n"),
    "coloured.obj": OBJ.replace("v 0 0 0\n", "v 0 0 0 1 0.5 0\n").replace("v 1 0 0\n", "v 1 0 0 1.0\n"),
    "text.off": off(),
    "coloured.off": off("OFF 6 8 12\n", "255 0 0"),
    "text.ply": ply(),
    "little.ply": ply(LITTLE),
    "big.ply": ply(BIG),
    "windows.ply": ply().replace(b"\n", b"\r\n"),
    "more.ply": ply(LITTLE, more="element edge 1\nproperty list uchar short k\n",
                    body=VERTICES.astype("<f4").tobytes() + b"\x02aabb" + ply(LITTLE)[-4 * 13:]),
    "wedge.dae": WEDGE.replace("100", "1").replace("50", "1").replace("25", "1").replace("0.01", "1"),
}  # fmt: skip


def corners(data, name):
    """Places of the corners of every triangle, shape (n_triangles, 3, 3)."""
    vertices, faces = triangles_of(data if isinstance(data, bytes) else data.encode(), name[-4:])
    return vertices[faces]


@pytest.mark.parametrize("name", RIGHT)
def test_every_format_gives_the_same_triangles(name):
    np.testing.assert_array_equal(corners(RIGHT[name], name), VERTICES[FACES])


def test_the_formats_are_those_that_are_tested():
    assert {name[-4:] for name in RIGHT} == set(FORMATS)


def test_what_is_written_is_read():
    rng = np.random.default_rng(0)
    vertices, faces = (
        rng.normal(size=(50, 3)).astype("f4"),
        rng.permuted(np.tile(np.arange(50), (80, 1)), axis=1)[:, :3],
    )
    np.testing.assert_array_equal(corners(as_stl(vertices, faces), "x.stl"), vertices[faces])


def test_corners_counted_back_are_counted_from_their_line():
    """As tools write OBJ files of several parts."""
    part = "v 0 0 {0}\nv 1 0 {0}\nv 0 1 {0}\nf -3 -2 -1\n"
    assert corners(part.format(0) + part.format(5), "x.obj")[:, :, 2].tolist() == [[0.0] * 3, [5.0] * 3]


def test_polygons_are_covered_by_their_triangles():
    """An L, whose fan reaches beyond it and leaves nothing of it out."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2.0]])
    text = "".join(f"v {x:g} {y:g} 0\n" for x, y in outline) + "f 3 4 5 6 1 2\n"
    triangles = corners(text, "x.obj")[:, :, :2]
    assert len(triangles) == 4
    points = np.random.default_rng(1).uniform(0, 2, (500, 2))
    points = points[(points[:, 0] < 1) | (points[:, 1] < 1)]
    a, b, c = (triangles[None, :, k] - points[:, None] for k in range(3))
    turns = [p[..., 0] * q[..., 1] - p[..., 1] * q[..., 0] for p, q in ((a, b), (b, c), (c, a))]
    within = np.all([t >= 0 for t in turns], axis=0) | np.all([t <= 0 for t in turns], axis=0)
    assert within.any(axis=1).all()


def test_faces_of_different_lengths_are_read_from_text_and_bytes_alike():
    """A quadrilateral between two triangles."""
    faces = ([0, 2, 1], [0, 1, 2, 3], [1, 2, 3])
    text = ply(body=POSITIONS + "".join(f"\n{len(f)} {' '.join(map(str, f))}" for f in faces), n_faces=3)
    found = [corners(text, "x.ply")]
    for kind, order in ((LITTLE, "<"), (BIG, ">")):
        body = VERTICES.astype(f"{order}f4").tobytes()
        body += b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)
        found.append(corners(ply(kind, body, n_faces=3), "x.ply"))
    for own in found:
        np.testing.assert_array_equal(own, VERTICES[[[0, 2, 1], [0, 1, 2], [0, 2, 3], [1, 2, 3]]])


def test_a_collada_scene_is_shown_in_metres_and_where_its_nodes_stand():
    node = "<node><translate>1 2 3</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>{}</node>"
    scene = WEDGE.replace("<node>", "<node><matrix>1 0 0 5 0 1 0 0 0 0 1 0 0 0 0 1</matrix>").replace(
        '<instance_geometry url="#g"/>', node.format('<instance_node url="#held"/>')
    )
    nodes = '<library_nodes><node id="held"><instance_geometry url="#g"/></node></library_nodes>'
    found = corners(scene.replace("<library_visual_scenes>", nodes + "<library_visual_scenes>"), "x.dae")
    local = np.array([[0, 0, 0], [100, 0, 0], [0, 50, 0], [0, 0, 25.0]])
    wanted = 0.01 * (np.column_stack([-local[:, 1], 2 * local[:, 0], local[:, 2]]) + [6, 2, 3])
    np.testing.assert_allclose(found, wanted[FACES], atol=1e-12)


def test_collada_polygons_strips_and_fans():
    """Two quadrilaterals of the wedge's corners, written in four ways."""
    lists = {
        "polylist": "<vcount>4 3</vcount><p>0 1 2 3 1 2 3</p>",
        "polygons": "<p>0 1 2 3</p><p>1 2 3</p>",
        "trifans": "<p>0 1 2 3</p><p>1 2 3</p>",
    }
    given = "<input semantic='VERTEX' source='#v' offset='0'/>"
    old = WEDGE[WEDGE.index("<triangles") : WEDGE.index("</mesh>")]
    for tag, rest in lists.items():
        found = corners(
            WEDGE.replace(old, f'<{tag} count="2">{given}{rest}</{tag}><lines count="0"/>'), "x.dae"
        )
        assert len(found) == 3
    twice = WEDGE.replace("<p>0 2 1", "<p>0 0 1")
    assert len(corners(twice, "x.dae")) == 3, "a corner that is named twice"
    strip = WEDGE.replace(old, f'<tristrips count="1">{given}<p>0 1 2 3</p></tristrips>')
    assert len(corners(strip, "x.dae")) == 2


# --- What no mesh is ---


def first(number):
    """The vertices, the first of them with another x."""
    return np.concatenate([[[number, 0, 0]], VERTICES[1:]])


def huge_list(length, size):
    """A face that claims so many corners."""
    return ply(
        LITTLE,
        VERTICES.astype("<f4").tobytes() + size + struct.pack("<3i", 0, 1, 2),
        n_faces=1,
        length=length,
    )


FAR = "write finite numbers"
WRONG = [
    *((f"x.{kind[1:]}", b"", "") for kind in FORMATS),
    *((f"x.{kind[1:]}", random.Random(0).randbytes(3000), "") for kind in FORMATS),
    *((f"x.{kind[1:]}", bytes(1000), "") for kind in FORMATS),
    *(("x.stl", stl(claimed), f"claims {claimed} triangles and holds 4") for claimed in (0, 3, 5, 10**9, 2**32 - 1)),
    ("x.off", off("COFF\n4 4 6\n"), "does not begin with 'OFF'"),
    ("x.off", off("OFF\n4 1000000000 6\n"), "claims 1000000000 faces and has room for"),
    ("x.off", off("OFF\n-4 4 6\n"), "'-4' is no number of vertices"),
    ("x.off", off("OFF\n4 5 6\n"), "claims 9 lines and holds 8"),
    ("x.off", off("OFF\n4\n"), "how many vertices and faces"),
    ("x.off", off().replace("1 0 0\n", "1 0\n", 1), "vertex 1 is '1 0'"),
    ("x.off", off().replace("1 0 0\n", "1 0 inf\n", 1), "'inf' is no number"),
    ("x.off", off().replace("3 0 2 1", "9 0 2 1"), "claims 9 corners and has room for 3"),
    ("x.off", off().replace("3 0 2 1", "3 0 2 4"), "face 0 has the corner 4 of 4"),
    ("x.off", off().replace("3 0 2 1", "2 0 2 1"), "a face has 2 corners"),
    ("x.stl", stl()[:-10], "claims 4 triangles and holds 3"),
    ("x.stl", stl()[:10], "has 10 bytes"),
    ("x.stl", stl(vertices=first(np.nan)), "its vertex 0 is at (nan, 0, 0)"),
    ("x.stl", stl(vertices=first(3e38)), FAR),
    ("x.stl", stl(0)[:84], "no triangles"),
    ("x.stl", stl_text()[:150], "its facet 2 is not whole"),
    ("x.stl", stl_text().replace("endloop", "vertex 1 1 1\nendloop", 1), "facet 2 has '1' where 'facet' belongs"),
    ("x.stl", stl_text().replace("vertex 0 0 1\n", "", 1), "where"),
    ("x.stl", "solid\nendsolid", "no triangles"),
    ("x.obj", "f 1 2 3\n", "corner 2 of 0"),
    ("x.obj", OBJ + "f 1 2 5\n", "corner 4 of 4"),
    ("x.obj", OBJ + "f 1 2 0\n", "line 9: there is no vertex 0"),
    ("x.obj", OBJ + "f 1 2 -5\n", "line 9: there is no vertex -5"),
    ("x.obj", OBJ + "f 1 2 99999999999999999999\n", "is no face"),
    ("x.obj", OBJ + "f 1 2 1.5\n", "is no face"),
    ("x.obj", OBJ + "f 1 2 0_3\n", "is no face"),
    ("x.obj", OBJ + "f 1 2\n", "a face has 2 corners"),
    ("x.obj", OBJ + "v 1 2\n", "line 9: a vertex has 2 numbers"),
    ("x.obj", OBJ + "v 1 2 3 0.5\n", "line 9: a vertex has 4 numbers"),
    ("x.obj", "call /etc/passwd\n" + OBJ, "line 1: 'call' is not known"),
    ("x.obj", OBJ + "curv 0 1 1 2\n", "'curv' is not known"),
    ("x.obj", "v 0 0 0\nf 1 1 1\n", "no triangle with three corners"),
    *(("x.obj", OBJ.replace("v 1 0", f"v {x} 0"), f"'{x}' is no number")
      for x in ("nan", "inf", "1_0", "0x1", "1,5", "1d5", "--1", "e5", "1-2", "\u0661")),
    *(("x.obj", OBJ.replace("v 1 0", f"v {x} 0"), FAR) for x in ("1e400", "-1e308", "1e9")),
    ("x.ply", b"solid", "does not begin with 'ply'"),
    ("x.ply", ply()[:100], "its header has no end"),
    ("x.ply", ply("binary"), "its header says 'format binary 1.0'"),
    ("x.ply", ply().replace(b"format ascii 1.0\n", b""), "names no format"),
    ("x.ply", ply(more="element vertex 4\n"), "an element twice"),
    ("x.ply", ply(more="property float q\n" * 300), "more than 256"),
    ("x.ply", ply(more="property list float int q\n"), "has the property 'list float int q'"),
    ("x.ply", ply(number="string"), "has the property 'string x'"),
    *(("x.ply", ply(kind, n_faces=n), "") for kind in ("ascii", LITTLE) for n in (-1, 3, 5, 10**9, 10**30)),
    *(("x.ply", ply(kind, n_vertices=n), "") for kind in ("ascii", LITTLE) for n in (-1, 3, 5, 10**9, 2**63)),
    ("x.ply", ply(n_faces=5), "it ends before all that its header claims"),
    ("x.ply", ply(n_faces=3), "it holds more than its header says"),
    ("x.ply", ply(LITTLE, n_faces=3), "it holds more than its header says"),
    ("x.ply", ply(n_faces=0, body=POSITIONS), "no triangles"),
    ("x.ply", ply(LITTLE, n_faces=0, body=VERTICES.astype("<f4").tobytes()), "no triangles"),
    ("x.ply", huge_list("int", struct.pack("<i", 10**9)), "it ends before"),
    ("x.ply", huge_list("int", struct.pack("<i", -3)), "it claims a list of -3"),
    ("x.ply", huge_list("uint", struct.pack("<I", 2**32 - 1)), "it ends before"),
    ("x.ply", ply(body=f"{POSITIONS}\n1000000000 0 1 2\n", n_faces=1), "it ends before"),
    ("x.ply", ply(body=f"{POSITIONS}\n{CORNERS}".replace("3 1 2 3", "3 1 2 4")), "corner 4 of 4"),
    ("x.ply", ply(body=f"{POSITIONS}\n{CORNERS}".replace("3 1 2 3", "3 1 2 -1")), "corner -1 of 4"),
    ("x.ply", ply(body=f"{POSITIONS}\n{CORNERS}".replace("3 1 2 3", "3 1 2 1.5")), "no whole number"),
    ("x.ply", ply(body=f"{POSITIONS}\n{CORNERS}".replace("1 0 0", "nan 0 0", 1)), "'nan' is no number"),
    *(("x.ply", ply(LITTLE)[:-4] + struct.pack("<i", k), f"corner {k} of 4") for k in (4, -1, 2**31 - 1, -(2**31))),
    ("x.ply", ply(LITTLE, number="double"), ""),
    ("x.dae", WEDGE[:600], "it is not XML"),
    ("x.dae", "<robot/>", "not a <COLLADA>"),
    ("x.dae", WEDGE.replace("<COLL", "<!DOCTYPE C [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><COLL"), "document type"),
    ("x.dae", WEDGE.replace("<node>", "<node>" * 20_000).replace("</node>", "</node>" * 20_000), "64 levels"),
    ("x.dae", WEDGE.replace("<node>", '<node id="n"><instance_node url="#n"/>'), "go round in a circle"),
    ("x.dae", WEDGE.replace('<instance_geometry url="#g"/>', '<instance_geometry url="#g"/>' * 20_000), "too many"),
    ("x.dae", WEDGE.replace('url="#g"', 'url="#h"'), "there is no <geometry> '#h'"),
    ("x.dae", WEDGE.replace('url="#g"', 'url="file:///etc/passwd#g"'), "there is no <geometry>"),
    ("x.dae", WEDGE.replace('count="12"', 'count="1000000000"'), "has the count '1000000000'"),
    ("x.dae", WEDGE.replace('count="4" stride', 'count="900000000" stride'), "claims 900000000 vertices"),
    ("x.dae", WEDGE.replace('stride="3"', 'stride="-3"'), "a <accessor> has the stride '-3'"),
    ("x.dae", WEDGE.replace('stride="3"', 'stride="1"'), "of 1 numbers"),
    ("x.dae", WEDGE.replace('offset="0"', 'offset="-1"'), "a <input> has the offset '-1'"),
    ("x.dae", WEDGE.replace('offset="0"', 'offset="7"'), "no whole numbers, or too few"),
    ("x.dae", WEDGE.replace("<p>0 2 1", "<p>0 2 -1"), "no whole numbers"),
    ("x.dae", WEDGE.replace("<p>0 2 1", "<p>0 2 1000000000"), "the corner 1000000000"),
    ("x.dae", WEDGE.replace("100 0 0", "nan 0 0"), "'nan' is no number"),
    ("x.dae", WEDGE.replace("100 0 0", "1e400 0 0"), FAR),
    ("x.dae", WEDGE.replace("0.01", "0"), "its unit has 0 m"),
    ("x.dae", WEDGE.replace("0.01", "nan"), "'nan' is no number"),
    ("x.dae", WEDGE.replace("<scene>", "<x>").replace("</scene>", "</x>").replace("visual_scene", "y"), "no scene"),
    ("x.dae", WEDGE.replace("<node>", "<node><skew>1 2 3 4 5 6 7</skew>"), "holds a <skew>"),
    ("x.dae", WEDGE.replace("<mesh>", "<spline>").replace("</mesh>", "</spline>"), "is no <mesh>"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "data", "told"), WRONG, ids=[f"{i}{case[0]}" for i, case in enumerate(WRONG)]
)
def test_what_is_no_mesh_is_told_in_one_sentence(name, data, told):
    with pytest.raises(MeshError) as caught:
        triangles_of(data if isinstance(data, bytes) else data.encode(), name[1:])
    assert told in str(caught.value)
    assert str(caught.value).isprintable()
    assert caught.value.way_out
    assert isinstance(caught.value, InputError)


def test_instances_of_instances_do_not_explode():
    ten = '<node id="n{}">' + '<instance_node url="#n{}"/>' * 10 + "</node>"
    nodes = "".join(ten.format(k, *[k - 1] * 10) for k in range(1, 10))
    nodes = f'<library_nodes><node id="n0"><instance_geometry url="#g"/></node>{nodes}</library_nodes>'
    text = WEDGE.replace("<library_visual_scenes>", nodes + "<library_visual_scenes>")
    with pytest.raises(MeshError, match="too many"):
        corners(
            text.replace(
                '<instance_geometry url="#g"/></node></vis', '<instance_node url="#n9"/></node></vis'
            ),
            "x.dae",
        )


LARGE = {
    "a.stl": lambda: b"solid " + b"x" * 20_000_000,
    "b.stl": lambda: b"facet " * 8_000_000,
    "c.stl": lambda: b"solid a\n" * 2_000_000,
    "a.obj": lambda: b"v " + b"1" * 20_000_000,
    "b.obj": lambda: OBJ.encode() + b"f" + b" 1 2 3 4" * 250_000 + b"\n",
    "c.obj": lambda: OBJ.encode() + b"f 1 2 \\\n" * 1_000_000,
    "d.obj": lambda: OBJ.encode() + b"f 1 2 3\n" * 1_000_001,
    "a.ply": lambda: b"ply\nformat ascii 1.0\nelement vertex " + b"1" * 20_000_000,
    "b.ply": lambda: ply(n_faces=1, length="int", body=f"{POSITIONS}\n1000000 " + "0 1 2 3 " * 250_000),
    "c.ply": lambda: ply(LITTLE, n_faces=200_000, body=VERTICES.astype("<f4").tobytes() + b"\x03" + bytes(2_600_000)),
    "a.dae": lambda: WEDGE.replace("<asset>", "<a/>" * 5_000_000 + "<asset>").encode(),
    "b.dae": lambda: WEDGE.replace("0 2 1 0", "0 2 1 " * 4_000_000 + "0").encode(),
}  # fmt: skip
LONG = ("d.obj", "a.dae", "b.dae", "c.ply")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in LONG else ()) for name in LARGE]
)
@pytest.mark.few(3)
def test_large_ones_are_answered_soon_and_within_bounds(name):
    """A few seconds and 1 GB, whatever it is; 60 s leave room for any machine, what is quadratic takes hours."""
    data, before = LARGE[name](), time.process_time()
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        corners(data, name)
    except MeshError as error:
        assert str(error).isprintable() and len(str(error)) < 300
    assert time.process_time() - before < 60.0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - grown < 1_000_000  # kB


@pytest.mark.parametrize("name", RIGHT)
def test_changed_bytes_are_read_or_told(name):
    """At most two bytes are another one, gone or too many."""
    rng, data = random.Random(1), RIGHT[name]
    data = data if isinstance(data, bytes) else data.encode()
    for _ in range(400):
        changed = bytearray(data)
        for _ in range(rng.choice((1, 1, 2))):
            at = rng.randrange(len(changed))
            changed[at : at + rng.choice((0, 1, 1, 1))] = rng.choice(
                [b"", bytes([rng.randrange(256)]), b"9", b"-", b"\n"]
            )
        try:
            found = corners(bytes(changed), name)
        except MeshError as error:
            assert str(error).isprintable() and len(str(error)) < 300
        else:
            assert np.isfinite(found).all() and found.shape[1:] == (3, 3)


def test_a_folder_and_what_is_too_large_are_told(tmp_path, monkeypatch):
    with pytest.raises(MeshError, match="it is no file"):
        read_bytes(tmp_path)
    monkeypatch.setattr("comove.geometry.triangles.reader.MAX_BYTES", 100)
    with pytest.raises(MeshError, match="larger than"):
        triangles_of(stl(), ".stl")
