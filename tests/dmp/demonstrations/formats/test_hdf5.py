"""robomimic and ALOHA: exact round trips, files as others write them, and damage told."""

import json
import os

import numpy as np
import pytest

from comove.dmp.demonstrations import Demonstration, read_hdf5, write_aloha, write_robomimic
from comove.dmp.demonstrations.formats import hdf5, hdf5_access
from comove.errors import DemonstrationError, OptionError

h5py = pytest.importorskip("h5py")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "demo.hdf5"


def arms(hand, seed=0):
    joints = {"n_dims": 7, "rate": 50.0, "turned": False, "unit": "rad"}
    return {"left": hand(seed, **joints), "right": hand(seed + 1, **joints)}


def robomimic(path, **changes):
    """A file as robomimic's own tools write it: float32 positions, x y z w, images beside them."""
    contents = {
        "data/demo_0/obs/robot0_eef_pos": np.linspace([0, 0, 1], [0.5, 0, 1], 5, dtype=np.float32),
        "data/demo_0/obs/robot0_eef_quat": np.repeat([[0.0, 0.0, 0.6, 0.8]], 5, axis=0),
        "data/demo_0/obs/agentview_image": np.zeros((5, 8, 8, 3), dtype=np.uint8),
        "data/demo_0/actions": np.zeros((5, 7)),
        "data/demo_0/states": np.zeros((5, 40)),
    } | changes
    with h5py.File(path, "w") as file:
        for key, value in contents.items():
            if value is not None:
                file[key] = value
        if "data" in file:
            file["data"].attrs["env_args"] = json.dumps({"env_kwargs": {"control_freq": 10}})
    return path


def aloha(path, qpos, **attributes):
    with h5py.File(path, "w") as file:
        file.attrs.update({"sim": False, **attributes})
        file["observations/qpos"] = qpos
        file["action"] = np.zeros((5, 14))
    return path


def test_robomimic_is_read_bit_by_bit(path, hand):
    episodes = [{"left": hand(seed), "right": hand(seed + 9)} for seed in range(12)]
    write_robomimic(path, episodes)
    again = read_hdf5(path)
    assert list(again) == [f"demo_{index}" for index in range(12)] == list(hdf5.episodes(path))
    for episode, written in zip(again.values(), episodes, strict=True):
        assert list(episode) == ["robot0", "robot1"]
        for demo, original in zip(episode.values(), written.values(), strict=True):
            assert demo.position.tobytes() == original.position.tobytes()
            assert demo.orientation.tobytes() == original.orientation.tobytes()
            np.testing.assert_allclose(demo.time, original.time, atol=1e-12)


def test_robomimic_is_written_as_robomimic_expects(path, hand):
    demo = hand(rate=25.0)
    write_robomimic(path, [demo])
    with h5py.File(path) as file:
        assert json.loads(file["data"].attrs["env_args"])["env_kwargs"]["control_freq"] == 25.0
        assert file["data"].attrs["total"] == file["data/demo_0"].attrs["num_samples"] == 12
        held = file["data/demo_0"]
        np.testing.assert_array_equal(held["obs/robot0_eef_quat"][:, 3], demo.orientation[:, 0])
        np.testing.assert_array_equal(held["actions"][:-1, :3], demo.position[1:])
        np.testing.assert_allclose(held["actions"][:-1, 3:], demo.rotation.as_rotvec()[1:])
        np.testing.assert_array_equal(held["dones"], [0] * 11 + [1])
        assert held["rewards"].shape == (12,)


def test_files_of_others_are_read_in_our_order_of_quaternions(path):
    robomimic(path)
    (demo,) = read_hdf5(path)["demo_0"].values()
    np.testing.assert_allclose(demo.orientation, np.repeat([[0.8, 0, 0, 0.6]], 5, axis=0))
    np.testing.assert_allclose(demo.time, np.arange(5) / 10.0)
    assert demo.name == "demo.demo_0.robot0"
    (faster,) = read_hdf5(path, rate=40.0)["demo_0"].values()
    assert faster.duration == 0.1


