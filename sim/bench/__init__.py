"""`lookback dev bench`: how long a frame takes on this board.

board    the command, and the sensors of the board
frames   the stages of a frame, through the daemon's recognizer
simulated_map  maps of any size
machine  what the board is
timing   functions run alternately
"""

import os

# Before NumPy loads its library, which reads it once: the bench measures one thread.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
