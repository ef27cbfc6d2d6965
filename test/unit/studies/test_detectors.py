"""The detectors of figure 7 on a picture from a file."""

import cv2
import numpy as np
from shared import refuses
from study_runs import summary_of

from bullet_lab.studies.detectors import PictureSettings, run_detectors
from bullet_lab.vision.images import VisionError

DETECTORS = ("view_camera", "canny_edges", "good_features", "harris_corners", "aruco")


def written(folder, picture):
    path = folder / "picture.png"
    cv2.imwrite(str(path), picture)
    return str(path)


def test_the_marker_of_the_dock_is_found_on_its_wall(tmp_path):
    run_detectors(tmp_path, PictureSettings())
    summary = summary_of(tmp_path)
    [marker] = summary["markers"]
    assert (marker["id"], marker["dictionary"]) == (0, "DICT_APRILTAG_36h10")
    # Drawn with 256 px, in the middle of 1280.
    corners = [[511.5, 511.5], [767.5, 511.5], [767.5, 767.5], [511.5, 767.5]]
    assert np.allclose(corners, marker["corners_px"], atol=0.05)
    assert summary["picture"] == "back_wall.png"
    names = {f"{name}.png" for name in (*DETECTORS, "marker", "side_by_side")}
    assert {path.name for path in tmp_path.glob("*.png")} == names


def test_results_are_drawn_into_a_picture_without_a_marker(tmp_path):
    picture = np.full((120, 160, 3), 200, np.uint8)
    picture[40:80, 60:100] = 30
    report = run_detectors(
        tmp_path / "out", PictureSettings(written(tmp_path, picture), "4x4_50")
    )
    assert report.found["aruco"] == "no marker"
    assert not (tmp_path / "out" / "marker.png").exists()
    drawn = {name: cv2.imread(str(tmp_path / "out" / f"{name}.png")) for name in DETECTORS}
    assert np.array_equal(drawn["view_camera"], picture)
    assert 100 < np.count_nonzero(drawn["canny_edges"][:, :, 0]) < 300
    for name in ("good_features", "harris_corners"):
        blue = (drawn[name] == (255, 0, 0)).all(axis=2)
        # At the four corners of the dark square.
        assert all(blue[v - 3 : v + 4, u - 3 : u + 4].any() for u in (60, 99) for v in (40, 79))
    assert not np.array_equal(drawn["aruco"], picture)


def test_a_file_that_is_no_picture_is_refused(tmp_path):
    (tmp_path / "text.png").write_text("no picture")
    with refuses("it must be a picture, such as PNG or JPEG", VisionError):
        run_detectors(tmp_path / "out", PictureSettings(str(tmp_path / "text.png")))
