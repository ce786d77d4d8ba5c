"""Cameras see what is simulated, from where the study puts them, and datasets hold what they saw."""

import copy
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from comove.data import Study, StudyStore, on_processes, run_study
from comove.data.cameras import CamerasPart
from comove.data.datasets import FORMATS, export_episodes
from comove.data.datasets.samples import chosen_rate, episodes_of
from comove.data.runs import RUNS
from comove.data.videos import Video, VideoFile, encoded
from comove.errors import ComoveError, InputError, OptionError, ResultError
from comove.sim.engine import NO_PICTURES, drawing_backend
from tests.commands import invoke
from tests.data.test_carried import SCENE, require_mujoco, stored, written
from tests.data.test_runner import rows
from tests.data.works import FakeStudy

RATE = 5
CAMERAS = {
    "rate": RATE,
    "size": [96, 64],
    "views": {
        "front": {},
        "at_load": {"position": [-0.3, -1.2, 0.9], "target": [-0.3, 0.0, 0.3], "field_deg": 25},
        "wrist": {"hand": "right", "position": [0.12, 0.12, -0.3], "target": [0, 0, 0], "field_deg": 60},
    },
}
STUDY = {"simulate": {"grasp": "weld", "perturbed": False}, "cameras": CAMERAS, "draws": [], "episodes": 1}


def require_pictures():
    """Skip a test where nothing can be drawn."""
    require_mujoco()
    pytest.importorskip("av")
    if drawing_backend() == NO_PICTURES:
        pytest.skip("neither EGL nor OSMesa")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A study of one episode that three cameras saw, its folder, and the episode."""
    require_pictures()
    folder = tmp_path_factory.mktemp("cameras")
    study = Study.load(written(folder, **STUDY))
    (folder / "out").mkdir()
    stored(study, folder / "out")
    return study, folder / "out", next(episodes_of(folder / "out", study.folder))


def load_in(picture):
    """Middle of the load's pixels, orange as nothing else is, from the middle of the picture [widths, heights]."""
    red, green, blue = picture.astype(float).transpose(2, 0, 1)
    rows, columns = np.nonzero((red - blue > 40) & (green > 0.65 * red))
    assert len(rows) > 5, "the load is not in the picture"
    height, width = picture.shape[:2]
    return np.array([columns.mean() / width - 0.5, rows.mean() / height - 0.5])


@pytest.mark.slow
def test_there_is_a_picture_for_every_sample(done):
    _, _, episode = done
    assert episode.rate == RATE and list(episode.videos) == ["at_load", "front", "wrist"]
    for video in episode.videos.values():
        assert video.pictures.shape == (len(episode.time), 64, 96, 3)
        assert video.pictures.std() > 10.0


