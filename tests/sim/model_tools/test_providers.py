"""`lookback model providers`: the same question as at the daemon's start, for each provider that is installed."""

from __future__ import annotations

import pytest

from edge.__main__ import main
from edge.descriptor.open_network import NSD_COSINE_MIN
from sim.model_tools import providers


def test_the_cpu_agrees_with_itself(capsys: pytest.CaptureFixture[str]) -> None:
    """Where no other provider is installed, the one row is the CPU's."""
    assert main(["model", "providers"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("| network | provider |")
    for line in lines[2:]:
        name, provider, cosine, is_used, own_ms, cpu_ms = (cell.strip() for cell in line.strip("|").split("|"))
        assert (name, is_used) == ("alexnet_places100", "yes")
        assert provider != providers.REMOTE
        assert float(cosine) >= NSD_COSINE_MIN
        assert float(own_ms) > 0 and float(cpu_ms) > 0


def test_a_file_that_is_no_network_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["model", "providers", "nowhere"]) == 78
    assert capsys.readouterr().err.strip().endswith("No such file or directory")
