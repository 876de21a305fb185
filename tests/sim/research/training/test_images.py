"""A folder a class: which classes are found, what is read of them, and what is refused in a line that names it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from edge.errors import ConfigError, FeedError
from sim.research.training.images import LabeledImages, find_classes, read_images


def test_classes_are_named_as_places_names_them(write_classes: Any) -> None:
    classes = find_classes(write_classes(2))
    assert list(classes) == ["crowd", "field", "front/shop"]
    assert [file.name for file in classes["field"]] == ["00000000.png", "00000001.png"]


def test_pictures_are_squeezed_to_squares_in_rgb(tmp_path: Path) -> None:
    for name, color in (("red", (0, 0, 255)), ("blue", (255, 0, 0))):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / "1.png"), np.full((60, 90, 3), color, np.uint8))
    images = read_images(find_classes(tmp_path), 32, iter)
    assert images.classes == ("blue", "red") and images.labels.tolist() == [0, 1]
    assert images.pixels.shape == (2, 32, 32, 3)
    assert (images.pixels[0] == (0, 0, 255)).all() and (images.pixels[1] == (255, 0, 0)).all()


def test_every_class_gives_its_share_to_what_is_held_out() -> None:
    labels = np.repeat(np.arange(4), 25)
    images = LabeledImages(np.arange(100, dtype=np.uint8)[:, None, None, None], labels, ("a", "b", "c", "d"))
    learned, held_out = images.split(0.2)
    assert np.bincount(held_out.labels).tolist() == [5, 5, 5, 5]
    assert sorted([*learned.pixels.ravel(), *held_out.pixels.ravel()]) == list(range(100))


def test_a_class_without_pictures_is_named(write_classes: Any) -> None:
    folder = write_classes(1)
    (folder / "g" / "garden").mkdir(parents=True)
    with pytest.raises(FeedError, match=r"g/garden: no pictures in this folder"):
        find_classes(folder)


def test_a_folder_that_is_not_there_or_has_no_classes(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere: no such folder; give one with a folder of pictures for each"):
        find_classes(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match=r"0 class\(es\); needs a folder of pictures for each of at least 2"):
        find_classes(tmp_path)


def test_two_folders_of_one_class(write_classes: Any) -> None:
    folder = write_classes(1)
    (folder / "field").mkdir()
    (folder / "field" / "1.png").write_bytes((folder / "f/field/00000000.png").read_bytes())
    with pytest.raises(ConfigError, match=r"a second folder of the class field"):
        find_classes(folder)


def test_a_picture_that_cannot_be_read_is_named(write_classes: Any) -> None:
    folder = write_classes(3)
    file = folder / "f/field/00000001.png"
    file.write_bytes(file.read_bytes()[:100])
    with pytest.raises(ConfigError, match=r"f/field/00000001\.png: not a complete JPEG or PNG image; remove it"):
        read_images(find_classes(folder), 32, iter)
