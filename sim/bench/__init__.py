"""What each stage costs, side by side with its rivals and with what the machine itself must charge.

`machine` memory bandwidth and int8 rate; `timing` interleaved races; `*_rows` the measurements, stage by stage;
`simulated_map` maps of any size; `page` all of it as one page of Markdown. `python -m sim.bench` runs them.
"""

import os

# Before NumPy and faiss load their libraries, which look at it once: the bench is about one thread.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