def test_without_a_rate_the_default_of_the_format_counts(path):
    robomimic(path)
    with h5py.File(path, "a") as file:
        del file["data"].attrs["env_args"]
    assert read_hdf5(path)["demo_0"]["robot0"].duration == 4 / 20
    aloha(path, np.zeros((5, 14)) + np.arange(5)[:, None] / 10)
    assert read_hdf5(path)["demo"]["left"].duration == 4 / 50
    aloha(path, np.zeros((5, 14)), fps=25)
    assert read_hdf5(path)["demo"]["left"].duration == 4 / 25


def test_aloha_is_read_bit_by_bit_and_left_comes_first(path, hand):
    written = arms(hand)
    write_aloha(path, written)
    ((name, again),) = read_hdf5(path).items()
    assert name == "demo"
    assert hdf5.episodes(path) == ("demo",)
    for arm, demo in again.items():
        assert demo.position.tobytes() == written[arm].position.tobytes()
        np.testing.assert_allclose(demo.time, written[arm].time, atol=1e-15)
        assert demo.axes == hdf5.ALOHA_JOINTS
        assert demo.unit == "rad"
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file["observations/qpos"][:, :7], written["left"].position)
        np.testing.assert_array_equal(file["action"][:-1], file["observations/qpos"][1:])
        assert file["observations/qvel"].shape == (12, 14)
    single = aloha(path, np.linspace(0, 1, 35).reshape(5, 7))
    assert list(read_hdf5(single)["demo"]) == [""]


def test_one_episode_is_read_by_name_or_number(path, hand):
    write_robomimic(path, [hand(seed) for seed in range(3)])
    for episode in ("demo_2", "2", 2):
        assert list(read_hdf5(path, episode=episode)) == ["demo_2"]
    with pytest.raises(
        DemonstrationError, match="episode: there is no episode 3; known: demo_0, demo_1, demo_2"
    ):
        read_hdf5(path, episode=3)


POSE = "data/demo_0/obs/robot0_eef_pos"
TURN = "data/demo_0/obs/robot0_eef_quat"


@pytest.mark.parametrize(
    ("changes", "key", "says", "way_out"),
    [
        (
            {POSE: None},
            None,
            "no movement that is known in data/demo_0",
            f"name a dataset, of data/demo_0/actions 5x7, .*{TURN} 5x4",
        ),
        ({POSE: np.zeros((5, 4))}, POSE, r"shape \(5, 4\)", r"\(n_steps, 3\)"),
        ({POSE: np.zeros(5)}, POSE, r"shape \(5,\)", r"\(n_steps, 3\)"),
        ({POSE: np.zeros((0, 3))}, POSE, "this one has 0", "record more"),
        ({POSE: np.zeros((1, 3))}, POSE, "this one has 1", "record more"),
        ({POSE: np.full((5, 3), b"a")}, POSE, "not numbers", "name a dataset, of data/demo_0/"),
        ({POSE: ["a", "b"]}, POSE, "it holds text, not numbers", "name a dataset, of data/demo_0/"),
        ({POSE: np.full((5, 3), np.nan)}, f"{POSE}[0, 0]", "nan", "remove the row"),
        ({TURN: np.zeros((5, 4))}, f"{TURN}[0]", "norm 0, not 1", "unit quaternions"),
        ({TURN: np.ones((4, 4)) / 2}, "orientation", "4, 4.* position has 5 rows", "quaternion"),
        (
            {POSE: None, f"{POSE}/inside": 1.0},
            POSE,
            "a group, not a dataset",
            "name a dataset, of data/demo_0/",
        ),
    ],
)
def test_what_is_no_movement_is_told_by_its_dataset(path, refused, changes, key, says, way_out):
    refused(read_hdf5, robomimic(path, **changes), key=key, says=says, way_out=way_out)


def test_other_layouts_are_told(path, refused):
    for key in ("other/thing", "data/thing"):
        with h5py.File(path, "w") as file:
            file[key] = 1.0
        refused(read_hdf5, path, key=None, says=f"holds {key.split('/')[0]}, and no episode", way_out="ALOHA")
    with h5py.File(path, "w"):
        pass
    refused(read_hdf5, path, key=None, says="holds nothing", way_out="robomimic")
    bad = aloha(path, np.full((5, 14), np.inf))
    refused(read_hdf5, bad, key="observations/qpos[0, 0]", says="inf", way_out="remove")


