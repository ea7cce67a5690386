import numpy as np
import pytest

from lerobot_gloves.demo import illustrations, picture, video
from lerobot_gloves.demo.evaluation import PlayedRun
from lerobot_gloves.demo.replay import Path2d
from tests.demo.episodes import CORRECTED, RAW, comparison, played

SEEDS = [10000, 10001]


def test_the_picture_shows_every_path_and_what_became_of_it():
    reached = Path2d(np.array([[0.5, -0.2], [0.6, 0.1], [0.6, 0.36]]), "")
    touched = Path2d(np.array([[0.5, -0.2], [0.5, -0.14]]), "collision")
    odd = Path2d(np.array([[0.5, -0.2], [0.7, 0.0]]), "earthquake")
    figure = picture.draw({"raw agent": [touched, reached, odd], "FEEG": [reached] * 3}, "a title")
    raw, feeg = figure.axes
    assert raw.get_title(loc="left") == "raw agent: 1 of 3 succeed"
    assert feeg.get_title(loc="left") == "FEEG: 3 of 3 succeed"
    assert raw.get_xlim() == feeg.get_xlim() and raw.get_ylim() == feeg.get_ylim()
    drawn = [line for line in raw.lines if len(line.get_xdata()) in (2, 3) and line.get_alpha()]
    assert {(line.get_color(), tuple(line.get_xdata()), tuple(line.get_ydata())) for line in drawn} == {
        (picture.SUCCESS, (-0.2, 0.1, 0.36), (0.5, 0.6, 0.6)),
        (picture.FAILURE, (-0.2, -0.14), (0.5, 0.5)),
        (picture.FAILURE, (-0.2, 0.0), (0.5, 0.7)),
    }
    (legend,) = figure.legends
    meanings = [text.get_text() for text in legend.get_texts()]
    assert meanings == ["through the requested corridor", "touched a pillar", "earthquake"]


def test_the_picture_is_made_from_the_recorded_episodes(tmp_path):
    illustrations.draw_paths(
        comparison(tmp_path), played(RAW, SEEDS, straight=True), played(CORRECTED, SEEDS), tmp_path / "p.png"
    )
    assert (tmp_path / "p.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_edits_by_step():
    result = PlayedRun(CORRECTED, [True], [np.zeros((7, 2))], [], [
        {"episode": 0, "step": 0, "length": 3, "edited": False},
        {"episode": 0, "step": 3, "length": 3, "edited": True},
        {"episode": 1, "step": 0, "length": 7, "edited": True},
        {"episode": 0, "step": 6, "length": 3, "edited": True},
    ])  # fmt: skip
    assert illustrations.edited(result, 0) == [False] * 3 + [True] * 4


@pytest.mark.parametrize("chosen", [0, 1])
def test_the_video_shows_the_first_rescued_episode_and_says_so(tmp_path, monkeypatch, chosen):
    written = []
    monkeypatch.setattr(video, "RENDERED", 48)
    monkeypatch.setattr(video, "write", lambda *arguments: written.append(arguments))
    raw, corrected = played(RAW, SEEDS, straight=True), played(CORRECTED, SEEDS)
    raw.successes[:chosen] = [True] * chosen  # as if it had not failed there
    note = illustrations.write_video(comparison(tmp_path), raw, corrected, tmp_path / "v.mp4")
    # Seed 10000 + i asks for corridor (10000 + i) % 24 = 16 + i: 16 = 1 x 12 + 1 x 4 + 0.
    mode = ["1 1 0", "1 1 1"][chosen]
    expected = (
        f"v.mp4 shows seed {10000 + chosen}, corridor {mode}, chosen from the results: the first episode in which"
    )
    assert note.startswith(expected)
    ((panels, shown_mode, caption, _),) = written
    assert shown_mode == mode and f"Seed {10000 + chosen}" in caption
    assert [panel.path.failure for panel in panels] == ["collision", ""]


def test_without_a_rescued_episode_there_is_no_video(tmp_path):
    (tmp_path / "v.mp4").write_text("of an earlier run")
    raw = played(RAW, SEEDS)
    note = illustrations.write_video(comparison(tmp_path), raw, played(CORRECTED, SEEDS), tmp_path / "v.mp4")
    assert note.startswith("No video: in no episode") and not (tmp_path / "v.mp4").exists()
