"""`make bench`: what each stage costs, beside the least that this machine can take, and beside another implementation.

command `lookback dev bench --stages`
table   the rows, and the page of them
stages  one function at a time
drives  whole frames, mapping, maps of every size, and the daemon itself
"""

import sim.bench  # noqa: F401  one thread, before faiss loads its library
