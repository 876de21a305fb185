"""`lookback map keygen` and `lookback map sign`: so that a vehicle takes only the maps that its owner has made."""

from __future__ import annotations

import argparse
from pathlib import Path

from edge.errors import MapError
from edge.reference_map import open_map_set
from edge.reference_map.signature import make_key, sign_map


def add_actions(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add them to `lookback map`."""
    keygen = actions.add_parser("keygen", help="make a key pair to sign maps with: NAME and NAME.pub")
    keygen.add_argument("key", type=Path, metavar="NAME", help="file for the secret key")
    keygen.set_defaults(run=_keygen)

    sign = actions.add_parser("sign", help="check every byte of a map, or of each map of a folder, and sign it")
    sign.add_argument("map", type=Path, metavar="MAP", help="a map, or a folder of maps")
    sign.add_argument("--key", type=Path, required=True, metavar="NAME", help="the secret key that `map keygen` made")
    sign.set_defaults(run=_sign)


def _keygen(args: argparse.Namespace) -> int:
    public = make_key(args.key)
    print(
        f"{args.key}: keep this file secret; copy {public} to the vehicle and set"
        f' [map] require_signature_by = "{public.name}"'
    )
    return 0


def _sign(args: argparse.Namespace) -> int:
    maps = open_map_set(args.map)
    if maps.excluded:
        raise MapError(maps.excluded[0].why)
    for one in maps.maps:
        sign_map(one.path, args.key)
    print(f"{args.map}: signed")
    return 0