def test_rates_that_are_none_are_told(path, refused):
    refused(
        read_hdf5, aloha(path, np.zeros((5, 14)), fps=0.0), key="fps", says="no rate", way_out="--rate HZ"
    )
    robomimic(path)
    for text, key in [
        ("{", "data, attribute env_args"),
        ("[1]", "data, attribute env_args"),
        ('{"env_kwargs": {"control_freq": "fast"}}', "env_args.env_kwargs.control_freq"),
    ]:
        with h5py.File(path, "a") as file:
            file["data"].attrs["env_args"] = text
        refused(read_hdf5, path, key=key, says="no rate|no JSON", way_out="--rate HZ")
    with pytest.raises(OptionError, match="rate: -1 is no rate"):
        read_hdf5(path, rate=-1)


def test_a_count_that_disagrees_is_told(path, refused):
    robomimic(path)
    with h5py.File(path, "a") as file:
        file["data/demo_0"].attrs["num_samples"] = 6
    refused(read_hdf5, path, key=POSE, says="5 rows and num_samples says 6", way_out="again")


def test_claims_are_compared_with_a_limit_before_anything_is_read(path, refused, monkeypatch):
    for shape, chunks in [((10**9, 3), (1000, 3)), ((5, 3), (5 * 10**7, 3))]:
        robomimic(path, **{POSE: None})
        with h5py.File(path, "a") as file:
            file.create_dataset(POSE, shape, "f4", chunks=chunks, maxshape=(None, 3), compression="gzip")
        assert path.stat().st_size < 100_000
        refused(read_hdf5, path, key=POSE, says=r"claims float32 of shape", way_out="2,000,000 rows")
    monkeypatch.setattr(hdf5_access, "MAX_ROWS", 4)
    robomimic(path)
    refused(read_hdf5, path, key=POSE, says="claims", way_out="4 rows")


def test_many_episodes_together_are_limited(path, refused, hand, monkeypatch):
    write_robomimic(path, [hand(), hand()])
    monkeypatch.setattr(hdf5, "MAX_ROWS", 20)
    refused(read_hdf5, path, key=None, says="more than 20 rows", way_out="episode by episode")
    assert len(read_hdf5(path, episode=1)) == 1


def test_numbers_in_other_files_are_not_followed(path, refused, tmp_path):
    robomimic(tmp_path / "other.hdf5")
    for link, says in [("dataset", "link into another file"), ("group", "link into another file")]:
        robomimic(path, **{POSE: None, TURN: None} if link == "dataset" else {})
        with h5py.File(path, "a") as file:
            target = POSE if link == "dataset" else "data/demo_0/obs"
            if target in file:
                del file[target]
            file[target] = h5py.ExternalLink("other.hdf5", target)
        refused(read_hdf5, path, key=target, says=says, way_out="copy")
    robomimic(path, **{POSE: None})
    with h5py.File(path, "a") as file:
        layout = h5py.VirtualLayout((5, 3), "f4")
        layout[:] = h5py.VirtualSource(tmp_path / "other.hdf5", POSE, (5, 3))
        file.create_virtual_dataset(POSE, layout)
    refused(read_hdf5, path, key=POSE, says="lie in another file", way_out="copy")


def test_files_cut_anywhere_are_refused(path, hand, cut_anywhere, tmp_path):
    write_robomimic(path, [{"a": hand(), "b": hand(1)}])
    cut_anywhere(lambda: read_hdf5(path), path, step=23)
    write_aloha(path, arms(hand))
    cut_anywhere(lambda: read_hdf5(path), path, step=17)


@pytest.mark.slow
def test_files_cut_at_every_byte_are_refused(path, hand, cut_anywhere):
    write_aloha(path, arms(hand))
    cut_anywhere(lambda: read_hdf5(path), path)


