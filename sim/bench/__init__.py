"""`lookback dev bench`: how long a frame takes on this board, and, with `--stages`, what each stage costs.

board    the command, and the sensors of the board
frames   the stages of a frame, through the daemon's recognizer
simulated_map  maps of any size
timing   functions run alternately
table    the rows of stages, and the page of them
stages   one function at a time, beside the least that this machine can take and another implementation
drives   whole frames, mapping, maps of every size, and the daemon itself
"""

import os

# Before NumPy and faiss load their libraries, which read it once: the bench measures one thread.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