@pytest.mark.slow
def test_a_camera_shows_what_it_looks_at_in_the_middle_and_what_moves_moving(done):
    """The load's middle is the target when the motion begins; then it goes along x, to the right of the picture."""
    pictures = done[2].videos["at_load"].pictures
    assert np.abs(load_in(pictures[0])).max() < 0.06
    assert load_in(pictures[len(pictures) // 3])[0] > load_in(pictures[0])[0] + 0.05


def test_a_camera_in_a_hand_sees_the_load_stand_still(done):
    places = np.array([load_in(picture) for picture in done[2].videos["wrist"].pictures])
    assert np.abs(places - places[0]).max() < 0.03
    seen = done[2].videos["wrist"].pictures.astype(float)
    assert np.abs(seen[-1] - seen[0]).mean() > 1.0  # and the world go by


@pytest.mark.slow
def test_pictures_change_nothing_of_the_rows(done, tmp_path):
    study, out, _ = done
    without = Study.load(written(tmp_path, **(STUDY | {"cameras": None})))
    (run, motion), (plain, bare) = study.run(0), without.run(0)
    assert (run.motion_sha256, run.scene_sha256) == (plain.motion_sha256, plain.scene_sha256)
    assert motion.carry.joints == bare.carry.joints and motion.carry.simulation == bare.carry.simulation
    assert motion.videos and not bare.videos
    (_, kept) = next(StudyStore.open(out / RUNS).motions())
    assert dict(kept.videos) == dict(motion.videos)  # the same pictures, to the bit, on one machine


def test_datasets_hold_what_the_cameras_saw(done):
    for library in ("pyarrow", "h5py", "rosbags"):
        pytest.importorskip(library)
    study, out, episode = done
    for format in FORMATS.values():
        export_episodes(out, study.folder, format)
    root = out / "lerobot"
    info = json.loads((root / "meta/info.json").read_text())
    for name in ("front", "wrist"):
        feature = info["features"][f"observation.images.{name}"]
        assert feature["dtype"] == "video" and feature["shape"] == [64, 96, 3] and info["fps"] == RATE
        place = {"chunk_index": 0, "file_index": 0, "video_key": f"observation.images.{name}"}
        video = Video((root / info["video_path"].format(**place)).read_bytes(), "of the dataset")
        assert np.array_equal(video.pictures, episode.videos[name].pictures)
    stats = json.loads((out / "lerobot/meta/stats.json").read_text())["observation.images.front"]
    mean = episode.videos["front"].pictures.mean(axis=(0, 1, 2)) / 255.0
    assert np.shape(stats["mean"]) == (3, 1, 1) and np.allclose(np.ravel(stats["mean"]), mean, atol=1e-9)
    with np.load(out / "npz/episode_000000.npz") as archive:
        assert np.array_equal(archive["at_load_image"], episode.videos["at_load"].pictures)
    with pytest.importorskip("h5py").File(out / "robomimic.hdf5") as file:
        image = file["data/demo_0/obs/front_image"]
        assert image.dtype == np.uint8 and np.array_equal(image, episode.videos["front"].pictures)
    assert_jpegs(out / "mcap/episode_000000.mcap", episode.videos["wrist"].pictures)


def assert_jpegs(path, pictures):
    """An MCAP file holds them as compressed images, at their times, by another reader than comove's."""
    image = pytest.importorskip("PIL.Image")
    reader, decoder = (pytest.importorskip(name) for name in ("mcap.reader", "mcap_ros2.decoder"))
    with open(path, "rb") as file:
        found = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        messages = [
            (message.log_time, decoded)
            for _, _, message, decoded in found.iter_decoded_messages(topics=["/wrist/image/compressed"])
        ]
    assert [time for time, _ in messages] == [10**9 + i * 10**9 // RATE for i in range(len(pictures))]
    for (_, decoded), picture in zip(messages, pictures, strict=True):
        seen = np.asarray(image.open(io.BytesIO(bytes(decoded.data))), dtype=float)
        assert decoded.format == "jpeg" and np.abs(seen - picture).mean() < 6.0


def test_a_video_that_was_damaged_or_lost_is_told_and_nothing_is_written(done, tmp_path):
    study, out, _ = done
    store = StudyStore.create(tmp_path / RUNS)
    with store.writer() as writer:
        writer.absorb(out / RUNS)
        store.describe(study.described, 1)
    with store.connected() as connection:
        connection.execute("UPDATE videos SET video = substr(video, 1, 900) WHERE camera = 'front'")
    with pytest.raises(ResultError, match="the video 'front' of episode 0 cannot be decoded"):
        export_episodes(tmp_path, study.folder, FORMATS["npz"])
    with store.connected() as connection:
        connection.execute("DELETE FROM videos WHERE camera = 'wrist'")
    with pytest.raises(ResultError, match="episode 0 has no video of the camera 'wrist'"):
        export_episodes(tmp_path, study.folder, FORMATS["npz"])
    assert not (tmp_path / "npz").exists()


def test_joined_videos_show_the_same_pictures_one_after_the_other(tmp_path):
    pytest.importorskip("av")
    rng = np.random.default_rng(3307)
    clips = [
        np.kron(rng.integers(0, 255, (n, 4, 4, 3)), np.ones((1, 8, 8, 1))).astype(np.uint8) for n in (5, 8)
    ]
    videos = [Video(encoded([[picture] for picture in clip], 1, 10)[0], "clip") for clip in clips]
    for clip, video in zip(clips, videos, strict=True):
        assert np.abs(video.pictures.astype(float) - clip).mean() < 25.0  # colours are of 2 x 2 pixels
    file = VideoFile(tmp_path / "joined.mp4", videos[0], 10)
    for video in videos:
        assert file.takes(video)
        file.add(video)
    file.close()
    joined = Video((tmp_path / "joined.mp4").read_bytes(), "joined")
    assert np.array_equal(joined.pictures, np.concatenate([video.pictures for video in videos]))
    wide = Video(encoded([[np.zeros((16, 64, 3), np.uint8)]], 1, 10)[0], "wide")
    assert not VideoFile(tmp_path / "other.mp4", videos[0], 10).takes(wide)


def cameras(**changes):
    """The cameras of the study with some keys changed, those of the first view by name."""
    contents = copy.deepcopy(CAMERAS)
    contents["views"] = {"front": changes.pop("front")} if "front" in changes else contents["views"]
    return {"cameras": contents | changes}


BAD = [
    (cameras() | {"simulate": None}, r"cameras .*simulates nothing; add simulate"),
    (cameras(rate=0), "cameras.rate"),
    (cameras(rate=2.5), "cameras.rate"),
    (cameras(size=[97, 64]), "a picture of 97 x 64 pixels is not possible; write two even numbers"),
    (cameras(size=[4000, 3000]), "4000 x 3000"),
    (cameras(size=256), "cameras.size"),
    (cameras(views={}), "there are 0 views"),
    (cameras(views=["front"]), "cameras.views"),
    (cameras(views={"left wrist": {}}), "'left wrist' cannot name a view"),
    (cameras(views={"a/b": {}}), "'a/b' cannot name a view"),
    (cameras(front={"hand": "lefd"}), "there is no hand 'lefd'.*did you mean 'left'"),
    (cameras(front={"target": [0, 0, 0]}), "the position is missing"),
    (cameras(front={"position": [0, 0], "target": [0, 0, 0]}), "no point in space"),
    (cameras(front={"position": [1, 2, 3], "target": [1, 2, 3]}), "the camera stands where it looks"),
    (cameras(front={"aside_deg": 5, "hand": "left"}), "a direction is given besides a place"),
    (cameras(front={"elevation_deg": -90}), "elevation_deg"),
    (cameras(front={"field_deg": 180}), "field_deg"),
    (cameras(front={"fov": 40}), "unknown key"),
    (cameras(front=None), "cameras.views.front"),
    (cameras(rates=5), "did you mean 'rate'"),
]


@pytest.mark.parametrize(("changes", "told"), BAD)
def test_bad_cameras_are_one_sentence(tmp_path, changes, told):
    require_mujoco()
    with pytest.raises(InputError, match=told) as caught:
        Study.load(written(tmp_path, **(STUDY | changes)))
    assert "\n" not in str(caught.value)


def test_other_cameras_are_another_study(done, tmp_path):
    _, out, _ = done
    store = StudyStore.create(tmp_path / RUNS)
    with store.writer() as writer:
        writer.absorb(out / RUNS)
        store.describe(done[0].described, 1)
    edited = Study.load(written(tmp_path / "..", **(STUDY | cameras(rate=6))))
    with pytest.raises(ResultError, match=r"edited since: cameras.rate was 5 and is 6"):
        run_study(edited, tmp_path, on_processes(1))


def test_the_rate_of_datasets_is_that_of_the_pictures():
    assert (
        chosen_rate(None, None) == 50
        and chosen_rate(None, {"rate": 20}) == 20
        and chosen_rate(30, None) == 30
    )
    with pytest.raises(OptionError, match="the cameras of the study take 20 pictures a second; leave it out"):
        chosen_rate(50, {"rate": 20})


@pytest.mark.parametrize("missing", ["av", "drawing"])
def test_what_pictures_need_is_told_before_the_first_run(tmp_path, monkeypatch, missing):
    require_mujoco()
    path = written(tmp_path, **STUDY)
    if missing == "av":
        monkeypatch.setitem(__import__("sys").modules, "av", None)
        told = "pip install 'comove[video]'"
    else:
        pytest.importorskip("av")
        monkeypatch.setenv("MUJOCO_GL", "disabled")
        told = "pictures cannot be drawn"
    outcome = invoke("generate", path, "--out", tmp_path / "out")
    assert outcome.exit_code == 2 and told in outcome.stderr and outcome.stderr.count("\n") == 1, (
        outcome.stderr
    )
    assert not (tmp_path / "out").exists()


class Lacking(FakeStudy):
    """A study whose runs need what is not there."""

    def require(self):
        raise OptionError("there is no light", way_out="switch it on")


def test_what_runs_need_and_this_machine_lacks_ends_the_study_before_a_row(tmp_path):
    with pytest.raises(ComoveError, match="there is no light"):
        run_study(Lacking(3), tmp_path, on_processes(1))
    assert StudyStore.open(Path(tmp_path) / RUNS).numbers() == set()


@pytest.mark.slow
def test_workers_draw_the_same_pictures(tmp_path):
    require_pictures()
    draws = [{"key": "goal", "uniform": [[-0.05, -0.05, -0.05], [0.05, 0.05, 0.05]]}]
    study = Study.load(written(tmp_path, **(STUDY | {"draws": draws, "episodes": 3})))
    for workers in (1, 2):
        run_study(study, tmp_path / f"{workers}", on_processes(workers))
    first = rows(tmp_path / "1")
    assert len(first[1]) == 3 and all(len(motion.videos) == 3 for motion in first[1])
    assert first == rows(tmp_path / "2")


def test_the_scene_of_these_tests_has_the_load_where_a_camera_looks():
    middle = np.mean([hand["start"] for hand in SCENE["manipulators"]], axis=0)
    assert np.allclose(middle, CAMERAS["views"]["at_load"]["target"])


def test_the_cameras_of_the_page_are_cameras():
    page = (Path(__file__).parents[2] / "docs" / "data.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```yaml\n(cameras:.*?)```", page, re.DOTALL)
    shown = CamerasPart.model_validate(yaml.safe_load(block)["cameras"])
    usual = CamerasPart.model_validate({})
    assert (shown.rate, shown.size) == (usual.rate, usual.size) == (20, (256, 256))
    assert shown.views["front"] == usual.views["front"] and shown.views["left_wrist"].camera.hand == "left"


def test_the_example_is_a_study_with_cameras():
    require_mujoco()
    study = Study.load(Path(__file__).parents[2] / "examples" / "studies" / "cameras.yaml")
    assert sorted(study.file.cameras.views) == ["front", "left_wrist", "right_wrist"]
