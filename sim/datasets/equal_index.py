"""Traverses that were aligned frame by frame: the same number is the same place.

Nordland (N. Suenderhauf, P. Neubert, P. Protzel, 2013): four videos of one railway line, or their frames at 1 Hz in a
folder a season. In the frames of the "clean" version (Patch-NetVLAD, nordland-clean-dataset) they are called
images-00001.png and on, the same in all seasons, and `cleanImageNames.txt` lists those without tunnels and stations:
give it as `names`. A match is commonly right within 10 frames.

    summer/images-00001.png ...   winter/images-00001.png ...   cleanImageNames.txt

Gardens Point (A. Glover, 2014): folders day_left, day_right and night_right of 200 frames each; commonly 2 frames.

    day_left/Image000.jpg ... Image199.jpg   day_right/...   night_right/...

There are no positions. Times are nominal for folders: `fps` frames a second, 1 by default.
"""

from __future__ import annotations

from pathlib import Path

from edge.errors import FeedError
from edge.feed import FeedRow
from sim.datasets import ReadOptions, Traverse
from sim.datasets.pictures import PictureFiles, frames_of, number_in
from sim.datasets.tables import read_text

NOMINAL_FPS = 1.0


def open_traverse(path: Path, options: ReadOptions) -> Traverse:
    """The frames of one season or walk, a folder or a video. FeedError names what is missing."""
    names, stamps_ns, pictures = frames_of(path, options.fps or NOMINAL_FPS)
    if options.names:
        kept = _kept(path, names, options.names)
        names, stamps_ns = [names[index] for index in kept], [stamps_ns[index] for index in kept]
        pictures = PictureFiles([path / name for name in names])
    rows = [
        FeedRow(name, stamp_ns, extra={"source_frame": str(number_in(name, index))})
        for index, (name, stamp_ns) in enumerate(zip(names, stamps_ns, strict=True))
    ]
    notes = "ground truth: equal source_frame; times are nominal for frames in a folder"
    return Traverse(path.stem, f"{path.parent.name} {path.name}", tuple(rows), pictures, notes=notes)


def _kept(path: Path, names: list[str], file: Path) -> list[int]:
    """Which frames of a folder the list names; FeedError if there are none, or if it is a video."""
    if path.is_file():
        raise FeedError(f"--names: {path} is a video, whose frames have no names")
    wanted = set(read_text(file, "--names is a list of pictures, one a line").split())
    kept = [index for index, name in enumerate(names) if name in wanted]
    if not kept:
        raise FeedError(f"{file}: names none of the pictures in {path}, such as {names[0]}")
    return kept
