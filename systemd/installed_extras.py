"""Of the extras of an installed Lookback, those whose packages are all there, with commas.

Usage: installed_extras.py SITE_PACKAGES. Runs by another Python than the one it is installed in, whose pip reads what
is required.
"""

from __future__ import annotations

import sys
from importlib.metadata import Distribution, DistributionFinder, MetadataPathFinder

sys.path.insert(0, sys.argv[1])

from pip._vendor.packaging.requirements import Requirement


def find(name: str) -> Distribution | None:
    """A package that is installed there, and not one that this Python has itself."""
    where = DistributionFinder.Context(name=name, path=[sys.argv[1]])
    return next(iter(MetadataPathFinder.find_distributions(where)), None)


def has(lookback: Distribution, extra: str) -> bool:
    """Whether every package that this extra needs is installed, of a version that it allows."""
    for line in lookback.requires or ():
        needed = Requirement(line)
        if not needed.marker or needed.marker.evaluate({"extra": ""}) or not needed.marker.evaluate({"extra": extra}):
            continue
        found = find(needed.name)
        if found is None or not needed.specifier.contains(found.version, prereleases=True):
            return False
        if needed.name == lookback.metadata["Name"] and not all(has(lookback, one) for one in needed.extras):
            return False
    return True


def main() -> None:
    """Print them."""
    lookback = find("lookback-nav") or find("lookback")  # its name before it was on PyPI
    if lookback is None:
        sys.exit(f"installed_extras.py: {sys.argv[1]}: Lookback is not installed there")
    extras = lookback.metadata.get_all("Provides-Extra") or []
    print(",".join(one for one in extras if has(lookback, one)))


main()