def test_damage_is_read_or_told(path, hand, damaged):
    write_robomimic(path, [{"a": hand(), "b": hand(1)}])
    damaged(lambda: [d for demos in read_hdf5(path).values() for d in demos.values()], path, 200)


def test_what_does_not_fit_is_not_written(path, refused, hand):
    uneven = Demonstration([0.0, 0.1, 0.3], np.eye(3))
    joints = hand(turned=False, unit="rad", axes=("a", "b", "c"))
    for episodes, says, way_out in [
        ([], "no episode", "give one"),
        ([hand(), hand(turned=False)], "episode 1 differs from episode 0", "a file for each"),
        ([hand(), {"a": hand(), "b": hand()}], "episode 1 differs", "a file for each"),
        ([hand(), hand(rate=30.0)], "episode 1 runs at 30 Hz and episode 0 at 20 Hz", "resample"),
        ([uneven], r"time\[1\] of the movement is 0\.1 s", "resampled"),
        ([hand(n_dims=2)], "2 coordinates in m", "x, y, z in metres"),
        ([joints], "3 coordinates in rad", "x, y, z in metres"),
        (
            [{"a": hand(), "b": hand(turned=False)}],
            "only one of 'b' and 'a' has orientations",
            "all or to none",
        ),
    ]:
        refused(lambda p, e=episodes: write_robomimic(p, e), path, key=None, says=says, way_out=way_out)
    for demos, says, way_out in [
        ({"a": hand(n_dims=7), "b": hand(n_dims=7)}, "manipulators are 'a', 'b'", "left and right"),
        (hand(), "an arm has 3 coordinates", "give 7: waist"),
    ]:
        refused(lambda p, d=demos: write_aloha(p, d), path, key=None, says=says, way_out=way_out)
    assert os.listdir(path.parent) == []


def test_a_missing_library_names_the_command(path, hand, without, refused):
    write_robomimic(path, [hand()])
    without("h5py")
    command = r"run: pip install 'comove\[data\]'"
    refused(read_hdf5, path, key=None, says="needs h5py", way_out=command)
    refused(lambda p: write_robomimic(p, [hand()]), path, key=None, says="needs h5py", way_out=command)


@pytest.mark.parametrize("layout", [pytest.param("robomimic", marks=pytest.mark.slow), "aloha"])
def test_a_changed_number_is_told_by_its_checksum(tmp_path, hand, layout):
    """In every file that comove wrote: of each dataset and of what describes it; other files may have none."""
    file = tmp_path / "a.hdf5"
    if layout == "robomimic":
        write_robomimic(file, [{"left": hand(0), "right": hand(1)}])
    else:
        write_aloha(file, hand(0, n_dims=7, turned=False))

    def numbers():
        (demos,) = read_hdf5(file).values()
        arrays = [
            (d.time, d.position, d.time if d.orientation is None else d.orientation) for d in demos.values()
        ]
        return list(demos), [array.tobytes() for three in arrays for array in three]

    before, content, told = numbers(), file.read_bytes(), 0
    for at in range(0, len(content), 11):
        file.write_bytes(content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :])
        try:
            after = numbers()
        except DemonstrationError:
            told += 1
        else:
            assert after == before, at
    assert told > 50


@pytest.mark.parametrize("chunks", [None, (4, 3)])
def test_what_was_never_written_is_no_zeros(tmp_path, chunks):
    """As a recorder leaves it that is killed."""
    rows = np.cumsum(np.full((10, 3), 0.01), axis=0)
    with h5py.File(tmp_path / "a.hdf5", "w") as root:
        dataset = root.create_dataset("data/demo_0/obs/robot0_eef_pos", (10, 3), "f8", chunks=chunks)
        if chunks:
            dataset[:7] = rows[:7]  # two chunks of three
    with pytest.raises(DemonstrationError, match="robot0_eef_pos: not all of it was written; record or copy"):
        read_hdf5(tmp_path / "a.hdf5")
    with h5py.File(tmp_path / "a.hdf5", "r+") as root:
        root["data/demo_0/obs/robot0_eef_pos"][:] = rows
    assert read_hdf5(tmp_path / "a.hdf5")["demo_0"]["robot0"].n_steps == 10
