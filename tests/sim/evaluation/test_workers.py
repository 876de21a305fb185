"""Traverses described elsewhere give the very same numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edge.config import SamplingConfig
from edge.descriptor.regions import REGION_COUNT, Regions
from edge.errors import ConfigError
from sim.evaluation.descriptions import open_executor
from sim.evaluation.method_runner import MethodRunner
from sim.evaluation.plan import NetworkPlan, Pair, Plan, TraversePlan
from sim.evaluation.run import Folders, open_runner


@pytest.fixture
def open_small_bench(tmp_path: Path, write_feed: Any) -> Any:
    write_feed("there", [0.0, 2.0, 4.0, 6.0])
    write_feed("here", [2.0, 4.0, 6.0])
    plan = Plan(
        title="small",
        methods=["Raw-fc6", "NSD-CR", "SeqSLAM"],
        networks={"shipped": NetworkPlan()},
        traverses={name: TraversePlan(feed=name) for name in ("there", "here")},
        pairs=[Pair("p", "there", "here", "rows", tolerance=1.0, length=2)],
        sampling=SamplingConfig(by="frames"),
    )
    return lambda: open_runner(plan, Folders(tmp_path, tmp_path, tmp_path, tmp_path))


def same_descriptors(here: MethodRunner, elsewhere: MethodRunner) -> bool:
    def raw(runner: MethodRunner, name: str, regions: Regions) -> np.ndarray:
        return runner.descriptions.raw(runner.traverse(name), "shipped", "fc6", regions)

    return all(
        np.array_equal(raw(here, name, regions), raw(elsewhere, name, regions))
        for name in ("there", "here")
        for regions in REGION_COUNT
    )


def test_processes_give_the_same_numbers(open_small_bench: Any) -> None:
    elsewhere = open_small_bench()
    with open_executor(2, "") as executor:
        assert executor is not None
        elsewhere.describe_all(executor)
    assert len(elsewhere.descriptions._raw) == 4
    assert same_descriptors(open_small_bench(), elsewhere)


@pytest.mark.filterwarnings("default")  # Dask's own
def test_a_dask_cluster_gives_the_same_numbers(open_small_bench: Any) -> None:
    distributed = pytest.importorskip("dask.distributed")
    elsewhere = open_small_bench()
    with (
        distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster,
        open_executor(1, cluster.scheduler_address) as executor,
    ):
        assert executor is not None
        elsewhere.describe_all(executor)
    assert len(elsewhere.descriptions._raw) == 4
    assert same_descriptors(open_small_bench(), elsewhere)


def test_in_process_needs_nothing_and_a_cluster_that_is_not_there_is_one_line() -> None:
    with open_executor(1, "") as executor:
        assert executor is None
    pytest.importorskip("dask.distributed")
    with pytest.raises(ConfigError, match="tpc") as caught, open_executor(1, "tpc://nowhere"):
        pass
    assert "\n" not in str(caught.value)
