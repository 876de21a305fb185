"""Recognize the places of an earlier drive in pictures: by night, by another camera, in the opposite direction.

Lookback's place recognition (Garg, Suenderhauf and Milford, "Don't Look Back", ICRA 2018) for Python. NumPy arrays go
in and out; nothing of a vehicle is needed. From two folders of pictures to recall@1 and a curve:

    import lookback

    reference, query = lookback.describe("out"), lookback.describe("home")
    similarity = lookback.compare(lookback.normalize(query), lookback.normalize(reference), orders=True)
    truth = lookback.truth("home", "out", tolerance=20)
    found = lookback.search(similarity, length=20, views=("rear", "front"))  # where each camera faced
    print(lookback.recall_at(similarity, truth), lookback.recall_at(found, truth))
    lookback.plot({"frames": lookback.pr_curve(similarity, truth), "sequences": lookback.pr_curve(found, truth)})

The steps, each of which can be replaced by your own arrays:

    describe    pictures -> descriptors (N, R, D) of R regions, by a network of ours or by any ONNX file
    normalize   the mean and the deviation of a drive taken out of its descriptors (NSD, eq. 1 of the paper)
    compare     query and reference -> cosine similarity S (Q, N)
    nearest     S -> the best place of each frame alone
    search      S -> the best place by a sequence of frames, along the reference and against it (eq. 2 and 3)
    believe     descriptors -> places with the probability that each is right, as the vehicle's daemon has it
    keypoints   a picture -> its points; verify: which of two pictures' points agree, so one picture gives the place
    truth       two recordings -> which places are right (Q, N); recall_at, pr_curve, auc, match_pairs score by it
    plot        curves, or S with what was found
    Map, Recognizer   a map on the disk, and one picture after another recognized on it

Images are (H, W, 3) uint8 in the order blue, green, red, as `cv2.imread` gives them. What is wrong with a file is an
`Error` of one line; wrong arrays are a ValueError.
"""

from lookback import own_packages  # noqa: F401  # before anything of them is imported

# isort: split
import warnings
from typing import Any

from edge import __version__
from edge.errors import LookbackError as Error
from edge.keypoints import Keypoints
from edge.sequence import PlaceMatch
from lookback.description import describe, normalize
from lookback.maps import Map, Recognizer
from lookback.matching import believe, compare, nearest, search
from lookback.plotting import plot
from lookback.scoring import Curve, auc, match_pairs, pr_curve, recall_at, truth
from lookback.verification import keypoints, verify
from sim.compare.matching import Matches
from sim.evaluation.matched_points import InlierMatches

__all__ = [
    "Curve",
    "Error",
    "InlierMatches",
    "Keypoints",
    "Map",
    "Matches",
    "PlaceMatch",
    "Recognizer",
    "__version__",
    "auc",
    "believe",
    "compare",
    "describe",
    "keypoints",
    "match_pairs",
    "nearest",
    "normalize",
    "plot",
    "pr_curve",
    "recall_at",
    "search",
    "truth",
    "verify",
]


def __dir__() -> list[str]:
    """What is for users, without the modules that it is made of."""
    return [*__all__]


def __getattr__(name: str) -> Any:
    """The name that version 0.3 had for `InlierMatches`, until the next version."""
    if name == "Verified":
        warnings.warn("lookback.Verified is now lookback.InlierMatches", DeprecationWarning, stacklevel=2)
        return InlierMatches
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
