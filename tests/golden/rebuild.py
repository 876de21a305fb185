"""Writes the golden outputs anew, all of them or those of the named cases: `python -m tests.golden.rebuild [CASE ...]`.

Look at the difference (`git diff --stat tests/golden`) before it is committed: it is a change of behavior.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from edge.descriptor.network import Network
from sim.evaluation.memoizing_network import MemoizingNetwork
from tests.golden.compare import first_difference
from tests.golden.harness import KINDS, cases, outputs_of


def rebuild(folder: Path, scratch: Path, network: Network) -> None:
    """Write the golden files of one case, and print which of them changed."""
    for name, text in outputs_of(folder, scratch, network).items():
        file = folder / name
        changed = not file.exists() or first_difference(file.read_text(encoding="utf-8"), text) is not None
        if changed:
            file.write_text(text, encoding="utf-8")
        print(f"{file}: {len(text.splitlines())} lines, {'changed' if changed else 'as it was'}")


if __name__ == "__main__":
    wanted = set(sys.argv[1:])
    known = {f"{path.parent.name}/{path.name}": path for kind in KINDS for path in cases(kind)}
    if not wanted <= set(known):
        sys.exit(f"no such case: {', '.join(sorted(wanted - set(known)))}; there are {', '.join(known)}")
    network = MemoizingNetwork.load()
    with tempfile.TemporaryDirectory() as folder_of_maps:
        for case in sorted(wanted or known):
            rebuild(known[case], Path(folder_of_maps), network)
