"""`lookback compare`: methods of place recognition on your drives, the paper's and others', in one table and one page.

What runs it is imported when it runs: matplotlib alone takes half a second.
"""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from typing import Any

from sim.output import needing


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of `lookback compare`."""
    parser.description = (
        "Compare methods on a plan (TOML; docs/evaluation.md), on a plan of Lookback (benchmark, keypoints, simulator,"
        " real_feeds, real_front_rear, real_front_rear_odometer), or on two recordings: feeds, videos, folders of"
        " pictures. Rows: Raw-single, NSD-single (best match of each frame alone), Keypoints (ten best by geometry),"
        " Raw-fc6, NSD-fc6, Raw-CR, NSD-CR (sequences), Lookback, SeqSLAM, each with @NETWORK for another network."
    )
    about = "a plan; or the reference recording, then the query"
    parser.add_argument("what", nargs="+", type=Path, metavar="PLAN or RECORDING", help=about)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="of the report's files")
    many: dict[str, Any] = {"action": "append", "default": []}
    about = "this row instead of those of the plan, beside those of other options; again for more"
    parser.add_argument("--method", **many, metavar="ROW", help=about)
    about = "grid, fc6, or any ONNX file; :HEIGHTxWIDTH where it takes images of any size"
    parser.add_argument("--network", **many, metavar="NAME=FILE", help=about)
    about = "descriptors (n, D) of both recordings: NAME=REFERENCE.npy,QUERY.npy"
    parser.add_argument("--descriptors", **many, metavar="NAME=FILES", help=about)
    about = "similarities (queries, places), .npy"
    parser.add_argument("--similarity", **many, metavar="NAME=FILE", help=about)
    about = "of two recordings: positions, rows, route_m, or the .npy file of a matrix or of VPR-Bench"
    parser.add_argument("--truth", metavar="TRUTH", help=about)
    about = "a matrix of what is neither right nor wrong, .npy: the next best answer counts"
    parser.add_argument("--soft", type=Path, metavar="FILE", help=about)
    about = "the matrices are (places, queries), as in VPR_Tutorial"
    parser.add_argument("--transposed", action="store_true", help=about)
    about = "a place so near is right (default 40 m, or 5 frames)"
    parser.add_argument("--tolerance", type=float, metavar="M", help=about)
    about = "how far ahead the right place lies, as `lookback calibrate` says (default 0)"
    parser.add_argument("--ahead", type=float, default=0.0, metavar="M", help=about)
    parser.add_argument("--length", type=int, default=20, metavar="L", help="frames of a sequence (default 20)")
    for what in ("feeds", "models"):
        where = f"folder of the plan's {what} (default: beside the plan)"
        parser.add_argument(f"--{what}", type=Path, metavar="FOLDER", help=where)
    parser.set_defaults(run=_run)


def _run(args: argparse.Namespace) -> int:
    with needing("lookback compare", "sim"):
        run = import_module("sim.compare.run").run
    return int(run(args))
