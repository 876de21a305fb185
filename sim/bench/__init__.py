"""What each stage costs, beside other implementations and the least that this machine can take.

`machine`: memory bandwidth and int8 rate. `timing`: alternating runs. `*_rows`: the measurements, stage by stage.
`simulated_map`: maps of any size. `rows`: the page in Markdown. `python -m sim.bench` runs them.
"""

import os

# Before NumPy and faiss load their libraries, which read it once: the bench measures one thread.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
